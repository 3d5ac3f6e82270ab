"""A sensor file (sensors/*.yaml): its gel, optics, camera and markers, each number with its source.

Frame: x right and y down in the image, z out of the gel toward the object; the origin is the centre of the
untouched coated face, its highest point, so the gel fills -thickness < z < 0, the plate lies below it and the camera
below that.
"""

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from tacgen.sensor.base_model import (
    NO_SOURCE,
    Axis,
    FilePath,
    Fraction,
    Index,
    NotNegative,
    Part,
    Positive,
    Radii,
    Rgb,
    Sha256,
    Shares,
    Vec2,
    Vec3,
)
from tacgen.sensor.imperfections import Drift, Glare, Grain, Marks, Relief, Wear
from tacgen.sensor.layers import Layer
from tacgen.sensor.markers import Markers

if TYPE_CHECKING:
    from tacgen.geometry.outline import Pad

Pixels = Annotated[int, Field(ge=8, le=4096)]
Angle = Annotated[float, Field(ge=-20, le=20)]
Correlation = Annotated[float, Field(ge=-1, le=1)]


class StadiumEnd(Part):
    """One end of the rectangle in y is a semicircle over the whole width; the other end stays straight."""

    shape: Literal["stadium_end"]
    """The outline's kind."""
    end: Literal["-y", "+y"]
    """Which end in y is round."""
    source: str = NO_SOURCE


class Dome(Part):
    """A domed face: its drop below the crown, the pad's centre, is hypot(x^2 / 2 radius_x, y^2 / 2 radius_y).

    The layers' thicknesses are those at the crown; elsewhere they are thinner in proportion to the gel's height.
    """

    radius_x_mm: Positive
    """Radius of curvature along x."""
    radius_y_mm: Positive
    """Radius of curvature along y."""
    source: str = NO_SOURCE


class Solid(Part):
    """The gel's shape from a closed triangle mesh (STL, OBJ, PLY): bounding box centred on the z axis, top at z = 0."""

    file: FilePath
    """The mesh, a path from the sensor file."""
    up: Axis = "+z"
    """Which axis of the file points out of the gel."""
    scale: Positive = 1.0
    """Millimetres per unit of the file."""
    bonded_deg: Annotated[float, Field(gt=0, lt=90)] = 30.0
    """Bonded: the part around the lowest point whose normals are within this angle of -z."""
    bonded_mm: NotNegative | None = None
    """Bonded instead: all of the surface up to this height above its lowest point."""
    coated_deg: Annotated[float, Field(gt=0, lt=90)] = 60.0
    """Coated: normals within this angle of z."""
    sha256: Sha256 | None = None
    """Hash that the file must have."""
    source: str = NO_SOURCE


class Gel(Part):
    """A pad bonded at its flat base. In plan it is a rectangle with rounded corners, or with one semicircular end.

    Or a solid of any shape; then width, height and total thickness must be those of its bounding box.
    """

    width_mm: Positive
    """Size of the pad along x."""
    height_mm: Positive
    """Size of the pad along y."""
    corner_radius_mm: NotNegative = 0.0
    """Radius of the corners in plan."""
    outline: StadiumEnd | None = None
    """A rectangle if absent."""
    dome: Dome | None = None
    """A flat face if absent."""
    solid: Solid | None = None
    """A solid of any shape, instead of corners, outline and dome."""
    layers: Annotated[tuple[Layer, ...], Field(min_length=1)]
    """A list, from the bonded base outward to the coated face."""
    source: str = NO_SOURCE

    @property
    def clear_layers(self) -> "tuple[Layer, ...]":
        """The layers that light passes: from the base outward, up to the first opaque one."""
        opaque = [layer.opaque for layer in self.layers]
        return self.layers[: opaque.index(True)] if any(opaque) else self.layers

    @property
    def thickness_mm(self) -> float:
        """From the bonded base to the coated face, at its highest point [mm]."""
        return sum(layer.thickness_mm for layer in self.layers)

    @property
    def viscous(self) -> bool:
        """Whether any layer relaxes with time."""
        return any(layer.terms for layer in self.layers)

    @property
    def tip(self) -> int:
        """Which end in y is a semicircle: -1, +1, or 0 for none."""
        return 0 if self.outline is None else (-1 if self.outline.end == "-y" else 1)

    @property
    def pad(self) -> "Pad":
        """The outline and the height of the face; for a solid, those of its bounding box."""
        from tacgen.geometry.outline import Pad

        radii = (math.inf, math.inf) if self.dome is None else (self.dome.radius_x_mm, self.dome.radius_y_mm)
        return Pad(self.width_mm, self.height_mm, self.corner_radius_mm, self.tip, radii)

    def drop_mm(self, x_mm: float, y_mm: float) -> float:
        """Depth of the untouched face at (x, y) below its highest point [mm]."""
        return 0.0 if self.dome is None else -float(self.pad.top(x_mm, y_mm))


