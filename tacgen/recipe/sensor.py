"""A sensor file (sensors/*.yaml): its gel, optics, camera and markers, each number with its source.

Frame: x right and y down in the image, z out of the gel toward the object; the origin is the centre of the
untouched coated face, its highest point, so the gel fills -thickness < z < 0, the plate lies below it and the camera
below that.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from tacgen.recipe.base_model import Axis, FilePath, NotNegative, Part, Positive, Sha256, exactly_one
from tacgen.recipe.yaml_source import KeyPath, format_path

if TYPE_CHECKING:
    from tacgen.geometry.outline import Pad

NOWHERE = "not stated"  # where the numbers of a part come from
Fraction = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[float, Field(ge=1, le=4)]
Poisson = Annotated[float, Field(ge=0, lt=0.5)]
Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Angle = Annotated[float, Field(ge=-20, le=20)]


def _tuple(value: Any) -> Any:
    """Strictly, what passed through Python holds no list."""
    return tuple(value) if isinstance(value, list) else value


def _as_rgb(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value,) * 3
    return _tuple(value)


# Red, green and blue; one number stands for three equal ones, so that all can vary together.
Rgb = Annotated[
    tuple[NotNegative, NotNegative, NotNegative],
    BeforeValidator(_as_rgb, json_schema_input_type=NotNegative | tuple[NotNegative, NotNegative, NotNegative]),
]
Shares = Annotated[
    tuple[Fraction, Fraction, Fraction],
    BeforeValidator(_as_rgb, json_schema_input_type=Fraction | tuple[Fraction, Fraction, Fraction]),
]


class Scattering(Part):
    """Fine particles all through a layer, that scatter light as Henyey and Greenstein say and absorb some of it."""

    extinction_per_mm: Positive  # of a ray's light, scattered and absorbed together
    albedo: Shares  # what of it is scattered
    forward: Annotated[float, Field(gt=-1, lt=1)] = 0.0  # mean cosine of the turn, g
    source: str = NOWHERE


class LayerBase(Part):
    """What every layer of gel has, whatever its law."""

    name: str
    thickness_mm: Positive
    refractive_index: Index = 1.41
    scattering: Scattering | None = None  # clear if absent
    opaque: bool = False  # the coating then lies on its inner side
    source: str = NOWHERE

    @property
    def terms(self) -> tuple[tuple[float, float], ...]:
        """g and tau [s] of each term of its Prony series, none if it is elastic."""
        return ()


class PronyTerm(Part):
    """A share of the instantaneous shear modulus that relaxes exponentially."""

    g: Annotated[float, Field(gt=0, lt=1)]
    tau_s: Positive


def _some_left(value: tuple[PronyTerm, ...]) -> tuple[PronyTerm, ...]:
    if (total := sum(term.g for term in value)) >= 1:
        raise ValueError(f"must have g that add up to less than 1 (got {total:g}): nothing is left at rest")
    return value


Prony = Annotated[tuple[PronyTerm, ...], Field(min_length=1), BeforeValidator(_tuple), AfterValidator(_some_left)]


class IsochoricLayer(LayerBase):
    """What changes shape apart from volume, and so may be viscoelastic in shape: its law's constants are those of
    infinitely slow moves, and at once it is stiffer by 1/(1 - sum of g)."""

    prony: Prony | None = None  # elastic if absent

    @property
    def terms(self) -> tuple[tuple[float, float], ...]:
        return tuple((term.g, term.tau_s) for term in self.prony or ())


class NeoHookeLayer(IsochoricLayer):
    """Isochoric neo-Hookean; the law of a layer that names none."""

    law: Literal["neo_hooke"] = "neo_hooke"
    youngs_modulus_mpa: Positive
    poissons_ratio: Poisson


class StableNeoHookeLayer(LayerBase):
    """Smith et al. (2018), what UIPC calls stable neo-Hookean."""

    law: Literal["stable_neo_hooke"]
    youngs_modulus_mpa: Positive
    poissons_ratio: Poisson


class NearlyIncompressible(IsochoricLayer):
    """How compressible a layer is: one of two numbers."""

    poissons_ratio: Poisson | None = None
    bulk_modulus_mpa: Positive | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, names=("poissons_ratio", "bulk_modulus_mpa"))
        return self


class MooneyRivlinLayer(NearlyIncompressible):
    """Mooney-Rivlin: the shear modulus at rest is 2 (c10 + c01)."""

    law: Literal["mooney_rivlin"]
    c10_mpa: Positive
    c01_mpa: NotNegative


class YeohLayer(NearlyIncompressible):
    """Yeoh, of third order: the shear modulus at rest is 2 c10."""

    law: Literal["yeoh"]
    c10_mpa: Positive
    c20_mpa: float = 0.0
    c30_mpa: NotNegative = 0.0

    @model_validator(mode="after")
    def _stiff(self) -> Self:
        least = -((3 * self.c10_mpa * self.c30_mpa) ** 0.5)
        if self.c20_mpa < least:  # c10 + 2 c20 y + 3 c30 y^2 falls below zero at some stretch
            raise ValueError(
                f"c20_mpa must be at least -sqrt(3 c10 c30), {least:g} (got {self.c20_mpa:g}): softens to nothing"
            )
        return self


def _with_law(value: Any) -> Any:
    return {"law": "neo_hooke", **value} if isinstance(value, dict) else value


# Layers are listed from the bonded base outward to the coated face.
Layer = Annotated[
    NeoHookeLayer | StableNeoHookeLayer | MooneyRivlinLayer | YeohLayer,
    Field(discriminator="law"),
    BeforeValidator(_with_law),
]


class StadiumEnd(Part):
    """One short side of the rectangle is a semicircle over the whole width; the other stays square."""

    shape: Literal["stadium_end"]
    end: Literal["-y", "+y"]
    source: str = NOWHERE


class Dome(Part):
    """A face that falls by hypot(x^2 / 2 radius_x, y^2 / 2 radius_y) from its crown, the pad's centre.

    The layers' thicknesses are those at the crown; elsewhere they shrink in proportion.
    """

    radius_x_mm: Positive
    radius_y_mm: Positive
    source: str = NOWHERE


class Solid(Part):
    """The gel's shape from a closed triangle mesh (STL, OBJ, PLY): middle of its box over the origin, top at z = 0."""

    file: FilePath
    up: Axis = "+z"  # which axis of the file points out of the gel
    scale: Positive = 1.0  # mm per unit of the file
    bonded_mm: NotNegative = 0.02  # held: all of the surface that is no higher than this above its lowest point
    coated_deg: Annotated[float, Field(gt=0, lt=90)] = 60.0  # pressed and seen: where it faces up to within this angle
    sha256: Sha256 | None = None
    source: str = NOWHERE


