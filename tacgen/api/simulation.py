"""A contact computed, or a recipe run, from Python."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from tacgen.api.frames import Frames, accepted
from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle import kept_files
from tacgen.bundle.bundle import read
from tacgen.bundle.resume import SceneResult
from tacgen.recipe import assets, indenters, plan
from tacgen.recipe.loading import read_sensor
from tacgen.recipe.model import Dynamics, Render, Uncertainty
from tacgen.recipe.trajectory import Hold, Press, Release, Replay, Slide, Start, Tilt, Twist
from tacgen.sensor.base_model import Part
from tacgen.sensor.model import Camera, Gel, Sensor
from tacgen.sensor.usual_values import unusual
from tacgen.sensor.yaml_source import KeyPath, Mark, Source, Spot, Tree, format_path, leaves, put

if TYPE_CHECKING:
    from tacgen.recipe.indenters import Box, Capsule, Cone, Cylinder, Mesh, Sphere, Torus, Wedge

SIMULATION_OUTPUTS = ("force", "traction", "height", "stress")
VIEW_PX = 320  # longer side of the picture, and of the maps, of a gel that is not a sensor's [px]
Movement = Press | Slide | Twist | Tilt | Hold | Release | Replay


@runtime_checkable
class Trimesh(Protocol):
    """A trimesh.Trimesh, in mm."""

    vertices: Any
    faces: Any

    def export(self, *, file_type: str) -> Any:
        """Its bytes in a file format."""


def simulate(
    sensor: "str | Path | Sensor | Gel",
    indenter: "Sphere | Cylinder | Cone | Box | Wedge | Capsule | Torus | Mesh | Trimesh | str | Path",
    movements: "Movement | np.ndarray | Sequence[Movement | np.ndarray]",
    *,
    start: Start | None = None,
    friction: float = 0.0,
    outputs: Sequence[str] = SIMULATION_OUTPUTS,
    quality: str | Mapping[str, Any] = "default",
    uncertainty: bool | Uncertainty = False,
    dynamics: Dynamics | None = None,
    render: Render | None = None,
    sensor_overrides: Mapping[str, Any] | None = None,
    may_miss: bool = False,
    name: str = "simulation",
) -> Frames:
    """Move a rigid indenter against the gel of a tactile sensor: the frames, with force, maps, stress and images.

        >>> import tacgen
        >>> frames = tacgen.simulate(
        ...     "gelsight_mini",
        ...     tacgen.Sphere(radius_mm=4),
        ...     [tacgen.Press(depth_mm=0.5, frames=2), tacgen.Slide(x_mm=0.2, frames=1)],
        ...     friction=0.6,
        ...     quality="draft",
        ... )
        >>> frames.force.shape  # [N]
        (3, 3)

    The gel is hyperelastic and solved by finite elements with contact and Coulomb friction; every frame is a converged
    equilibrium. The frames are those of a bundle that `tacgen run` writes of the same recipe, byte for byte.

    Args:
        sensor: the name of a sensor that ships with tacgen, the path of a sensor file, a Sensor, or a Gel alone.
        indenter: a shape, a Mesh of a file, the name of a shipped object, the path of an STL, OBJ or PLY file, or a
            trimesh.Trimesh in mm. A mesh is moved so that its lowest point is the origin.
        movements: Press, Slide, Twist, Tilt, Hold, Release or Replay, one after the other; or poses of the indenter in
            the sensor's frame, an array (N, 4, 4) [mm] with a frame for each.
        start: pose of the indenter before the first movement; by default above the middle, at first touch.
        friction: Coulomb's coefficient [-].
        outputs: what is computed: force, traction, events, force_map, height, normals, gap, stress, surface_stress,
            markers, flow, material, radiance, rgb. Images (rgb) take longer than the others.
        quality: draft, default or reference; or numbers such as {"edge_mm": 0.3}.
        uncertainty: True for the expected error of the force by the mesh, `frames.force_std` [N], at the cost of a
            second solution on a coarser mesh; or an Uncertainty, to propagate that of material and pose as well.
        dynamics: inertia and damping of the gel; without them every frame is a static equilibrium.
        render: how images are made.
        sensor_overrides: other values in the sensor, such as {"gel.layers[0].youngs_modulus_mpa": 0.2}.
        may_miss: whether frames are wanted although none touches the gel.
        name: title of the figure, and the name in the bundle's recipe.

    Raises:
        SceneRejected: a frame did not converge, and its `frames` are those before it; or none touches the gel.
        UserError: an argument is not valid; each line says which and why.
    """
    folder = kept_files.Folder()
    given = _Files(folder.path, None if dynamics is None else dynamics.frame_s)
    chosen = _sensor(sensor)
    steps = [movements] if isinstance(movements, Part | np.ndarray) else list(movements)
    data: dict[str, Any] = {
        "tacgen": 1,
        "name": name,
        "sensor": chosen.name if isinstance(chosen, Sensor) else chosen,
        "sensor_overrides": sensor_overrides or {},
        "indenter": given.indenter(indenter),
        "trajectory": [given.movement(step, k) for k, step in enumerate(steps)],
        "contact": {"friction": friction},
        "outputs": [outputs] if isinstance(outputs, str) else outputs,
        "quality": quality,
        "start": start,
        "dynamics": dynamics,
        "render": render,
        "may_miss": may_miss,
        "uncertainty": {"mesh": True} if uncertainty is True else uncertainty or None,
    }
    if dynamics is not None and dynamics.frame_s is None and any(isinstance(step, np.ndarray) for step in steps):
        raise UserError("simulate: dynamics: needs frame_s, the time between poses")
    tree = _tree({key: value for key, value in data.items() if value is not None}, "simulate", given.spots)
    (row,) = plan.load(tree, sensor=chosen if isinstance(chosen, Sensor) else None).rows
    for odd in unusual(row.sensor.gel):
        warnings.warn(f"sensor.{format_path(odd.path)}: {odd.message}", stacklevel=2)
    from tacgen.batch import pipeline

    return accepted(read(pipeline.run_scene(row, folder.path).path), folder)


def untouched(sensor: str | Path) -> Frames:
    """One frame of a sensor that nothing touches: its mesh, and its picture if it has lamps.

    Raises:
        UserError: there is no such sensor, or its file is not valid.
    """
    outputs = ("stress", "rgb") if load_sensor(sensor).lit else ("stress",)
    ball, start = indenters.Sphere(radius_mm=1.0), Start(clearance_mm=1.0)
    return simulate(sensor, ball, Hold(frames=1), start=start, outputs=outputs, quality="draft", may_miss=True)


def run(
    recipe: str | Path | Mapping[str, Any],
    folder: str | Path,
    *,
    sets: Sequence[str] = (),
    workers: int = 1,
    overwrite: bool = False,
) -> list[SceneResult]:
    """Make the bundles of a recipe, all scenes of a batch; called again it resumes, as `tacgen run` does.

    Scenes run in processes of their own; `tacgen.read_all(folder)` gives the frames.

    Args:
        recipe: the name of a shipped recipe, the path of a recipe file, or its contents as a dictionary.
        folder: where the bundles go.
        sets: other values, as on the command line: `indenter.radius_mm=3`.
        workers: number of processes.
        overwrite: replace bundles of other inputs.

    Returns:
        name, path, status (ok, rejected or failed) and reason of each scene, in order.

    Raises:
        UserError: the recipe is not valid, or the folder holds bundles of other inputs.
    """
    from tacgen import batch

    source = _tree(recipe, "recipe", {}) if isinstance(recipe, Mapping) else assets.recipe_path(str(recipe))
    return batch.run(plan.load(source, sets), Path(folder), workers=workers, overwrite=overwrite)


def load_sensor(name: str | Path) -> Sensor:
    """A sensor that ships with tacgen, by its name, or that of a sensor file: gel, camera, lights, markers.

        >>> import tacgen
        >>> tacgen.load_sensor("gelsight_mini").gel.layers[0].thickness_mm
        4.0

    Raises:
        UserError: there is no such sensor, or its file is not valid; each line says where.
    """
    path = assets.sensor_path(str(name))
    sensor, _ = read_sensor(path)
    solid = sensor.gel.solid
    if solid is None:
        return sensor
    whole = solid.model_copy(update={"file": str(path.resolve().parent / solid.file)})
    return sensor.model_copy(update={"gel": sensor.gel.model_copy(update={"solid": whole})})


def _sensor(given: str | Path | Sensor | Gel) -> str | Sensor:
    """A sensor, or its name. A gel alone gets a camera that sees all of it."""
    if isinstance(given, str | Path):
        return str(given)
    if isinstance(given, Sensor):
        return given
    if not isinstance(given, Gel):
        raise UserError(f"simulate: sensor: must be a name, a path, a Sensor or a Gel (got {type(given).__name__})")
    scale = max(given.width_mm, given.height_mm) / VIEW_PX
    width, height = round(given.width_mm / scale), round(given.height_mm / scale)
    camera = Camera(distance_mm=20.0, mm_per_px=scale, width_px=width, height_px=height, source="assumed")
    return Sensor(tacgen_sensor=1, name="gel", gel=given, camera=camera)


class _Files:
    """Arguments as parts of a recipe; meshes and poses are written to a folder."""

    def __init__(self, folder: Path, frame_s: float | None) -> None:
        self.folder, self.frame_s = folder, frame_s
        self.spots: dict[KeyPath, Spot] = {}  # where the paths of these files start

    def indenter(self, given: Any) -> Any:
        """The indenter of a recipe."""
        if isinstance(given, str | Path):
            return {"shape": "mesh", "file": str(given)}
        if isinstance(given, Trimesh):
            content = given.export(file_type="stl")
            return {"shape": "mesh", "file": self._kept(content, f"{_called(given)}.stl", ("indenter", "file"))}
        if type(given) in indenters.INDENTER_SHAPES.values():
            return given
        known = ", ".join(kind.__name__ for kind in indenters.INDENTER_SHAPES.values())
        raise UserError(
            f"simulate: indenter: must be {known}, a name, a path or a trimesh (got {type(given).__name__})"
        )

    def movement(self, given: Any, place: int) -> Any:
        """The segment of a trajectory."""
        if isinstance(given, np.ndarray):
            where = "trajectory", place, "replay", "file"
            file = self._kept(_table(given, self.frame_s or 1.0), f"poses{place or ''}.csv", where)
            return {"replay": {"file": file, "units": "mm"}}
        if isinstance(given, Movement):
            return {type(given).__name__.lower(): given}
        known = ", ".join(kind.__name__ for kind in Movement.__args__)
        raise UserError(
            f"simulate: movements[{place}]: must be {known} or poses (N, 4, 4) (got {type(given).__name__})"
        )

    def _kept(self, content: bytes, name: str, where: KeyPath) -> str:
        output_file.put(self.folder / name, content)
        self.spots[where] = _in_folder("simulate", self.folder)
        return name


def _called(mesh: Trimesh) -> str:
    """The name of a mesh: that of the file it was read from, its shape's, or `object`."""
    known = getattr(mesh, "metadata", {})
    name = next((str(known[key]) for key in ("name", "file_name", "shape") if known.get(key)), "object")
    return re.sub(r"[^A-Za-z0-9._-]", "_", PurePath(name).stem)[:80].lstrip(".") or "object"