class Plate(Part):
    """The transparent plate to which the gel is bonded."""

    thickness_mm: Positive
    """Thickness, from the gel to the air below."""
    refractive_index: Index
    """Refractive index of the plate."""
    source: str = NO_SOURCE


class Coating(Part):
    """The opaque coating of the outer face, seen from inside: a diffuse part plus a rough conductor."""

    albedo: Shares
    """Diffuse reflectance of red, green, blue."""
    specular: Fraction
    """Weight of the rough conductor."""
    roughness: Annotated[float, Field(gt=0, le=1)]
    """GGX alpha of the conductor."""
    grain: Grain | None = None
    """Fine random pattern of the reflectance; none if absent."""
    relief: Relief | None = None
    """Relief of its outer side; none if absent."""
    marks: Marks | None = None
    """Dust and scratches; none if absent."""
    wear: Wear | None = None
    """Wear in the middle; none if absent."""
    source: str = NO_SOURCE


class Walls(Part):
    """The housing around plate and gel."""

    albedo: Fraction
    """Diffuse reflectance."""
    margin_mm: NotNegative = 0.0
    """Distance from the pad's outline; plate and gel fill the space between."""
    source: str = NO_SOURCE


class Led(Part):
    """A rectangular area light inside the plate or the gel, or in the air under the plate. `size_mm` is the size along
    up x normal, and along up."""

    name: str
    """By which messages and pictures call it."""
    center_mm: Vec3
    """Position of its centre."""
    normal: Vec3
    """Direction in which it shines."""
    up: Vec3 = (0.0, 0.0, 1.0)
    """Direction of the second side, at right angles to `normal`."""
    size_mm: tuple[Positive, Positive]
    """Size along up x normal, and along up."""
    radiance: Rgb
    """Radiance of red, green, blue; the camera's `exposure` makes counts of it."""
    power: NotNegative = 1.0
    """Factor on the radiance, to vary one LED."""
    lobe: Annotated[int, Field(ge=0, le=32)] = 0
    """Radiance ~ cos^lobe(angle to the normal); 0: Lambertian."""
    see_through: bool = False
    """A source that blocks no light: it stands for light that enters there, not for a body."""
    source: str = NO_SOURCE

    @property
    def light(self) -> Vec3:
        """Radiance times power."""
        r, g, b = self.radiance
        return self.power * r, self.power * g, self.power * b


class Noise(Part):
    """Noise of the camera's pixels per channel, added before the response curve, independent in each frame."""

    shot: Rgb
    """Shot-noise variance over signal, both relative to full scale: 1 / full-well electrons."""
    read: Rgb
    """Read noise: standard deviation in the dark, relative to full scale."""
    strength: NotNegative = 1.0
    """Factor on the standard deviation of the total noise."""
    patch_px: Annotated[int, Field(ge=1, le=16)] = 1
    """Distance over which the correlation of two pixels falls to 0; 1: white noise."""
    correlation: tuple[Correlation, Correlation, Correlation] = (0.0, 0.0, 0.0)
    """Of red with green, red with blue, green with blue."""
    source: str = NO_SOURCE

    @model_validator(mode="after")
    def _possible(self) -> Self:
        a, b, c = self.correlation
        if 1 + 2 * a * b * c - a * a - b * b - c * c < 0:
            raise ValueError("correlation: three colours cannot be correlated so: nearer to 0")
        return self

    @property
    def white(self) -> bool:
        """Whether the noise of all pixels and colours is independent."""
        return self.patch_px == 1 and not any(self.correlation)


