"""The description of an output: its text, its datasets' rows in a bundle, what makes them, and its maps in figures."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from tacgen.outputs.scene_data import FrameData as FrameData
    from tacgen.outputs.scene_data import SceneData as SceneData
else:
    FrameData = SceneData = Any  # numerics, which a description is read without

Datasets = dict[str, Any]  # by their paths in the bundle
DIMENSION_NAMES = {"N": "frame", "h": "row", "w": "column", "H": "row", "W": "column", "M": "marker", "m": "cell"}
DIMENSION_NAMES |= {"n": "node", "k": "node", "2": "xy", "3": "xyz", "6": "component"}
MAX_COORDINATE_MM = 1e6  # [mm] limit of poses and nodes


@dataclass(frozen=True)
class Entry:
    """One dataset. A letter in `shape` is a size shared by every dataset that names it; "*" is any size, and 4|8 one
    of two.

    A map is rounded, as `power` or `bits` says, by a hundredth of its own error or less. Errors (rms of a ball pressed
    and slid at `default`, against `reference`, on the Mini and DIGIT): height 1.6e-3 mm, normals 4e-3, gap 1.1e-3 mm,
    flow .02 px, material 1.1e-3 mm, sliding .1; median of pressure 2 %, traction and force 4 %, area .4 %. The sum of
    force_map is the force, to 1e-5.
    """

    dtype: str
    shape: str  # sizes of the axes, such as "N h w 2"; N: the number of frames
    units: str  # "1" is dimensionless
    long_name: str
    axes: str = ""  # one word an axis; empty: those of DIMENSION_NAMES
    nan: bool = False  # may hold nan: where a pixel shows no gel, or not the point in question
    below: str = ""  # the size of which all values are indices, from 0 on
    most: float = math.inf  # largest magnitude: what is computed from larger values, or nan, fails
    power: int | None = None  # rounded to multiples of 2 to this power, in the dataset's unit
    bits: int | None = None  # rounded to so many significant bits

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", self.axes or " ".join(DIMENSION_NAMES[size] for size in self.shape.split()))

    @cached_property
    def dims(self) -> tuple[str | int, ...]:
        """The sizes of the axes."""
        return tuple(int(size) if size.isdigit() else size for size in self.shape.split())

    @cached_property
    def per_frame(self) -> bool:
        """Whether the first axis is the frame."""
        return self.dims[0] == "N"

    @property
    def rounding(self) -> str:
        """The attribute `rounding`; empty if the values are stored as they are."""
        return f"multiples of 2^{self.power}" if self.power is not None else f"{self.bits} bits" if self.bits else ""


def number(long_name: str, units: str = "1", nan: bool = False) -> Entry:
    """The row of a dataset with one floating-point number a frame."""
    return Entry("<f8", "N", units, long_name, nan=nan)


def count(long_name: str) -> Entry:
    """The row of a dataset with one whole number a frame."""
    return Entry("<i4", "N", "1", long_name)


def flag(long_name: str) -> Entry:
    """The row of a dataset that is true or false in a frame."""
    return Entry("|b1", "N", "1", long_name)


def vector(long_name: str, units: str = "N", nan: bool = False) -> Entry:
    """The row of a dataset with three numbers a frame."""
    return Entry("<f8", "N 3", units, long_name, nan=nan)


def pose(long_name: str) -> Entry:
    """The row of a dataset with a pose (4, 4) [mm] a frame."""
    return Entry("<f8", "N 4 4", "mm", long_name, axes="frame row column", most=MAX_COORDINATE_MM)


def seen(shape: str, units: str, long_name: str, power: int | None = None) -> Entry:
    """The row of a map of the face behind each sample, nan where there is none."""
    return Entry("<f4", shape, units, long_name, nan=True, power=power)


class DrawnMap(NamedTuple):
    """A map over the frames in figures and in the viewer, with a perceptually uniform colour map of matplotlib."""

    label: str
    colours: str
    path: str  # of vectors (N, h, w, 2) their length is drawn, and arrows on it
    less: str = ""  # the dataset (h, w) of the untouched sensor that is subtracted: a dome would hide the change


class Output(NamedTuple):
    """An output of a recipe. Its module imports numerics inside functions: recipes are read without them."""

    text: str  # for the documentation, in Markdown
    rows: dict[str, Entry]  # its datasets by their paths; a name that is free is *
    frame: Callable[[FrameData], Datasets]  # of one frame, under /frames and /fields
    reference: Callable[[SceneData], Datasets] = lambda scene: {}  # once a scene, under /reference and /mesh
    needs: Literal["", "markers", "light"] = ""  # what the sensor must have
    maps: Mapping[str, DrawnMap] = MappingProxyType({})  # maps by their names in figures and in the viewer
