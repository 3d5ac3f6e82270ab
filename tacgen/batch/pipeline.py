"""One scene down the line. What its outputs do not need is neither imported nor computed."""

import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from tacgen import mechanics
from tacgen.base import array_cache, atomic_file, compiled
from tacgen.base.clock import Clock
from tacgen.bundle import bundle, kept_files, resume
from tacgen.bundle.resume import SceneResult
from tacgen.bundle.schema import as_stored, finite_problem
from tacgen.geometry.first_touch import closest
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.cost_note import cost_note
from tacgen.mechanics.expected_error import Expected, frame_error
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.outputs import BLOCK_OUTPUTS, IMAGE_OUTPUTS, MAP_OUTPUTS, OUTPUT_NAMES, OUTPUTS, POSITIONS_OUTPUT
from tacgen.outputs.base import Datasets
from tacgen.outputs.scene_data import FrameData, SceneData
from tacgen.recipe import approach, scene_of_row
from tacgen.recipe.row import Row

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

    from tacgen.mechanics.grasp_balance import Held
    from tacgen.outputs.gel_surface import GelSurface
    from tacgen.render.pictures import Pictures

MIN_NOTED_ERROR = 0.1  # expected error of the force by the mesh [-], above which a run tells it
STRESS_OUTPUTS = {"stress", "surface_stress"}  # outputs that need the gel's elements
# entries of the cache that take long, by the event that tells of them; tables come first of a sensor's images
TOLD_ENTRIES = {compiled.COMPILED_ENTRY: "compiling", "untouched": "tracing", "table": "tracing"}
OnEvent = Callable[[dict[str, Any]], None]
Data = TypeVar("Data", SceneData, FrameData)


class Rejected(ArithmeticError):
    """A frame that is solved, and has a label that cannot be kept; the message says which."""


def _datasets(made: dict[str, Callable[[Data], Datasets]], data: Data, clock: Clock) -> Datasets:
    """Datasets that outputs make of a scene or a frame; images count as another stage than labels."""
    found: Datasets = {}
    for name, datasets in made.items():
        with clock.stage("render" if name in IMAGE_OUTPUTS else "fields"):
            found |= datasets(data)
    return found


def _finite(found: Datasets) -> Datasets:
    """The datasets as they are stored. Raises Rejected: one of them is not finite."""
    with np.errstate(over="ignore"):  # to inf
        found = {path: as_stored(path, values) for path, values in found.items()}
    if wrong := next(filter(None, (finite_problem(path, values) for path, values in found.items())), None):
        raise Rejected(wrong)
    return found


def _attributes(
    row: Row, built: Scene, shared: SceneData, clock: Clock, solution: SolvedScene | None = None
) -> dict[str, Any]:
    from importlib.metadata import version

    problem = shared.problem
    found: dict[str, Any] = {
        "recipe": row.document(),
        "scene_index": row.index,
        "seed": row.seed,
        "sensor": row.sensor.name,
        "sensor_sha256": row.sensor_sha256,
        "sensor_document": row.sensor_document(),
        "input_key": row.key,
        "values": row.values,
    }
    with clock.stage("mesh"):
        found["mesh"] = mesh.quality(built.gel, problem.mesh)
        cost = cost_note(built, len(problem.mesh.facets["coated"])) if problem.condensed else ""
    if row.finger is not None:
        found["finger"] = row.finger
    if row.recipe.outputs & IMAGE_OUTPUTS:
        with clock.stage("render"):
            found["renderer"] = shared.pictures.name
    expected = Expected.of(built)
    coarse = expected.note() if expected and expected.error > MIN_NOTED_ERROR else ""
    if row.pair is not None:
        found["pair"] = row.pair
    if solution is not None and solution.states:
        found["solver"] = solution.engine
    else:
        versions = (f"{package} {version(package)}" for package in ("numpy", "scipy", "warp-lang"))
        found["solver"] = ", ".join([problem.linear.name, *versions])
    elsewhere = "" if solution is None else solution.why
    if said := [note for note in (coarse, cost, elsewhere, kept_files.note(row), *row.notes) if note]:
        found["notes"] = said
    return found


def run_scene(
    row: Row,
    folder: Path,
    *,
    overwrite: bool = False,
    on_event: OnEvent | None = None,
    solution: SolvedScene | None = None,
    device: str | None = None,
) -> SceneResult:
    """Solve, label, render and write one scene; a finished bundle of the same inputs is kept unless `overwrite`.

    A `solution` with states is taken instead of solving; `device`, PyTorch's, draws frames where it can.

    `on_event` is called after each frame: `{"event": "frame", "scene": "scene-00000", "frame": 3, "frames": 15}`.

    Raises:
        UserError: the bundle's place is taken by a file made from other inputs.
        atomic_file.Busy: another process is making this very bundle.
    """
    return resume.once(row, folder, lambda path: _make(row, path, on_event, solution, device), overwrite=overwrite)