class Gel(Part):
    """A pad bonded at its flat base: a rectangle in plan, its four upright edges rounded or one side a semicircle.

    Or a solid of any shape: width, height and the layers' sum are then those of its box, and are held against it.
    """

    width_mm: Positive  # along x
    height_mm: Positive  # along y
    corner_radius_mm: NotNegative = 0.0
    outline: StadiumEnd | None = None  # a rectangle if absent
    dome: Dome | None = None  # a flat face if absent
    solid: Solid | None = None  # instead of corners, outline and dome
    layers: Annotated[tuple[Layer, ...], Field(min_length=1)]
    source: str = NOWHERE

    @property
    def clear_layers(self) -> "tuple[Layer, ...]":
        """Those that light passes, from the base outward to the first opaque one."""
        opaque = [layer.opaque for layer in self.layers]
        return self.layers[: opaque.index(True)] if any(opaque) else self.layers

    @property
    def tip(self) -> int:
        """The end in y that is a semicircle: -1, +1, or 0 for none."""
        return 0 if self.outline is None else (-1 if self.outline.end == "-y" else 1)

    @property
    def pad(self) -> "Pad":
        """Its outline and the height of its face; of a solid, its box."""
        from tacgen.geometry.outline import Pad

        radii = (math.inf, math.inf) if self.dome is None else (self.dome.radius_x_mm, self.dome.radius_y_mm)
        return Pad(self.width_mm, self.height_mm, self.corner_radius_mm, self.tip, radii)

    def drop_mm(self, x_mm: float, y_mm: float) -> float:
        """How far the untouched face lies below its highest point at (x, y) [mm]."""
        return 0.0 if self.dome is None else -float(self.pad.top(x_mm, y_mm))


class Plate(Part):
    """The clear plate that the gel is bonded to."""

    thickness_mm: Positive
    refractive_index: Index
    source: str = NOWHERE


class Coating(Part):
    """The opaque coat on the outer face, seen from inside: diffuse plus a rough metallic part."""

    albedo: Shares
    specular: Fraction  # weight of the rough conductor
    roughness: Annotated[float, Field(gt=0, le=1)]  # GGX alpha
    source: str = NOWHERE


class Walls(Part):
    """The housing around plate and gel."""

    albedo: Fraction
    margin_mm: NotNegative = 0.0  # it stands off the pad's outline by this much, and plate and gel fill the space
    source: str = NOWHERE


class Led(Part):
    """A rectangular area light inside plate or gel, or in the air under the plate. Size is (along up x normal,
    along up)."""

    name: str
    center_mm: Vec3
    normal: Vec3
    up: Vec3 = (0.0, 0.0, 1.0)
    size_mm: tuple[Positive, Positive]
    radiance: Rgb
    power: NotNegative = 1.0  # factor on the radiance: how much stronger this one is than its file says
    lobe: Annotated[int, Field(ge=0, le=32)] = 0  # radiance falls as cos^lobe off the normal: 0 is Lambert's even one
    see_through: bool = False  # stands for light that passes there, and takes none away: nothing is there but the light
    source: str = NOWHERE

    @property
    def light(self) -> Vec3:
        """Radiance that it has in this unit."""
        r, g, b = self.radiance
        return self.power * r, self.power * g, self.power * b