def _in_folder(name: str, folder: Path) -> Spot:
    return Spot(*[Mark(Source(name, folder=folder))] * 2)


def _table(poses: np.ndarray, frame_s: float) -> bytes:
    """Poses (N, 4, 4) [mm], so many seconds apart, as the table of a replay."""
    from scipy.spatial.transform import Rotation

    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
        raise UserError(f"simulate: movements: poses must be an array (N, 4, 4) (got {poses.shape})")
    turned = poses[:, :3, :3].astype(float)
    if not np.allclose(turned @ turned.swapaxes(1, 2), np.eye(3), atol=1e-6) or (np.linalg.det(turned) < 0).any():
        raise UserError("simulate: movements: poses must hold rotations in [:, :3, :3]: orthonormal, without mirroring")
    quaternions = Rotation.from_matrix(turned).as_quat(scalar_first=True)
    rows = np.hstack([frame_s * np.arange(len(poses))[:, None], poses[:, :3, 3].astype(float), quaternions])
    lines = ["time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz", *(",".join(map(repr, row)) for row in rows.tolist())]
    return ("\n".join(lines) + "\n").encode()


def _tree(data: Any, name: str, spots: Mapping[KeyPath, Spot]) -> Tree:
    """A recipe that is in no file, as plain values; messages name it, and paths start at the working folder."""
    plain, here = _plain(data), Spot(*[Mark(Source(name))] * 2)
    spots, copies = dict(spots), kept_files.folder().path
    for path, value in leaves(plain):
        if isinstance(value, str) and copies in Path(value).parents:  # of a bundle, by its own name
            plain, spots[path] = put(plain, path, Path(value).name), _in_folder(name, Path(value).parent)
    places = (path[:length] for path, _ in leaves(plain) for length in range(len(path) + 1))
    return Tree(plain, dict.fromkeys(places, here) | spots)


def _plain(value: Any) -> Any:
    """A value of Python, NumPy or a model as JSON has it."""
    if isinstance(value, Part):
        return value.model_dump(mode="json", exclude_none=True)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(inner) for inner in (sorted(value) if isinstance(value, set | frozenset) else value)]
    return str(value) if isinstance(value, Path) else value