def _make(
    row: Row, path: Path, on_event: OnEvent | None, solution: SolvedScene | None, device: str | None
) -> SceneResult:
    """The work itself, with one BLAS thread: more would add up in another order, and change the bytes."""

    def tell(kind: str) -> None:
        if on_event and kind in TOLD_ENTRIES:
            on_event({"event": TOLD_ENTRIES[kind], "scene": row.name})

    clock = Clock()
    with array_cache.telling(tell):
        with clock.stage("start"):
            mechanics.warm()  # every BLAS is loaded by now: a limit does not reach those that come later
            one_thread = _blas(len(sys.modules)).limit(limits=1, user_api="blas")
        with one_thread, clock.stage("bundle"):
            status, reason, done, bundles = _made(row, path, on_event, clock, solution, device)
    seconds = {name: round(value, 4) for name, value in clock.seconds.items()}
    timing = json.dumps({"frames": row.frames, "seconds": seconds}, indent=1) + "\n"
    atomic_file.write(path.with_suffix(".timing.json"), timing.encode(), sync=False)
    return SceneResult(row.name, path, status, reason, done, seconds, bundles)


@lru_cache(maxsize=1)
def _blas(modules: int) -> "ThreadpoolController":
    """The BLAS libraries of this process, looked for again when it has loaded more modules."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _shared(
    row: Row, scene: Scene, problem: mechanics.Problem, known: Sequence[mechanics.State] = (), device: str | None = None
) -> SceneData:
    """A scene as its outputs need it, with the choices of its recipe."""

    def pictures(untouched: "GelSurface") -> "Pictures":
        from tacgen.recipe import pictures_of_row
        from tacgen.render.pictures import Pictures

        return Pictures(pictures_of_row.settings(row), untouched, device)

    recipe, unsure = row.recipe, row.recipe.uncertainty
    return SceneData(
        row.sensor,
        problem,
        pictures,
        asked=recipe.outputs,
        analytic=recipe.markers.method == "analytic",
        deviations=None if unsure is None else unsure.deviations,
        again=scene if unsure and unsure.mesh else None,
        known=known,
    )


Solvable = tuple[Row, Scene, mechanics.Problem]  # of each bundle: one, or of a grasp the left and the right finger's
# of a frame: each gel's state, and of a grasp what holds the object and the number of the finger
Found = tuple[tuple[mechanics.State, "tuple[Held, int] | None"], ...]


def _gels(row: Row, clock: Clock, solution: SolvedScene | None = None) -> tuple[tuple[Solvable, ...], Iterator[Found]]:
    """The gels of a row of the plan, meshed, and what will be found at each frame."""
    if row.other is not None:
        return _grasped(row, clock)
    known = solution if solution and solution.states else None
    with clock.stage("mesh"):
        built = scene_of_row.build(row)
    if built.forced is not None:
        with clock.stage("presolve"):
            built = presolve.refined(built, known.heights) if known else presolve.presolved(built)
    if (expected := Expected.of(built)) is not None:
        expected.refuse()
    with clock.stage("mesh"):
        if known:
            stress = bool(row.recipe.outputs & STRESS_OUTPUTS)
            problem = mechanics.Problem.of_known_frames(built, mesh.of(built), stress=stress)
            states = iter(known.states)
        else:
            # a trial of a prescribed force may fold where its solution does not: its frames stop such a scene
            through = row.recipe.folds == "keep" or built.forced is not None
            problem = mechanics.Problem.of(
                built, mesh.of(built), replace(mechanics.DEFAULT_OPTIONS, through_folds=through)
            )
            states = mechanics.states(built, problem)
    return ((row, built, problem),), (((state, None),) for state in states)


def _grasped(row: Row, clock: Clock) -> tuple[tuple[Solvable, ...], Iterator[Found]]:
    """The two gels of a grasp, meshed, and the states of both at each frame."""
    from tacgen.mechanics import grasp_balance as holding
    from tacgen.recipe import grasp_of_row as two_fingers

    with clock.stage("mesh"):
        grasp = two_fingers.build(row)
    with clock.stage("presolve"):
        grasp = holding.presolved(grasp)
    with clock.stage("mesh"):
        each = zip(row.bundles, grasp.fingers, strict=True)
        left, right = ((finger, built, holding.problem_of(built)) for finger, built in each)
    frames = holding.held(grasp, (left[2], right[2]))
    return (left, right), (tuple((state, (held, side)) for side, state in enumerate(held.states)) for held in frames)


class Recorder:
    """Labels, renders and writes one gel's bundle."""

    def __init__(
        self,
        solvable: Solvable,
        path: Path,
        clock: Clock,
        on_event: OnEvent | None,
        solution: SolvedScene | None,
        device: str | None,
    ) -> None:
        (row, self.scene, problem), self.clock = solvable, clock
        self.poses: list[np.ndarray] = []
        asked = {"force", *row.recipe.outputs} | {
            name for name in BLOCK_OUTPUTS if getattr(row.recipe, name) is not None
        }
        asked |= {POSITIONS_OUTPUT} if asked & MAP_OUTPUTS else set()
        self.before: mechanics.State | None = None
        with clock.stage("fields"):
            self.shared = _shared(row, self.scene, problem, solution.states if solution else (), device)
        made = {k: output.reference for k, output in OUTPUTS.items() if k in asked}
        images = {k: made.pop(k) for k in OUTPUT_NAMES if k in IMAGE_OUTPUTS & made.keys()}
        found = _datasets(made, self.shared, clock)
        self.pictures: Pictures | None = None
        if images:
            with clock.stage("render"):
                self.pictures = self.shared.pictures
        found |= kept_files.of(row)
        self.reference = _finite(found | _datasets(images, self.shared, clock))
        self.of_frame = {k: output.frame for k, output in OUTPUTS.items() if k in asked}
        attributes = _attributes(row, self.scene, self.shared, clock, solution)
        self.name, self.on_event, self.touched = row.name, on_event, False
        self._tell(attributes.get("notes", ()))
        self.writer = bundle.Writer(path, attributes, row.frames)

    def __enter__(self) -> "Recorder":
        self.writer.__enter__()
        for name, array in sorted(self.reference.items(), key=lambda item: item[0].startswith("/mesh")):
            self.writer.put(name, array)
        return self

    def __exit__(self, *error: object) -> None:
        self.writer.__exit__(*error)

    def _tell(self, found: Sequence[str]) -> None:
        for note in found:
            if self.on_event:
                self.on_event({"event": "note", "scene": self.name, "note": note})

    @property
    def gap(self) -> float:
        """How close the indenter came to the untouched face [mm]."""
        return closest(self.scene.shape, self.scene.gel, np.array(self.poses))

    def finish(self, status: Literal["ok", "rejected"], reason: str, notes: Sequence[str]) -> bundle.Bundle:
        """Close the bundle; `reason` says why it is rejected, or has not all frames."""
        late = [*(self.pictures.notes if self.pictures else []), *notes]
        self._tell(late)
        return self.writer.finish(status, reason, late, self.pictures.name if self.pictures else None)

    def labelled(self, state: mechanics.State, held: "tuple[Held, int] | None") -> Datasets:
        """The datasets of a frame. Raises Rejected: a label is not finite."""
        with self.clock.stage("fields"):
            frame = _finite(_datasets(self.of_frame, FrameData(self.shared, state, self.before, held), self.clock))
            self.before, self.touched = state, self.touched or bool(frame["/frames/force"].any())
            self.poses.append(state.pose)
            frame["/frames/segment"] = self.scene.segment[state.index]
            scene, known = self.scene, self.scene.element != "linear_tet"
            error = frame_error(scene.gel, scene.shape, state.pose, scene.edge) if known else math.nan
            frame["/frames/quality/expected_force_error"] = error
            if self.scene.duration is not None:
                frame["/frames/time"] = self.scene.duration[: state.index + 1].sum()
            return frame


