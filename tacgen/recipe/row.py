"""One scene of a plan, and the key of its inputs."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from tacgen.recipe import assets
from tacgen.recipe.checks import BACKGROUND_KEY, timed
from tacgen.recipe.loading import SOLID_FILE_KEY
from tacgen.recipe.model import Recipe
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.trajectory_checks import Folders, replayed
from tacgen.sensor.imperfections import NOISE_STREAM
from tacgen.sensor.model import Sensor
from tacgen.sensor.yaml_source import KeyPath

KEY_FORMAT = 1  # of the bundles that keys stand for


@dataclass(frozen=True)
class Row:
    """One scene, resolved: nothing is left to draw or to look up."""

    index: int
    name: str  # scene-00000
    seed: int  # of this scene's noise
    recipe: Recipe  # without vary; varied values are in it
    sensor: Sensor  # overrides are in it; of a grasp the left finger's
    values: dict[str, Any] = field(default_factory=dict)  # varied path -> this scene's value
    folders: Mapping[KeyPath, Path] = field(default_factory=dict)  # where the paths of its files start
    other: Sensor | None = None  # of a grasp the other finger's
    finger: Literal["left", "right"] | None = None  # of one bundle of a grasp
    pair: int | None = None  # number of the contact, where a recipe has each on several sensors

    @property
    def key(self) -> str:
        """SHA-256 over everything the bundle depends on: another key, another bundle."""
        inputs = [KEY_FORMAT, self.index, self.seed, self.document(), self.sensor_document()]
        if self.other is not None:
            inputs += [self.other.model_dump(mode="json", exclude_none=True), self.finger]
        inputs += [] if self.pair is None else [self.pair]
        return _sha256(inputs)

    @property
    def bundles(self) -> "tuple[Row, ...]":
        """A row for each bundle of the scene: for each finger of a grasp, otherwise the scene itself."""
        if self.other is None:
            return (self,)
        left = replace(self, name=f"{self.name}-L", finger="left")
        seed = scene_seed(self.seed, self.index)  # another noise than the left one's
        right = replace(self, name=f"{self.name}-R", finger="right", seed=seed, sensor=self.other, other=self.sensor)
        return left, right

    @property
    def frames(self) -> int:
        """How many frames the scene has."""
        return self.recipe.frames

    @property
    def notes(self) -> list[str]:
        """Notes on what has no effect, perhaps by mistake."""
        if not self.sensor.gel.viscous or timed(self.recipe, self.sensor):
            return []
        return ["no movement says how long it takes: every frame is an equilibrium, and the gel's prony has no effect"]

    def document(self) -> dict[str, Any]:
        """The resolved recipe as JSON values; read back, it gives this scene again. Files are named with their
        hashes."""
        plain = self.recipe.document()
        if self.recipe.indenter.shape == "mesh":
            plain["indenter"]["sha256"] = assets.sha256(self.mesh_path)
        if (picture := self.photo_path) is not None:
            plain["render"]["background_sha256"] = assets.sha256(picture)
        return plain

    @property
    def photo_path(self) -> Path | None:
        """The photograph behind the pictures, if there is one."""
        name = self.recipe.render.background
        return None if name is None else assets.beside(name, self.folders.get(BACKGROUND_KEY))

    @property
    def mesh_path(self) -> Path:
        """The file of an indenter that is a mesh."""
        assert self.recipe.indenter.shape == "mesh"
        return assets.mesh_path(self.recipe.indenter.file, self.folders.get(("indenter", "file")))

    def replayed(self, segment: int) -> tuple[TimedPose, ...]:
        """The poses of a segment that is a replay, one a frame, in the sensor's frame."""
        move = self.recipe.trajectory[segment].replay
        assert move is not None
        return replayed(move, self.folders.get(("trajectory", segment, "replay", "file")))

    @property
    def solid_path(self) -> Path | None:
        """The file of a gel that is a solid; None for a pad."""
        solid, folder = self.sensor.gel.solid, self.folders.get(("sensor", *SOLID_FILE_KEY))
        return None if solid is None else assets.mesh_path(solid.file, folder)

    def sensor_document(self) -> dict[str, Any]:
        """The resolved sensor as JSON values; a solid is named with its hash."""
        plain: dict[str, Any] = self.sensor.model_dump(mode="json", exclude_none=True)
        if path := self.solid_path:
            plain["gel"]["solid"]["sha256"] = assets.sha256(path)
        return plain

    @property
    def sensor_sha256(self) -> str:
        """SHA-256 of the resolved sensor."""
        return _sha256(self.sensor_document())


def resolved(recipe: Recipe, folders: Folders) -> Recipe:
    """The recipe with the hashes and the numbers of frames of its pose tables filled in."""
    steps = []
    for i, step in enumerate(recipe.trajectory):
        if step.replay:
            folder = folders.get(("trajectory", i, "replay", "file"))
            sha256 = assets.sha256(assets.beside(step.replay.file, folder))
            known = {"frames": len(replayed(step.replay, folder)), "sha256": sha256}
            step = step.model_copy(update={"replay": step.replay.model_copy(update=known)})
        steps.append(step)
    return recipe.model_copy(update={"trajectory": tuple(steps)})


def scene_seed(seed: int, index: int) -> int:
    """The seed of one scene's noise."""
    from numpy.random import SeedSequence

    return int(SeedSequence((seed, index, NOISE_STREAM)).generate_state(1)[0])


def _sha256(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
