"""An object between two gels: in each frame, the pose in which the forces of both fingers and its weight balance.

Each gel is an ordinary problem with an indenter whose pose follows from that of the object. Newton's method finds the
object's pose, and the width for a given force, from the tangents of both gels (see rigid_stiffness). The object stands
on a table until the fingers carry its weight. If friction cannot carry it there is no quasi-static solution: the object
then sinks by `GraspScene.fall` a frame, all other components balance, and the frame records the remaining weight.
"""

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from tacgen.geometry.pose import Pose, about
from tacgen.mechanics import mesh
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.frames import normal_force, trial
from tacgen.mechanics.grasp import FINGER_ROTATIONS, FINGER_SIDES, GraspScene, finger, refined, seen_from
from tacgen.mechanics.line_search import backtrack
from tacgen.mechanics.options import DEFAULT_OPTIONS, tighter
from tacgen.mechanics.presolve import coarsened
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.rigid_stiffness import stiffness
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solver import solve
from tacgen.mechanics.state import History, State

Array = np.ndarray


class Mode(IntEnum):
    """The state of the object in a grasp."""

    standing = 0  # on the table
    held = 1
    falling = 2


BALANCE_TOL = 5e-4  # tolerance of forces, and of moments over the arm, over the grip force [-]; the check allows 1e-3
MAX_GRASP_TRIALS = 40  # most equilibria of both gels in a frame; ordinary frames take 3 to 6
MIN_FORCE_PER_WEIGHT = 1e-3  # smallest force scale, over the weight [-]
MIN_STIFFNESS_RATIO = 1e-6  # singular value over the largest, below which a motion has no stiffness [-]
# the error of a resultant is the sum of the nodal residuals, some ten times their 2-norm
GRASP_OPTIONS = tighter(DEFAULT_OPTIONS)
MIN_GRASP_STEP = 1 / 4  # smallest fraction of a Newton step in the line search [-]
FIRST_GRIP_SHARE = 0.03  # of the force of a frame, with which fingers first touch on the way to it [-]
FIRST_GRIP_TOL = 0.9  # of that force, and MAX_FIRST_IMBALANCE over it: of no weight beside the frame's own [-]
MAX_FIRST_IMBALANCE = 0.1
LIGHTER_GRIP_RATIO = 1 / 3  # of grips one after the other, below which a grip between them is found first [-]
FIRST_DEPTH_RATIO = 0.005  # first guess of the depth there, over the gel's thickness [-]


@dataclass(frozen=True)
class Held:
    """A frame of a grasp.

    states: of the left and the right gel; pose, sensors (4, 4): of the object and of both sensors in the world; width
    [mm] between the untouched faces; unborne: part of the weight that the fingers do not bear [N]; balance: residual of
    both fingers' forces and moments, the weight and the table, over the grip force [-]; weight of the object [N].
    """

    states: tuple[State, State]
    pose: Array
    sensors: tuple[Array, Array]
    width: float
    mode: Mode
    unborne: float
    balance: float
    weight: float


class Trial(NamedTuple):
    """Both gels at equilibrium with the object at `pose` (4, 4) of the gripper's frame."""

    pose: Array
    width: float
    gels: tuple[tuple[History, State], ...]
    wrench: Array  # (6,) of both fingers on the object about its centre of mass, in the gripper's frame [N, N mm]
    grip: float  # mean of both normal forces [N]


def problem_of(finger: Scene) -> Problem:
    """A finger's gel, meshed."""
    return Problem.of(finger, mesh.of(finger), GRASP_OPTIONS)


def held(grasp: GraspScene, problems: tuple[Problem, Problem], *, tol: float | None = None) -> Iterator[Held]:
    """The grasp at every frame, in order; `tol`: relative tolerance of a prescribed force.

    Raises:
        NotConverged: a frame could not be reached; it and all after it are missing.
    """
    mode, start = Mode.standing, [Pose.of(seen_from(side, grasp.opening, grasp.start)) for side in (0, 1)]
    rest = tuple((problem.rest(pose), None) for problem, pose in zip(problems, start, strict=True))
    states: tuple[State, ...] = ()
    last = begun = Trial(grasp.start, grasp.opening, rest, np.zeros(6), 0.0)  # type: ignore[arg-type]
    for index in range(len(grasp.gripper)):
        if index and grasp.segment[index] != grasp.segment[index - 1]:
            begun = last  # before the segment
        wanted = grasp.match[index] if grasp.match else None
        note = wanted.note if wanted else ""
        frame = Frame(grasp, problems, last, index, begun, problems[0].options.force_tol if tol is None else tol)
        try:
            frame, mode = frame.begun(mode)
            found = frame.find(mode)
        except NotConverged as error:
            if wanted is None or index == 0:
                raise
            note = f"{error}; the fingers stay as far apart as in the frame before"
            still = np.full(len(grasp.gripper), np.nan)
            frame = Frame(replace(grasp, force=still, width=still), problems, last, index, begun, frame.tol)
            try:
                found = frame.find(mode)
            except NotConverged:
                raise error from None
        last, mode = found
        gripper = grasp.gripper[index]
        states = tuple(replace(gel[1], note=note) if note else gel[1] for gel in last.gels)
        fingers = tuple(gripper @ finger(side, last.width) for side in (0, 1))
        pose, left = gripper @ last.pose, frame.unborne(last)
        balance = frame.balance(last, mode)
        yield Held(states, pose, fingers, last.width, mode, left, balance, frame.heaviness)  # type: ignore[arg-type]


