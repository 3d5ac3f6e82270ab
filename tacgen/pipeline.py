"""One scene down the line. What its outputs do not need is neither imported nor computed."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from tacgen import solve
from tacgen.bundle import bundle, resume
from tacgen.bundle.resume import SceneResult
from tacgen.contact.barrier import Contact, Pose
from tacgen.contact.tunnelling import overlap
from tacgen.errors import UserError
from tacgen.geometry.gel import Gel
from tacgen.recipe import background_photo
from tacgen.recipe.model import IMAGES
from tacgen.recipe.plan import NOISE, Row
from tacgen.recipe.sensor import LitSensor
from tacgen.scene import mesh, scene
from tacgen.solve import foresee

if TYPE_CHECKING:
    from tacgen.labels.gel_surface import Surface

Array = np.ndarray
ON_FACE = ("traction", "force_map")  # outputs: what the contact does to the face
SEEN = ("height", "normals", "gap")  # what the face looks like
PRINTED = ("markers", "flow", "material")  # what is on the coating
RESOLVED = 3  # edges of the mesh that an indenter's smallest radius should have
Say = Callable[[dict[str, Any]], None]


class Clock:
    """Seconds spent in each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


class Products:
    """What a scene's outputs ask for beyond the solve: datasets of the reference, the mesh and each frame."""

    def __init__(self, row: Row, problem: solve.Problem, clock: Clock) -> None:
        from tacgen.labels import gel_surface

        self.row = row
        self.outputs, self.problem, self.clock, self.fields = row.recipe.outputs, problem, clock, gel_surface
        if self.outputs & {*ON_FACE, *SEEN, *PRINTED, *IMAGES}:
            from tacgen.optics.camera import Camera

            self.camera = Camera.from_sensor(row.sensor)
            self.surface = gel_surface.Surface(problem.mesh.points, problem.mesh.facets["coated"])
        if self.outputs & {*PRINTED, *IMAGES}:
            self.seen = gel_surface.seen(problem.mesh, len(row.sensor.gel.clear_layers))
        if self.outputs & {*SEEN, *PRINTED}:
            from tacgen.optics.surface_grid import Sheet

            self.sheet = Sheet.over(row.sensor.gel, 0.1)
        if "stress" in self.outputs:
            from tacgen.labels.stress import Stresses

            self.stresses = Stresses(problem)
        if "markers" in self.outputs:
            from tacgen.optics.coating import centers

            if row.sensor.markers is None:
                raise UserError(f"outputs: the sensor {row.sensor.name} has no markers")
            rest, motion = centers(row.sensor.markers), row.sensor.markers.motion
            self.dots: Callable[[solve.State, Surface], tuple[Array, Array]]
            if row.recipe.markers.method == "analytic" and motion is not None:
                from tacgen.labels.fots_markers import Drift

                drift = Drift(motion, rest, row.sensor.gel, problem.contact.shape, self.camera)
                self.undisturbed, self.dots = drift.undisturbed, lambda state, _: drift.at(state.pose)
            else:
                from tacgen.optics.material_flow import Points

                points = Points(rest, self.sheet, self.seen, self.camera)
                self.undisturbed, self.dots = points.undisturbed, lambda _, coating: points.at(coating)
        if "flow" in self.outputs:
            from tacgen.optics.material_flow import Flow

            self.flow = Flow(self.sheet, self.seen, self.camera)
        if self.outputs & IMAGES:
            from tacgen.render.images import Renderer

            with clock.stage("render"):
                spp = row.recipe.resolved().spp
                lit = cast(LitSensor, row.sensor)  # limits.py lets no other through
                at_rest = None if lit.gel.solid is None else self.seen
                self.renderer = Renderer(
                    lit, spp, row.seed, lit.markers is not None, method=row.recipe.render.method, untouched=at_rest
                )
                self.flat = self.renderer.flat()
                photograph = row.photo_path
                self.behind = (
                    None if photograph is None else background_photo.Backdrop(photograph, self.flat, lit.camera)
                )

    def still(self) -> dict[str, Array]:
        """Datasets that do not change from frame to frame."""
        out: dict[str, Array] = {}
        if self.outputs & {"height", "normals"}:
            view = self.fields.View(self.sheet, self.surface, self.camera)
            out |= {
                f"/reference/{name}": getattr(view, name)() for name in ("height", "normals") if name in self.outputs
            }
        if "markers" in self.outputs:
            out["/reference/markers"] = self.undisturbed
        if "rgb" in self.outputs:
            with self.clock.stage("render"):
                out["/reference/rgb"] = self.renderer.develop(self._composed(self.flat))
        if "stress" in self.outputs:
            m = self.problem.mesh
            out.update({"/mesh/points": m.points, "/mesh/cells": m.cells, "/mesh/layer": m.layer})
            out.update({f"/mesh/facets/{name}": quads for name, quads in m.facets.items()})
        return out

    def frame(self, state: solve.State, segment: int) -> dict[str, Array]:
        """Datasets of one frame."""
        with self.clock.stage("fields"):
            out = self._labels(state, segment)
        if self.outputs & IMAGES:
            with self.clock.stage("render"):
                radiance = self._composed(self.renderer.image(self.seen.moved(state.x)))
                if "rgb" in self.outputs:
                    out["/frames/rgb"] = self.renderer.develop(radiance, self._random(state.index))
                if "radiance" in self.outputs:
                    out["/frames/radiance"] = radiance
        return out

    def _composed(self, radiance: Array) -> Array:
        """With the photograph behind it, where there is one."""
        return radiance if self.behind is None else self.behind.under(radiance)

    def _random(self, frame: int) -> "np.random.Generator | None":
        """Numbers for the camera's noise in one frame, whoever computes it; None for none."""
        words = (self.row.seed, frame, NOISE)
        return np.random.default_rng(np.random.SeedSequence(words)) if self.row.recipe.render.noise else None

    def _labels(self, state: solve.State, segment: int) -> dict[str, Array]:
        force, torque = self.fields.wrench(self.problem, state)
        out: dict[str, Any] = {
            "/frames/pose": state.pose,
            "/frames/segment": segment,
            "/frames/force": force,
            "/frames/torque": torque,
            "/frames/quality/newton_iterations": state.iterations,
            "/frames/quality/substeps": state.substeps,
            "/frames/quality/min_gap_mm": state.min_gap,
            "/frames/quality/mean_gap_mm": state.mean_gap,
            "/frames/quality/overlap_mm": self._overlap(state),
            "/frames/quality/rounded": state.rounded,
            "/frames/quality/force_balance": state.balance,
            "/frames/quality/residual": state.residual,
            "/frames/quality/least_jacobian": state.least_J,
        }
        if self.outputs & {*ON_FACE, *SEEN}:
            surface = self.surface.moved(state.x)
        if self.outputs & {*ON_FACE}:
            out |= self._maps(surface, state)
        if self.outputs & {*SEEN}:
            out |= self._seen(surface, state)
        if self.outputs & {*PRINTED}:
            coating = self.seen.moved(state.x)
        if "markers" in self.outputs:
            pixels, shown = self.dots(state, coating)
            flow = pixels - self.undisturbed
            out |= {"/frames/markers": pixels, "/frames/marker_flow": flow, "/frames/marker_visible": shown}
        if "flow" in self.outputs:
            out["/frames/flow"] = self.flow.at(coating)
        if "material" in self.outputs:
            from tacgen.optics.material_flow import behind

            out["/frames/material"] = behind(self.sheet, coating, self.camera)
        if "stress" in self.outputs:
            stress = self.stresses.at(state.x)
            out["/fields/displacement"] = state.x - self.problem.mesh.points
            out |= {"/fields/cauchy_stress": stress.element, "/fields/nodal_stress": stress.node}
            quality = self.stresses.quality(stress, state)
            out |= {f"/frames/quality/{name}": value for name, value in quality.items()}
        return {path: np.asarray(value) for path, value in out.items()}

    def _overlap(self, state: solve.State) -> float:
        contact = self.problem.contact.moved(Pose.of(state.pose), state.offset)
        return overlap(contact if isinstance(contact, Contact) else contact.distance, state.x)

    def _maps(self, surface: "Surface", state: solve.State) -> dict[str, Array]:
        """What the contact does to the face."""
        from tacgen.labels.contact_maps import maps

        found, out = maps(self.problem, surface, state, self.camera), {}
        if "traction" in self.outputs:
            out = {f"/frames/{name}": getattr(found, name) for name in ("pressure", "traction", "contact")}
            out |= {"/frames/slip": found.slip} if state.sliding is not None else {}
        if "force_map" in self.outputs:
            out |= {"/frames/force_map": found.force, "/frames/area": found.area}
        return out

    def _seen(self, surface: "Surface", state: solve.State) -> dict[str, Array]:
        """What the face looks like."""
        view, out = self.fields.View(self.sheet, surface, self.camera), {}
        if "height" in self.outputs:
            out["/frames/height"] = view.height()
        if "normals" in self.outputs:
            out["/frames/normals"] = view.normals()
        if "gap" in self.outputs:
            out["/frames/gap"] = view.gap(self.problem.contact.shape, state.pose)
        return out