class Noise(Part):
    """What a camera's pixels add to the light, per channel, before the response: white, and new in each frame."""

    shot: Rgb  # variance per signal, both in parts of full scale: one over the electrons of a full pixel
    read: Rgb  # standard deviation in the dark, in parts of full scale
    strength: NotNegative = 1.0  # factor on the standard deviation of both together
    source: str = NOWHERE


class Camera(Part):
    """A pinhole in air behind the plate, looking along +z, or nearly so."""

    distance_mm: Positive  # from the plate's air face, or the gel's base where no plate is described, to the pinhole
    center_mm: Vec2 = (0.0, 0.0)  # over the pinhole: where the optical axis, if not tilted, meets the coating
    tilt_deg: tuple[Angle, Angle] = (0.0, 0.0)  # of the optical axis, toward +x and toward +y
    roll_deg: Angle = 0.0  # about the optical axis, from x to y
    crop_mm: Vec2 = (0.0, 0.0)  # how far off the optical axis the picture was cut, at its scale on the coating
    mm_per_px: Positive  # on the untouched coating, on the optical axis
    width_px: Annotated[int, Field(ge=8)]
    height_px: Annotated[int, Field(ge=8)]
    blur_mm: NotNegative = 0.0  # focus: standard deviation of a point's image, at its scale on the coating
    exposure: Positive = 1.0  # linear radiance to sensor full scale
    ambient: Rgb = (0.0, 0.0, 0.0)  # what even stray light adds to a bare coat, fraction of full scale
    vignette_mm: Positive | None = None  # r0 of the fall-off 1/(1+(r/r0)^2)^2 on the coating; none if absent
    response: Literal["srgb", "linear"] = "srgb"  # how counts follow from light: by the sRGB curve, or in proportion
    noise: Noise | None = None  # none if absent
    source: str = NOWHERE


class Motion(Part):
    """How dots move by the indenter's pose alone, for `markers: {method: analytic}`; see labels/fots_markers."""

    press: tuple[float, Positive]  # gain [1/mm^3] and decay [1/mm^2]
    shear: tuple[Positive, Positive]  # the farthest a contact drags its middle [mm], and decay [1/mm^2]
    twist: tuple[Positive, Positive]  # the most it turns it [deg], and decay [1/mm^2]
    source: str = NOWHERE


class Markers(Part):
    """Dots printed on the coating, a grid centred on the pad."""

    columns: Annotated[int, Field(ge=1)]  # along x
    rows: Annotated[int, Field(ge=1)]  # along y
    pitch_mm: tuple[Positive, Positive]
    diameter_mm: Positive
    albedo: Fraction
    motion: Motion | None = None
    source: str = NOWHERE


class ThicknessResponse(Part):
    """Gain on all light, by how much thicker the gel is than untouched: what a real unit's pictures show beyond what
    its optics explain. Interpolated smoothly, constant beyond its ends."""

    change_mm: Annotated[tuple[float, ...], Field(min_length=2)]
    gain: tuple[Rgb, ...]
    source: str = NOWHERE

    @model_validator(mode="after")
    def _table(self) -> Self:
        if len(self.gain) != len(self.change_mm) or any(a >= b for a, b in pairwise(self.change_mm)):
            raise ValueError("must hold rising change_mm and as many rows of gain")
        return self


LIGHTS = ("plate", "coating", "walls", "leds")


class Sensor(Part):
    """Everything known of one sensor type. One whose lights nobody has described yet has all but images."""

    tacgen_sensor: Literal[1]
    name: str
    description: str = ""
    gel: Gel
    plate: Plate | None = None
    coating: Coating | None = None
    walls: Walls | None = None
    leds: Annotated[tuple[Led, ...], Field(min_length=1)] | None = None
    camera: Camera
    markers: Markers | None = None
    thickness_response: ThicknessResponse | None = None

    @property
    def unsourced(self) -> list[str]:
        """Paths of the parts that do not say where their numbers come from."""

        def walk(part: Part, path: KeyPath) -> Iterator[str]:
            for name in type(part).model_fields:
                value = getattr(part, name)
                if name == "source" and value == NOWHERE:
                    yield format_path(path)
                rows = enumerate(value) if isinstance(value, tuple) else ()
                inner = [((*path, name), value), *(((*path, name, i), row) for i, row in rows)]
                for where, held in inner:
                    if isinstance(held, Part):
                        yield from walk(held, where)

        return list(walk(self, ()))

    @property
    def lit(self) -> bool:
        """Whether plate, coating, walls and LEDs are all there, as images need them."""
        return all(getattr(self, name) is not None for name in LIGHTS)


class LitSensor(Sensor):
    """A sensor that is `lit`, for the type checker: what makes images takes no other."""

    plate: Plate
    coating: Coating
    walls: Walls
    leds: Annotated[tuple[Led, ...], Field(min_length=1)]
