"""The frames of a scene as NumPy arrays, computed just now or read from a bundle."""

import json
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base import output_file, regular_file
from tacgen.base.errors import LeftOut, UserError
from tacgen.bundle import dataset, field_names, kept_files
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.bundle import read as read_bundle
from tacgen.bundle.caption import caption
from tacgen.bundle.force_error import force_error
from tacgen.bundle.hdf5_file import MAX_HDF5_BYTES
from tacgen.bundle.kept_files import Folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tacgen.sensor.model import Sensor

Array = np.ndarray


class Frames:
    """The frames of one contact: forces, maps, stress and images, as NumPy arrays that cannot be written to.

        >>> import tacgen
        >>> frames = tacgen.simulate("digit", tacgen.Sphere(radius_mm=3), tacgen.Press(depth_mm=0.3, frames=2))
        >>> frames
        Frames(scene-00000.h5: 2 frames, sphere, radius 3 mm, on digit)
        >>> frames.force.shape, frames.pressure[-1].shape  # of all frames, and of the last one
        ((2, 3), (320, 240))
        >>> frames["/mesh/points"].shape == frames.displacement[-1].shape  # any dataset of a bundle, by its path
        True

    N is the number of frames, h x w the size of the maps, H x W that of the image, n the number of nodes, M that of the
    markers. Everything acts on the gel; x is right and y down in the image, z out of the gel. What the outputs did not
    ask for is not there, and asking for it says what is. `dir(frames)` lists the names; those without attribute below
    are described in the bundle's table (docs/BUNDLE.md).

    Attributes:
        force: force on the gel, (N, 3) [N].
        force_std: standard deviation of the force, (N, 3) [N]; with `uncertainty`.
        normal_force: part of the force by pressure, (N, 3) [N]; with friction.
        friction_force: part of the force by friction, (N, 3) [N]; with friction.
        torque: torque on the gel about the sensor origin, (N, 3) [N mm].
        pose: pose of the indenter in the sensor frame, (N, 4, 4) [mm].
        pressure: pressure normal to the deformed face, (N, h, w) [MPa].
        traction: friction on the gel, in the tangent plane, (N, h, w, 2) [MPa].
        contact: in contact, (N, h, w) [1].
        slip: in contact, and half or more of the pressure slides, (N, h, w) [1].
        height: z of the deformed face, (N, h, w) [mm]; nan where a pixel shows no gel.
        normals: unit normal of the deformed face, (N, h, w, 3) [1].
        force_map: force on the gel behind each sample, (N, h, w, 3) [N].
        x_mm: x in the sensor frame of the untouched face behind each sample of a map, (h, w) [mm]; nan beside the gel.
        y_mm: y in the sensor frame of the untouched face behind each sample of a map, (h, w) [mm]; nan beside the gel.
        displacement: nodal displacement, (N, n, 3) [mm].
        stress: Cauchy stress at the nodes, xx yy zz yz xz xy, (N, n, 6) [MPa].
        markers: marker centres in the image, (N, M, 2) [px].
        marker_flow: markers less their reference, (N, M, 2) [px].
        unique: no step needed damping since the gel was last untouched, (N,) [1]; where false, it has folded, wrinkled
            or slipped suddenly, and forces may depend on the step size.
        image: camera image, sRGB, (N, H, W, 3) [1], uint8; also called rgb.
    """

    def __init__(self, source: Bundle, folder: Folder | None = None) -> None:
        self.bundle = source
        self._folder = folder  # removed with the frames, unless they are saved
        self._read: dict[str, Array] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled, as another process returns it, with the file, which is removed with the frames of that process."""
        if self._folder is None:
            return Frames, (self.bundle,)
        return _unpickled, (self.bundle.path.name, regular_file.read_bytes(self.bundle.path, MAX_HDF5_BYTES))

    def __len__(self) -> int:
        """N, the number of frames."""
        return self.bundle.frames

    __iter__ = None  # frames are taken by name: without this Python would try frames[0]

    def __repr__(self) -> str:
        return f"Frames({self.bundle.line})"

    def __getitem__(self, name: str) -> Array:
        """A dataset by its name below /frames or /fields, or by its path. Raises UserError: it is not there."""
        if not isinstance(name, str):
            raise TypeError(f"frames[{name!r}]: a name is needed; frames.force[{name!r}] is the force of one frame")
        path = field_names.path_of(name, self.bundle.shapes)
        if path not in self._read:
            self._read[path] = self.bundle[path]
            self._read[path].flags.writeable = False
        return self._read[path]

    if not TYPE_CHECKING:  # type checkers see the names that are declared below alone

        def __getattr__(self, name):
            if name.startswith("_"):
                raise AttributeError(name)
            try:
                return self[name]
            except UserError as error:
                raise AttributeError(str(error)) from None

    def __dir__(self) -> list[str]:
        short, known = field_names.SHORT_NAMES.items(), self.bundle.shapes.keys()
        others = [each for each, name in short if {name, f"/frames/{name}", f"/fields/{name}"} & known]
        return sorted({*super().__dir__(), *filter(str.isidentifier, self.names), *others})

    force: Array
    force_std: Array
    normal_force: Array
    friction_force: Array
    torque: Array
    pose: Array
    pressure: Array
    traction: Array
    contact: Array
    slip: Array
    height: Array
    normals: Array
    force_map: Array
    x_mm: Array
    y_mm: Array
    displacement: Array
    stress: Array
    markers: Array
    marker_flow: Array
    unique: Array
    image: Array
    rgb: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all that is stored for each frame."""
        return tuple(field_names.short(self.bundle.shapes))

    @property
    def segments(self) -> tuple[str, ...]:
        """For each frame, the kind of its movement: press, slide, ..."""
        return self.bundle.segments

    @property
    def force_error(self) -> Array:
        """Expected error of the force's magnitude, (N,) [N]: by the recipe's `uncertainty` where asked for, else
        by the mesh, within a factor of 2; nan where it is not known, as without contact."""
        known = force_error(self.bundle)
        return np.full(len(self), np.nan) if known is None else known.newton

    @property
    def about(self) -> str:
        """The scene in a few sentences."""
        return caption(self.bundle)

    @property
    def notes(self) -> list[str]:
        """Notes on this scene, such as a mesh that does not resolve the indenter."""
        notes: list[str] = json.loads(self.bundle.attrs.get("notes", "[]"))
        return notes

    @property
    def recipe(self) -> dict[str, Any]:
        """The recipe of the scene, all of whose values are resolved: `tacgen.run` makes the same scene of it.

        Its object, poses and sensor are named by copies of files in the bundle, which last as long as this process.
        """
        return kept_files.runnable(self.bundle)

    @property
    def sensor(self) -> "Sensor":
        """The sensor of the scene."""
        return self.bundle.sensor

    @property
    def von_mises(self) -> Array:
        """Von Mises stress at the nodes, (N, n) [MPa]. Raises UserError: `stress` is not among the outputs."""
        from tacgen.bundle.postprocess import von_mises

        return von_mises(self["stress"])

    def plot(self, field: str = "") -> "Figure":
        """A matplotlib figure of up to five frames, image or maps, and the force over all, as `tacgen show` draws it.

        A notebook shows it where it is the last line of a cell; elsewhere `frames.plot().savefig("press.png")`.

        Args:
            field: one alone: camera, markers, pressure, traction, slip, height, flow or stress.

        Raises:
            UserError: unknown field, or one that is not there.
        """
        from tacgen.report import bundle_figure, field_figure

        return field_figure.figure(self.bundle, field) if field else bundle_figure.figure(self.bundle)

    def animate(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a film of the frames, as `tacgen show --animate` does; returns its path.

        Args:
            path: a .webp or .gif file, or .mp4 where ffmpeg is installed.

        Raises:
            UserError: the file exists already and `overwrite` is not set, another kind of file, or no ffmpeg.
        """
        from tacgen.report import animation

        with output_file.written(Path(path), [self.bundle.path], overwrite=overwrite) as new:
            animation.write(self.bundle, new)
        return Path(path)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the bundle, one HDF5 file that `tacgen.read` and all commands read; returns its path.

        Raises:
            UserError: the file exists already and `overwrite` is not set, or the frames are those of a packed folder.
        """
        if self.bundle.group != "/":
            raise UserError(f"{self.bundle.path}: is packed; `tacgen unpack` writes its bundles")
        with output_file.written(Path(path), [self.bundle.path], overwrite=overwrite) as new:
            shutil.copyfile(self.bundle.path, new)
        return Path(path)


def _unpickled(name: str, content: bytes) -> Frames:
    folder = Folder()
    output_file.add(folder.path / name, content)
    return Frames(read_bundle(folder.path / name), folder)


class SceneRejected(UserError):
    """A frame did not converge, or has a label that is not finite; the message says which and why.

    Attributes:
        frames: the frames before it, which are sound.
    """

    frames: Frames


def accepted(source: Bundle, folder: Folder | None = None) -> Frames:
    """The frames of a bundle. Raises SceneRejected: they are not all there."""
    frames = Frames(source, folder)
    if source.attrs["status"] != "ok":
        error = SceneRejected(str(source.attrs["reason"]))
        error.frames = frames
        raise error
    return frames


def read(path: str | Path) -> Frames:
    """The frames of a bundle, or of the only one of a folder.

    Raises:
        SceneRejected: the scene was rejected.
        UserError: the file is missing, unfinished, damaged or no bundle, or the folder holds several.
    """
    path = Path(path)
    bundles = dataset.scenes(path)
    if len(bundles) > 1:
        raise UserError(f"{path}: holds {len(bundles)} bundles: name one, such as {bundles[0].path}, or use read_all")
    return accepted(bundles[0])


def read_all(path: str | Path) -> list[Frames]:
    """The frames of every scene of a data set: a folder that `tacgen run` wrote, or a packed one.

    Scenes that were rejected are left out, with a warning that counts them.

    Raises:
        UserError: there is no scene, or a file is damaged, no bundle or of a newer format.
    """
    bundles = dataset.scenes(Path(path))
    good = [Frames(each) for each in bundles if each.attrs["status"] == "ok"]
    if len(good) < len(bundles):
        said = f"{path}: left out {len(bundles) - len(good)} rejected of {len(bundles)} scenes"
        warnings.warn(said, LeftOut, stacklevel=2)
    return good
