"""What optics read of a sensor's description: the models of recipe.sensor fit these, and so does anything else that
holds the same numbers. Units in the names; colours are (red, green, blue)."""

from collections.abc import Sequence
from typing import Any, Literal, Protocol

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]


class Scattering(Protocol):
    """Of a cloudy layer: extinction, the share of it that is scattered (3,), mean cosine of the turn."""

    extinction_per_mm: float
    albedo: Vec3
    forward: float


class Layer(Protocol):
    name: str
    thickness_mm: float
    refractive_index: float

    @property
    def scattering(self) -> Scattering | None: ...


class Pad(Protocol):
    """The gel in plan [mm], and its face; see geometry.outline.Pad."""

    @property
    def width(self) -> float: ...
    @property
    def height(self) -> float: ...
    @property
    def flat(self) -> bool: ...
    def top(self, x: Any, y: Any) -> Any: ...
    def drawn_in(self, xy: Any) -> Any: ...
    def housing(self, margin: float) -> "Pad": ...
    def walls(self, pieces: int) -> Any: ...


class Gel(Protocol):
    width_mm: float
    height_mm: float

    @property
    def pad(self) -> Pad: ...
    @property
    def solid(self) -> object | None: ...
    @property
    def layers(self) -> Sequence[Layer]: ...
    @property
    def clear_layers(self) -> Sequence[Layer]: ...


class Plate(Protocol):
    thickness_mm: float
    refractive_index: float


class Coating(Protocol):
    """Diffuse albedo (3,), weight of the rough conductor, and its GGX alpha."""

    albedo: Vec3
    specular: float
    roughness: float


class Walls(Protocol):
    albedo: float
    margin_mm: float


class Led(Protocol):
    """A rectangle that shines along `normal`, as cos^lobe off it; `light`: its radiance (3,), power included."""

    name: str
    center_mm: Vec3
    normal: Vec3
    up: Vec3
    size_mm: Vec2
    lobe: int
    see_through: bool

    @property
    def light(self) -> Vec3: ...


class Noise(Protocol):
    """Variance per signal, standard deviation in the dark, and a factor on both together, in parts of full scale."""

    shot: Vec3
    read: Vec3
    strength: float


class Eye(Protocol):
    """The camera; see recipe.sensor.Camera."""

    distance_mm: float
    center_mm: Vec2
    tilt_deg: Vec2
    roll_deg: float
    crop_mm: Vec2
    mm_per_px: float
    width_px: int
    height_px: int
    blur_mm: float
    exposure: float
    ambient: Vec3
    vignette_mm: Vec3 | None
    colour_matrix: tuple[Vec3, Vec3, Vec3] | None

    @property
    def response(self) -> Literal["srgb", "linear"]: ...
    @property
    def noise(self) -> Noise | None: ...


class Markers(Protocol):
    """Dots in centred rows along x: how many are in each row from the least y, and the spacing in and between rows."""

    diameter_mm: float
    albedo: float

    @property
    def row_counts(self) -> tuple[int, ...]: ...
    @property
    def spacing_mm(self) -> Vec2: ...


class ThicknessResponse(Protocol):
    change_mm: tuple[float, ...]
    gain: tuple[Vec3, ...]


class Sensor(Protocol):
    """Gel and camera: what says where things are seen."""

    @property
    def gel(self) -> Gel: ...
    @property
    def plate(self) -> Plate | None: ...
    @property
    def camera(self) -> Eye: ...
    @property
    def markers(self) -> Markers | None: ...


class LitSensor(Sensor, Protocol):
    """One whose plate, coating, walls and lights are all described."""

    @property
    def plate(self) -> Plate: ...
    @property
    def coating(self) -> Coating: ...
    @property
    def walls(self) -> Walls: ...
    @property
    def leds(self) -> Sequence[Led]: ...
