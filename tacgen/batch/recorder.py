"""The bundle of one gel of a scene: its labels and pictures, frame by frame, and what else a reader needs to know."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar, cast

import numpy as np

from tacgen import mechanics
from tacgen.base.clock import Clock
from tacgen.bundle import bundle, frame_notes, kept_files
from tacgen.bundle.schema import as_stored, finite_problem
from tacgen.geometry.first_touch import closest
from tacgen.mechanics import mesh
from tacgen.mechanics.cost_note import cost_note
from tacgen.mechanics.expected_error import Expected, frame_error
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.outputs import BLOCK_OUTPUTS, IMAGE_OUTPUTS, MAP_OUTPUTS, OUTPUT_NAMES, OUTPUTS, POSITIONS_OUTPUT
from tacgen.outputs.base import Datasets
from tacgen.outputs.scene_data import FrameData, SceneData
from tacgen.recipe.row import Row

if TYPE_CHECKING:
    from tacgen.mechanics.grasp_balance import Held
    from tacgen.outputs.gel_surface import GelSurface
    from tacgen.render.pictures import Pictures, PictureSettings
    from tacgen.sensor.model import LitSensor

MIN_NOTED_ERROR = 0.1  # expected error of the force by the mesh [-], above which a run tells it
OnEvent = Callable[[dict[str, Any]], None]
Data = TypeVar("Data", SceneData, FrameData)


@dataclass(frozen=True)
class SceneWork:
    """A scene to make: its row; who is told of its events; the solution that another engine has found, and PyTorch's
    device that draws its frames where it can; and the seconds of its stages."""

    row: Row
    on_event: OnEvent = lambda event: None
    solution: SolvedScene | None = None
    device: str | None = None
    clock: Clock = field(default_factory=Clock)

    @property
    def known(self) -> SolvedScene | None:
        """The solution, if it has the scene's states."""
        return self.solution if self.solution and self.solution.states else None

    def tell(self, event: str, **what: object) -> None:
        """Pass on an event of this scene."""
        self.on_event({"event": event, "scene": self.row.name, **what})


class Solvable(NamedTuple):
    """A gel of a scene with a bundle of its own: the only one, or one finger's of a grasp."""

    row: Row
    scene: Scene
    problem: mechanics.Problem


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


class Recorder:
    """Labels, renders and writes one gel's bundle."""

    def __init__(self, work: SceneWork, gel: Solvable, path: Path) -> None:
        row, self.scene, _ = gel
        self.work, self.clock = work, work.clock
        self.poses: list[np.ndarray] = []
        self.said: list[str] = []  # of frames that are not as a table wants them
        blocks = {name for name in BLOCK_OUTPUTS if getattr(row.recipe, name) is not None}
        asked = {"force", *row.recipe.outputs, *blocks}
        asked |= {POSITIONS_OUTPUT} if asked & MAP_OUTPUTS else set()
        self.before: mechanics.State | None = None
        with self.clock.stage("fields"):
            self.shared = _shared(work, gel)
        made = {k: output.reference for k, output in OUTPUTS.items() if k in asked}
        images = {k: made.pop(k) for k in OUTPUT_NAMES if k in IMAGE_OUTPUTS & made.keys()}
        found = _datasets(made, self.shared, self.clock)
        self.pictures: Pictures | None = None
        if images:
            with self.clock.stage("render"):
                self.pictures = self.shared.pictures
        found |= kept_files.of(row)
        self.reference = _finite(found | _datasets(images, self.shared, self.clock))
        self.of_frame = {k: output.frame for k, output in OUTPUTS.items() if k in asked}
        attributes = _attributes(work, gel, self.shared)
        self.name, self.touched = row.name, False
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
            self.work.on_event({"event": "note", "scene": self.name, "note": note})

    @property
    def gap(self) -> float:
        """How close the indenter came to the untouched face [mm]."""
        return closest(self.scene.shape, self.scene.gel, np.array(self.poses))

    def finish(self, status: Literal["ok", "rejected"], reason: str, notes: Sequence[str]) -> bundle.Bundle:
        """Close the bundle; `reason` says why it is rejected, or has not all frames."""
        late = [*(self.pictures.notes if self.pictures else []), *notes]
        self._tell([*late, *frame_notes.summary(self.said, len(self.poses))])
        return self.writer.finish(status, reason, [*late, *self.said], self.pictures.name if self.pictures else None)

    def labelled(self, state: mechanics.State, held: "tuple[Held, int] | None") -> Datasets:
        """The datasets of a frame. Raises Rejected: a label is not finite."""
        with self.clock.stage("fields"):
            frame = _finite(_datasets(self.of_frame, FrameData(self.shared, state, self.before, held), self.clock))
            self.before, self.touched = state, self.touched or bool(frame["/frames/force"].any())
            self.poses.append(state.pose)
            self.said += [frame_notes.line(state.index, state.note)] if state.note else []
            frame["/frames/segment"] = self.scene.segment[state.index]
            scene, known = self.scene, self.scene.element != "linear_tet"
            error = frame_error(scene.gel, scene.shape, state.pose, scene.edge) if known else math.nan
            frame["/frames/quality/expected_force_error"] = error
            if self.scene.duration is not None:
                frame["/frames/time"] = self.scene.duration[: state.index + 1].sum()
            return frame


def picture_settings(row: Row) -> "PictureSettings":
    """How the pictures of a row are made; its sensor has lights, which the recipe's checks ask for."""
    from tacgen.render.pictures import PictureSettings

    recipe, sensor = row.recipe, cast("LitSensor", row.sensor)
    render, spp = recipe.render, recipe.resolved().spp
    return PictureSettings(sensor, render.method, spp, row.seed, render.noise, row.photo_path, recipe.outputs)


def _attributes(work: SceneWork, gel: Solvable, shared: SceneData) -> dict[str, Any]:
    from importlib.metadata import version

    row, built, problem = gel
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
    with work.clock.stage("mesh"):
        found["mesh"] = mesh.quality(built.gel, problem.mesh)
        cost = cost_note(built, len(problem.mesh.facets["coated"])) if problem.condensed else ""
    if row.finger is not None:
        found["finger"] = row.finger
    if row.recipe.outputs & IMAGE_OUTPUTS:
        with work.clock.stage("render"):
            found["renderer"] = shared.pictures.name
    expected = Expected.of(built)
    coarse = expected.note() if expected and expected.error > MIN_NOTED_ERROR else ""
    if row.pair is not None:
        found["pair"] = row.pair
    if work.known:
        found["solver"] = work.known.engine
    else:
        versions = (f"{package} {version(package)}" for package in ("numpy", "scipy", "warp-lang"))
        found["solver"] = ", ".join([problem.linear.name, *versions])
    elsewhere = "" if work.solution is None else work.solution.why
    if said := [note for note in (coarse, cost, elsewhere, kept_files.note(row), *row.notes) if note]:
        found["notes"] = said
    return found


def _shared(work: SceneWork, gel: Solvable) -> SceneData:
    """A scene as its outputs need it, with the choices of its recipe."""

    def pictures(untouched: "GelSurface") -> "Pictures":
        from tacgen.render.pictures import Pictures

        return Pictures(picture_settings(row), untouched, work.device)

    (row, scene, problem), unsure = gel, gel.row.recipe.uncertainty
    return SceneData(
        row.sensor,
        problem,
        pictures,
        asked=row.recipe.outputs,
        analytic=row.recipe.markers.method == "analytic",
        deviations=None if unsure is None else unsure.deviations,
        again=scene if unsure and unsure.mesh else None,
        known=work.solution.states if work.solution else (),
        match=scene.match,
    )
