"""The models of indenters by shape; the origin is the lowest point. Lengths in mm, angles in degrees."""

import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field, ValidationInfo, field_validator

from tacgen.sensor.base_model import Axis, FilePath, Part, Positive, Sha256

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape

Acute = Annotated[float, Field(gt=0, lt=90)]


def _bounded(
    name: str, holds: Callable[[float, float], bool], text: str, *keys: str, limit: Callable[..., float] = float
) -> Any:
    """A validator: the field `name` must be `text`, as `holds` compares it with the `limit` of the fields `keys`."""

    def check(value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.keys() >= set(keys):  # else one of them is itself wrong
            bound = limit(*(info.data[key] for key in keys))
            if not holds(value, bound):
                raise ValueError(f"must be {text}, {bound:g} (got {value:g})")
        return value

    return field_validator(name)(check)


def _twice(radius: str) -> Any:
    """A validator: length_mm holds the roundings of both ends."""
    return _bounded("length_mm", operator.ge, f"at least twice {radius}", radius, limit=lambda value: 2 * value)


class AnyIndenter(Part):
    """An indenter of any shape."""

    # fields that could let it pass between contact points, and the factor that makes half the thickness of each
    thin: ClassVar[dict[str, float]] = {}


class Sphere(AnyIndenter):
    """A ball."""

    thin: ClassVar[dict[str, float]] = {"radius_mm": 1}
    shape: Literal["sphere"] = "sphere"
    radius_mm: Positive


class Cylinder(AnyIndenter):
    """A flat punch: a round rod whose axis is z, its edges rounded; without a length it has no upper end."""

    thin: ClassVar[dict[str, float]] = {"radius_mm": 1, "length_mm": 0.5}
    shape: Literal["cylinder"] = "cylinder"
    radius_mm: Positive
    fillet_mm: Annotated[float, Field(gt=0, validate_default=True)] = 0.2
    length_mm: Positive | None = None

    _fits = _bounded("fillet_mm", operator.le, "at most radius_mm", "radius_mm")
    _holds = _twice("fillet_mm")


class Cone(AnyIndenter):
    """A cone pointing down with a spherical tip; the half angle is measured from its axis."""

    shape: Literal["cone"] = "cone"
    half_angle_deg: Acute
    tip_radius_mm: Positive


class Box(AnyIndenter):
    """A block with rounded edges, flat side down."""

    thin: ClassVar[dict[str, float]] = {"size_x_mm": 0.5, "size_y_mm": 0.5}
    shape: Literal["box"] = "box"
    size_x_mm: Positive
    size_y_mm: Positive
    fillet_mm: Annotated[float, Field(gt=0, validate_default=True)] = 0.2

    _fits = _bounded(
        *("fillet_mm", operator.le, "at most half the shorter side", "size_x_mm", "size_y_mm"),
        limit=lambda x, y: min(x, y) / 2,
    )


class Wedge(AnyIndenter):
    """A wedge pointing down whose rounded edge is along y; half angle from z, total length along y."""

    shape: Literal["wedge"] = "wedge"
    half_angle_deg: Acute
    tip_radius_mm: Positive
    length_mm: Positive

    _holds = _twice("tip_radius_mm")


class Capsule(AnyIndenter):
    """A rod with hemispherical ends along x; the length is between the centres of the hemispheres."""

    thin: ClassVar[dict[str, float]] = {"radius_mm": 1}
    shape: Literal["capsule"] = "capsule"
    radius_mm: Positive
    length_mm: Positive


class Torus(AnyIndenter):
    """A ring lying flat: `radius_mm` from its axis to the centre of the tube."""

    thin: ClassVar[dict[str, float]] = {"tube_radius_mm": 1}
    shape: Literal["torus"] = "torus"
    radius_mm: Positive
    tube_radius_mm: Positive

    _fits = _bounded("tube_radius_mm", operator.lt, "less than radius_mm", "radius_mm")


class Mesh(AnyIndenter):
    """A closed triangle mesh (STL, OBJ, PLY), lowest point at z = 0, bounding box centred on the z axis."""

    shape: Literal["mesh"] = "mesh"
    file: FilePath  # a path, or the name of a shipped object
    up: Axis = "+z"  # which axis of the file points away from the gel
    scale: Positive = 1.0  # mm per unit of the file
    size_mm: Positive | None = None  # length of the longest side, instead of scale
    sha256: Sha256 | None = None

    @field_validator("size_mm")
    @classmethod
    def _alone(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("scale", 1.0) != 1.0:
            raise ValueError("cannot be given beside scale: leave one of them out")
        return value


Indenter = Annotated[Sphere | Cylinder | Cone | Box | Wedge | Capsule | Torus | Mesh, Field(discriminator="shape")]
INDENTER_SHAPES: dict[str, type[Part]] = {
    kind.model_fields["shape"].annotation.__args__[0]: kind for kind in get_args(get_args(Indenter)[0])
}


def analytic(i: Indenter) -> "Shape | None":
    """The signed distance of an indenter: the class of its name and Sdf in analytic_sdf, with the same fields without
    units. None for a mesh, whose file is not read here."""
    if i.shape == "mesh":
        return None
    from tacgen.geometry import analytic_sdf

    fields = {name.removesuffix("_mm"): value for name, value in i if name != "shape" and value is not None}
    if "half_angle_deg" in fields:
        fields["half_angle"] = math.radians(fields.pop("half_angle_deg"))
    shape: Shape = getattr(analytic_sdf, f"{type(i).__name__}Sdf")(**fields)
    return shape