def _made(
    row: Row, path: Path, on_event: OnEvent | None, clock: Clock, solution: SolvedScene | None, device: str | None
) -> tuple[Literal["ok", "rejected"], str, int, tuple[bundle.Bundle, ...]]:
    """Everything between a row of the plan and its bundles, the first of which is `path`: their status and its reason,
    how many frames they have, and the bundles."""
    gels, frames = _gels(row, clock, solution)
    status: Literal["ok", "rejected"] = "ok"
    reason, done = "", 0
    notes: list[str] = []
    with ExitStack() as stack:
        places = [path.with_name(f"{each.name}.h5") for each, _, _ in gels]
        recorders = [
            stack.enter_context(Recorder(gel, place, clock, on_event, solution, device))
            for gel, place in zip(gels, places, strict=True)
        ]
        while True:
            try:
                with clock.stage("solve"):
                    found = next(frames, None)
                if found is None:
                    break
                if row.recipe.folds == "end" and any(state.damped for state, _ in found):
                    raise mechanics.NotConverged(mechanics.Failure.folds)
                labelled = [recorder.labelled(*each) for recorder, each in zip(recorders, found, strict=True)]
                for recorder, frame in zip(recorders, labelled, strict=True):
                    recorder.writer.append(frame)
            except (mechanics.NotConverged, Rejected) as error:
                folded = isinstance(error, mechanics.NotConverged) and error.failure is mechanics.Failure.folds
                status, before = ("ok", "ends before ") if folded and done else ("rejected", "")
                reason = f"{before}frame {done + 1} of {row.frames}: {error}"
                break
            done += 1
            if on_event:
                on_event({"event": "frame", "scene": row.name, "frame": done, "frames": row.frames})
        if not reason and not any(recorder.touched for recorder in recorders):
            fine, said = approach.verdict(row.recipe, min(recorder.gap for recorder in recorders))
            status, reason, notes = ("ok", "", [said]) if fine else ("rejected", said, [])
        return status, reason, done, tuple(recorder.finish(status, reason, notes) for recorder in recorders)


def run(
    rows: Sequence[Row], folder: Path, *, overwrite: bool = False, on_event: OnEvent | None = None
) -> list[SceneResult]:
    """Every scene in order, in this process; tacgen.batch spreads them over others.

    Raises:
        UserError: before anything is computed, if a bundle of other inputs is in the way.
    """
    if not overwrite:
        resume.existing(rows, folder)
    return [run_scene(row, folder, overwrite=overwrite, on_event=on_event) for row in rows]