def _attributes(row: Row, gel: Gel, problem: solve.Problem, products: Products) -> dict[str, Any]:
    from importlib.metadata import version

    found: dict[str, Any] = {
        "recipe": row.document(),
        "scene_index": row.index,
        "seed": row.seed,
        "sensor": row.sensor.name,
        "sensor_sha256": row.sensor_sha256,
        "sensor_document": row.sensor_document(),
        "input_key": row.key,
        "solver": ", ".join([problem.linear.name, *(f"{p} {version(p)}" for p in ("numpy", "scipy", "numba"))]),
        "values": row.values,
        "mesh": mesh.quality(gel, problem.mesh),
    }
    formulation = row.recipe.contact.formulation
    found["contact"] = f"ipctk {version('ipctk')}" if formulation == "ipctk" else formulation
    if row.recipe.outputs & IMAGES:
        found["renderer"] = f"mitsuba {version('mitsuba')} {products.renderer.variant}"
    if note := _sharp(problem.contact.shape.smallest_radius, problem.edge, formulation):
        found["notes"] = [note]
    return found


def _sharp(radius: float, edge: float, formulation: str) -> str:
    """What to say of an indenter that the mesh does not resolve; `tacgen bench mechanics` measures by how much."""
    if radius >= RESOLVED * edge:
        return ""
    small = f"the indenter's smallest radius, {radius:g} mm, is below"
    if radius >= edge:
        return (
            f"{small} {RESOLVED} edges of the mesh, {edge:g} mm: where such bends bear the load forces are 1 to 6 % off"
        )
    off = "up to half too high" if formulation == "ipctk" else "up to a fifth off, of tips two fifths"
    return (
        f"{small} the mesh's edge, {edge:g} mm: details that fine are not resolved, and where they bear the load forces"
        f" are {off}"
    )