class Camera(Part):
    """A pinhole camera in the air behind the plate, looking along +z or nearly so."""

    distance_mm: Positive
    """Pinhole to the plate's air face, or to the gel's base if there is no plate."""
    center_mm: Vec2 = (0.0, 0.0)
    """The point of the coating above the pinhole."""
    tilt_deg: tuple[Angle, Angle] = (0.0, 0.0)
    """Tilt of the optical axis towards +x and towards +y."""
    roll_deg: Angle = 0.0
    """Rotation about the optical axis, from x to y."""
    crop_mm: Vec2 = (0.0, 0.0)
    """Offset of the picture's centre from the optical axis, measured on the coating."""
    mm_per_px: Positive
    """Size of a pixel on the untouched coating, at the optical axis; its width, if it is not square."""
    pixel_aspect: Annotated[float, Field(ge=0.5, le=2)] | None = None
    """Height of a pixel on the coating over its width; square if absent."""
    width_px: Pixels
    """Width of the picture."""
    height_px: Pixels
    """Height of the picture."""
    blur_mm: NotNegative = 0.0
    """Defocus: standard deviation of the point spread function, measured on the coating."""
    exposure: Positive = 1.0
    """Linear radiance to sensor full scale."""
    auto_exposure: Annotated[float, Field(ge=0, le=0.95)] = 0.0
    """Share of the logarithm of a change of the mean light that the exposure takes back; 0 if it is fixed."""
    ambient: Rgb = (0.0, 0.0, 0.0)
    """What even stray light adds to a bare coat on the axis, fraction of full scale."""
    glare: Glare | None = None
    """Light that no touch changes, by place in the picture; none if absent."""
    vignette_mm: Radii | None = None
    """r0 of the vignetting factor 1/(1+(r/r0)^2)^2 on the coating, of each channel."""
    colour_matrix: tuple[Vec3, Vec3, Vec3] | None = None
    """counts = matrix x (R, G, B) of the camera's pixels."""
    response: Literal["srgb", "linear"] = "srgb"
    """Response curve from light to pixel values."""
    noise: Noise | None = None
    """Noise of the pixels; none if absent."""
    drift: Drift | None = None
    """Slow change of the gain over a scene; none if absent."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Pictures are compressed as JPEG of this quality, as in a camera that streams MJPEG; not if absent."""
    source: str = NO_SOURCE

    @property
    def aspect(self) -> float:
        """Height of a pixel over its width."""
        return self.pixel_aspect or 1.0

    @property
    def pixel_mm(self) -> Vec2:
        """Width and height of a pixel on the untouched coating."""
        return self.mm_per_px, self.mm_per_px * self.aspect


class ThicknessResponse(Part):
    """An empirical gain on the light as a function of the change of gel thickness, for effects in real images that the
    optical model does not explain. Interpolated smoothly, constant beyond its ends."""

    change_mm: Annotated[tuple[float, ...], Field(min_length=2)]
    """Changes of the gel's thickness, rising."""
    gain: tuple[Rgb, ...]
    """Factor on red, green, blue at each change."""
    spread_mm: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How far this light wanders sideways in the gel: the gain is averaged by a Gaussian of this standard deviation."""
    source: str = NO_SOURCE

    @model_validator(mode="after")
    def _table(self) -> Self:
        if len(self.gain) != len(self.change_mm) or any(a >= b for a, b in pairwise(self.change_mm)):
            raise ValueError("must hold rising change_mm and as many rows of gain: a row for each change")
        return self


LIGHT_FIELDS = ("plate", "coating", "walls", "leds")


class Sensor(Part):
    """A sensor type. Without plate, coating, walls and LEDs it gives all outputs but images."""

    tacgen_sensor: Literal[1]
    """Version of this format."""
    name: str
    """Name of the sensor, stored in bundles."""
    description: str = ""
    """One line, printed by `tacgen list sensors`."""
    base: str | None = None
    """The shipped sensor whose file this one is a copy of: the source of numbers that differ becomes `assumed`."""
    gel: Gel
    """The pad."""
    plate: Plate | None = None
    """Clear plate under the gel; needed for images."""
    coating: Coating | None = None
    """Opaque coating of the face; needed for images."""
    walls: Walls | None = None
    """The housing; needed for images."""
    leds: Annotated[tuple[Led, ...], Field(min_length=1)] | None = None
    """A list of lights; needed for images."""
    camera: Camera
    """Where the picture is taken from."""
    markers: Markers | None = None
    """Dots on the coating; none if absent."""
    thickness_response: ThicknessResponse | None = None
    """Gain of the light by change of thickness; none if absent."""

    def __repr__(self) -> str:
        gel, picture = self.gel, self.camera
        size = f"{gel.width_mm:g} x {gel.height_mm:g} x {gel.thickness_mm:g} mm"
        return f"Sensor({self.name}: gel {size}, picture {picture.width_px} x {picture.height_px} px)"

    __str__ = __repr__

    @property
    def lit(self) -> bool:
        """Whether plate, coating, walls and LEDs are all given, as images need them."""
        return all(getattr(self, name) is not None for name in LIGHT_FIELDS)


class LitSensor(Sensor):
    """A sensor that is `lit`: the type that functions which make images take."""

    plate: Plate
    coating: Coating
    walls: Walls
    leds: Annotated[tuple[Led, ...], Field(min_length=1)]