class Frame:
    """The solve of one frame. Vectors are in the gripper's frame; moments are divided and rotations multiplied by
    `arm`, so that all are forces [N] and lengths [mm]."""

    def __init__(
        self, grasp: GraspScene, problems: tuple[Problem, Problem], last: Trial, index: int, begun: Trial, tol: float
    ) -> None:
        self.grasp, self.problems, self.last, self.index = grasp, problems, last, index
        self.gripper, part = grasp.gripper[index], grasp.part[index]
        self.width = float(begun.width + part * (grasp.width[index] - begun.width))
        self.force = float(begun.grip + part * (grasp.force[index] - begun.grip))
        self.tol, self.balanced = tol if part == 1 else max(tol, 1e-2), max(BALANCE_TOL, tol / 10)
        self.load = np.zeros(6)
        self.load[:3] = self.gripper[:3, :3].T @ grasp.weight
        self.heaviness = float(np.linalg.norm(self.load))
        self.down = self.load[:3] / self.heaviness
        self.arm, self.trials = grasp.opening / 2, 0
        self.scale = np.array([1.0, 1, 1, self.arm, self.arm, self.arm])
        self.before = grasp.gripper[index - 1] if index else grasp.begin

    def begun(self, mode: Mode) -> tuple["Frame", Mode]:
        """The frame, begun where both fingers just touch the object, if they did not, or on the way to a much lighter
        grip; and the mode there. Raises NotConverged.

        Points that touch anew stick where they first touch. From afar, in one step to the whole force, all of them do,
        wherever the object is: friction then tells nothing of how it moves, and Newton's method finds no balance.
        """
        way, then = copy(self), copy(self)
        if self.last.grip == 0 and self.force > 0:
            way.force, way.tol, way.balanced = FIRST_GRIP_SHARE * self.force, FIRST_GRIP_TOL, MAX_FIRST_IMBALANCE
        elif 0 < self.force < LIGHTER_GRIP_RATIO * self.last.grip:
            way.force = math.sqrt(self.force * self.last.grip)
        else:
            return self, mode
        then.last, mode = way.find(mode)
        then.before = self.gripper
        return then, mode

    def find(self, mode: Mode) -> tuple[Trial, Mode]:
        """The frame's equilibrium, and what the object does in it. Raises NotConverged.

        For a held object Newton's method starts from the pose carried along by the gripper, where the gel sticks: where
        the whole contact slides, the tangent is no guide.
        """
        stood = mode == Mode.standing
        table, carried, width = self._height(self.last.pose), self.last.pose, self._first_width()
        if self.last.grip == 0 and not np.array_equal(self.gripper, self.before):  # it stays, or lies on the table
            mode, stood, carried = Mode.standing, True, np.linalg.inv(self.gripper) @ self.before @ self.last.pose
        lowest = table if mode == Mode.standing else min(table, self.grasp.fall)
        if (mode == Mode.held and table >= 0) or (mode == Mode.standing and lowest > 0):
            trial = self._newton(self._trial(carried, width), Mode.held, lowest)
            if trial is not None:
                return trial, Mode.held
        mode = Mode.standing if lowest == table else Mode.falling
        trial = self._newton(self._trial(self._lowered(carried, lowest, stood), width), mode)
        assert trial is not None
        if self.unborne(trial) >= -self.balanced * self._least(trial):
            return trial, mode
        trial = self._newton(self._trial(carried, trial.width), Mode.held, lowest, bounded=True)
        assert trial is not None
        return trial, Mode.held

    def unborne(self, at: Trial) -> float:
        """Part of the weight that the fingers do not bear [N]."""
        return float((at.wrench + self.load)[:3] @ self.down)

    def balance(self, at: Trial, mode: Mode) -> float:
        """Residual of forces, and of moments over the arm, in the directions in which the object is free [-]."""
        free = self._free(mode)
        return float(np.linalg.norm(free.T @ ((at.wrench + self.load) / self.scale))) / self._least(at)

    def _least(self, at: Trial) -> float:
        return max(at.grip, MIN_FORCE_PER_WEIGHT * self.heaviness, *(gel.least_force for gel, _ in at.gels))

    def _free(self, mode: Mode) -> Array:
        """Orthonormal directions (6, k) in which the object is free to move."""
        if mode == Mode.held:
            return np.eye(6)
        level = np.linalg.svd(self.down[None])[2][1:]
        turns = self.down[None] if mode == Mode.standing else np.eye(3)
        out = np.zeros((6, 2 + len(turns)))
        out[:3, :2], out[3:, 2:] = level.T, turns.T
        return out

    def _height(self, pose: Array) -> float:
        """Height of the centre of mass over its place on the table, along the weight [mm]."""
        centre, start = (self._centre(p) for p in (self.gripper @ pose, self.grasp.begin @ self.grasp.start))
        return float((start - centre) @ (self.gripper[:3, :3] @ self.down))

    def _centre(self, pose: Array) -> Array:
        return np.asarray(pose[:3, :3] @ self.grasp.centre + pose[:3, 3])

    def _sunk(self, pose: Array) -> float:
        """How far the centre of mass is below where the gripper carried it [mm]."""
        return float((self._centre(pose) - self._centre(self.last.pose)) @ self.down)

    def _lowered(self, pose: Array, lowest: float, stood: bool) -> Array:
        """`pose` lowered to `lowest`; if it stood on the table, with the rotation that it had there."""
        out = pose.copy()
        if stood:
            out[:3, :3] = self.gripper[:3, :3].T @ self.before[:3, :3] @ self.last.pose[:3, :3]
        out[:3, 3] += self._centre(pose) - self._centre(out) + (lowest - self._sunk(pose)) * self.down
        return out

    def _first_width(self) -> float:
        if math.isfinite(self.width):
            return self.width
        if math.isnan(self.force) or self.last.grip > 0:
            return self.last.width
        touching = min(self.last.width, self.grasp.opening)
        return touching - 2 * FIRST_DEPTH_RATIO * min(problem.thickness for problem in self.problems)

    def _trial(self, pose: Array, width: float, near: Trial | None = None) -> Trial:
        """Both gels with the object there, from the last frame's history. Raises NotConverged."""
        self.trials += 1
        if self.trials > MAX_GRASP_TRIALS:
            raise NotConverged(Failure.grasp, trials=MAX_GRASP_TRIALS)
        gels, wrench, normal, centre = [], np.zeros(6), 0.0, self._centre(pose)
        for side, problem in enumerate(self.problems):
            there, before = seen_from(side, width, pose), seen_from(side, self.last.width, self.last.pose)
            close = None if near is None else near.gels[side][1]
            for task in trial(problem, self.last.gels[side][0], before, there, self.index, math.inf, close):
                task.now = solve(problem, task.now)
            gels.append(task.now.reached())
            state, look = gels[-1][1], FINGER_ROTATIONS[side]
            force = state.traction_force @ look.T
            at = problem.contact.faces.at(state.x) @ look.T + finger(side, width)[:3, 3]
            wrench -= np.concatenate([force.sum((0, 1)), np.cross(at - centre, force).sum((0, 1))])
            normal += normal_force(state) / 2
        return Trial(pose, width, tuple(gels), wrench, normal)

    def _tangent(self, at: Trial) -> Array:
        """d(wrench on the object, grip)/d(motion of the object, width) (7, 7), scaled by `arm`."""
        out = np.zeros((7, 7))
        for side, problem in enumerate(self.problems):
            look = np.kron(np.eye(2), FINGER_ROTATIONS[side])
            centre = seen_from(side, at.width, at.pose)[:3, :3] @ self.grasp.centre
            centre = centre + seen_from(side, at.width, at.pose)[:3, 3]
            after, state = at.gels[side]
            K = stiffness(problem, self.last.gels[side][0], after, state.substeps, centre) @ look.T / self.scale
            wider = -FINGER_SIDES[side] * K[:, 0] / 2  # as the face goes away
            out[:6, :6] -= look @ K / self.scale[:, None]
            out[:6, 6] -= look @ wider / self.scale
            out[6, :6] -= K[2] / 2
            out[6, 6] -= wider[2] / 2
        return out

    def _residual(self, at: Trial, free: Array) -> Array:
        """(k + 1,) [N]: in the free directions, and of the prescribed force, in its power 2/3 as in force_control."""
        short = 0.0
        if math.isfinite(self.force):
            short = 1.5 * self.force ** (1 / 3) * (max(at.grip, 0.0) ** (2 / 3) - self.force ** (2 / 3))
        return np.append(free.T @ ((at.wrench + self.load) / self.scale), short)

    def _newton(self, at: Trial, mode: Mode, lowest: float = math.inf, bounded: bool = False) -> Trial | None:
        """Newton's method from a trial; None if a held object seems to sink below `lowest`, unless it is known to be
        held above (`bounded`). Raises NotConverged."""
        free, forced = self._free(mode), math.isfinite(self.force)
        cap = min(problem.edge for problem in self.problems)
        r = self._residual(at, free)
        while not (
            np.linalg.norm(r[:-1]) <= self.balanced * self._least(at)
            and (not forced or abs(at.grip - self.force) <= self.tol * self.force)
        ):
            J = self._tangent(at)
            A = np.zeros((len(r), len(r)))
            A[:-1, :-1], A[:-1, -1] = free.T @ J[:6, :6] @ free, free.T @ J[:6, 6]
            if forced:
                slope = (self.force / max(at.grip, 1e-3 * self.force)) ** (1 / 3)
                A[-1, :-1], A[-1, -1] = slope * (J[6, :6] @ free), slope * J[6, 6]
            else:
                A[:, -1] = 0.0
            step = np.linalg.lstsq(A, -r, rcond=MIN_STIFFNESS_RATIO)[0]
            if not step.any():  # without contact the tangent is zero, and the pose would not change
                if lowest < math.inf and not bounded and self.unborne(at) > 0:
                    return None
                raise NotConverged(Failure.grasp_loose, width=at.width, opening=self.grasp.opening)
            step *= min(1.0, cap / np.abs(step).max())
            here, there = self._sunk(at.pose), self._sunk(self._moved(at.pose, free @ step[:-1]))
            if there > lowest:
                if not bounded:
                    return None
                step *= (lowest - here) / (there - here) / 2
            before, (at, r) = np.linalg.norm(r), self._line_search(at, r, free, step)
            if lowest < math.inf and not bounded and np.linalg.norm(r) >= before and self.unborne(at) > 0:
                return None
        return at

    def _line_search(self, at: Trial, r: Array, free: Array, step: Array) -> tuple[Trial, Array]:
        """The first fraction of a Newton step that lowers the residual, or the shortest one."""

        def attempt(part: float) -> tuple[bool, tuple[Trial, Array]]:
            pose, width = self._moved(at.pose, part * free @ step[:-1]), at.width + part * step[-1]
            try:
                trial = self._trial(pose, width, at)
            except NotConverged:
                if part <= MIN_GRASP_STEP or self.trials > MAX_GRASP_TRIALS:
                    raise
                return False, (at, r)
            there = self._residual(trial, free)
            less = np.linalg.norm(there) < np.linalg.norm(r) and (trial.grip > 0 or at.grip == 0)
            return bool(less), (trial, there)

        _, last = backtrack(attempt, MIN_GRASP_STEP)
        assert last is not None
        return last

    def _moved(self, pose: Array, step: Array) -> Array:
        """Shifted and turned about the centre of mass, by a scaled step (6,)."""
        out, turn = pose.copy(), step[3:] / self.arm
        out[:3, :3] = about(turn, 1.0) @ pose[:3, :3]
        out[:3, 3] += self._centre(pose) + step[:3] - self._centre(out)
        return out


def presolved(grasp: GraspScene) -> GraspScene:
    """The grasp with meshes that are fine where a solve on coarse ones has the object (see presolve); if that fails, at
    the poses found so far and at those of the recipe's movements. Where the final edges are as long, only at these."""
    rough = [coarsened(scene) for scene in grasp.fingers]
    if all(scene.edge >= coarse.edge for scene, coarse in zip(grasp.fingers, rough, strict=True)):
        return grasp
    problems = tuple(Problem.of(scene, mesh.of(scene)) for scene in rough)
    poses: tuple[list[Array], list[Array]] = ([], [])
    try:
        for frame in held(grasp, problems, tol=0.05):  # type: ignore[arg-type]
            for path, state in zip(poses, frame.states, strict=True):
                path.append(state.pose)
    except NotConverged:
        for path, scene in zip(poses, grasp.fingers, strict=True):
            path.extend(scene.poses)
    return refined(grasp, poses)