def run_scene(row: Row, folder: Path, *, overwrite: bool = False, say: Say | None = None) -> SceneResult:
    """Solve, label, render and write one scene; a finished bundle of the same inputs is kept unless `overwrite`.

    `say` hears an event after each frame: `{"event": "frame", "scene": "scene-00000", "frame": 3, "frames": 15}`.

    Raises:
        UserError: the bundle's place is taken by a file made from other inputs.
        partfile.Busy: another process is making this very bundle.
    """
    return resume.once(row, folder, lambda path: _make(row, path, say), overwrite=overwrite)


def _make(row: Row, path: Path, say: Say | None) -> SceneResult:
    """The work itself: everything between a row of the plan and its bundle."""
    clock = Clock()
    with clock.stage("start"):
        solve.warm()
    with clock.stage("mesh"):
        built = foresee.foreseen(scene.build(row))
        problem = solve.Problem.of(built, mesh.of(built))
    products = Products(row, problem, clock)
    reason = ""
    attributes = _attributes(row, built.gel, problem, products)
    if say:
        for note in attributes.get("notes", ()):
            say({"event": "note", "scene": row.name, "note": note})
    with bundle.Writer(path, attributes, row.frames) as writer:
        for name, array in products.still().items():
            writer.put(name, array)
        states = solve.states(built, problem)
        while True:
            try:
                with clock.stage("solve"):
                    state = next(states, None)
            except solve.NotConverged as problem_found:
                reason = f"frame {writer.appended + 1} of {row.frames}: {problem_found}"
                break
            if state is None:
                break
            frame = products.frame(state, int(built.segment[state.index]))
            if built.dynamics is not None:
                frame["/frames/time"] = built.dynamics.duration[: state.index + 1].sum()
            with clock.stage("bundle"):
                writer.append(frame)
            if say:
                say({"event": "frame", "scene": row.name, "frame": state.index + 1, "frames": row.frames})
        with clock.stage("bundle"):
            writer.finish("rejected" if reason else "ok", reason)
    seconds = {name: round(value, 4) for name, value in clock.seconds.items()}
    path.with_suffix(".timing.json").write_text(json.dumps({"frames": row.frames, "seconds": seconds}, indent=1) + "\n")
    return SceneResult(row.name, path, "rejected" if reason else "ok", reason, row.frames, seconds)


def run(rows: Sequence[Row], folder: Path, *, overwrite: bool = False, say: Say | None = None) -> list[SceneResult]:
    """Every scene in order, in this process; tacgen.batch spreads them over others.

    Raises:
        UserError: before anything is computed, if a bundle of other inputs is in the way.
    """
    if not overwrite:
        resume.refuse_foreign(rows, folder)
    return [run_scene(row, folder, overwrite=overwrite, say=say) for row in rows]
