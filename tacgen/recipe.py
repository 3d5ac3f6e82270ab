"""YAML -> Recipe: what a person wrote, checked, with line numbers. Lengths in mm, angles in degrees."""

from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from tacgen.part import Part
from tacgen.turns import UPRIGHT, Quaternion, Vector, unit
from tacgen.yamlfile import KeyPath

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Acute = Annotated[float, Field(gt=0, lt=90)]
Frames = Annotated[int, Field(ge=1, le=10_000)]
OutputName = Literal["force", "traction", "force_map", "height", "normals", "gap", "stress", "markers", "rgb"]
OUTPUTS: tuple[str, ...] = get_args(OutputName)


def _smaller(value: float, limit: float | None, what: str, *, equal: bool = True) -> float:
    """Raise ValueError unless value <= limit (or < limit); `limit` is None when it is itself wrong."""
    if limit is not None and (value > limit or (value == limit and not equal)):
        raise ValueError(f"must be {'at most' if equal else 'less than'} {what}, {limit:g} (got {value:g})")
    return value


class Sphere(Part):
    """A ball."""

    shape: Literal["sphere"]
    radius_mm: Positive


class Cylinder(Part):
    """A flat punch: a round rod whose axis is z, its lower edge rounded."""

    shape: Literal["cylinder"]
    radius_mm: Positive
    fillet_mm: Annotated[float, Field(gt=0, validate_default=True)] = 0.2

    @field_validator("fillet_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        return _smaller(value, info.data.get("radius_mm"), "radius_mm")


class Cone(Part):
    """A cone pointing down with a ball for a tip; the half angle is measured from its axis."""

    shape: Literal["cone"]
    half_angle_deg: Acute
    tip_radius_mm: Positive


class Box(Part):
    """A block with rounded edges, flat side down."""

    shape: Literal["box"]
    size_x_mm: Positive
    size_y_mm: Positive
    fillet_mm: Annotated[float, Field(gt=0, validate_default=True)] = 0.2

    @field_validator("fillet_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        sides = [info.data[side] for side in ("size_x_mm", "size_y_mm") if side in info.data]
        return _smaller(value, min(sides) / 2 if sides else None, "half the shorter side")


class Wedge(Part):
    """A wedge pointing down whose rounded edge lies along y; the half angle is measured from z."""

    shape: Literal["wedge"]
    half_angle_deg: Acute
    tip_radius_mm: Positive
    length_mm: Positive


class Capsule(Part):
    """A rod with round ends lying along x; the length is between the centres of its two balls."""

    shape: Literal["capsule"]
    radius_mm: Positive
    length_mm: Positive


class Torus(Part):
    """A ring lying flat: `radius_mm` from its axis to the centre of the tube."""

    shape: Literal["torus"]
    radius_mm: Positive
    tube_radius_mm: Positive

    @field_validator("tube_radius_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        return _smaller(value, info.data.get("radius_mm"), "radius_mm", equal=False)


class Mesh(Part):
    """A closed triangle mesh (STL, OBJ, PLY), its lowest point at the gel and its middle over it."""

    shape: Literal["mesh"]
    file: Annotated[str, Field(min_length=1)]  # an object's name, or a path that starts at the recipe's folder
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "+z"  # which axis of the file points away from the gel
    scale: Positive = 1.0  # mm per unit of the file
    size_mm: Positive | None = None  # instead of scale: the longest side
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None  # the file must be this one; bundles say it

    @field_validator("size_mm")
    @classmethod
    def _alone(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("scale", 1.0) != 1.0:
            raise ValueError("cannot be given beside scale")
        return value


Indenter = Annotated[Sphere | Cylinder | Cone | Box | Wedge | Capsule | Torus | Mesh, Field(discriminator="shape")]
SHAPES: dict[str, type[Part]] = {
    kind.model_fields["shape"].annotation.__args__[0]: kind  # type: ignore[union-attr]
    for kind in (Sphere, Cylinder, Cone, Box, Wedge, Capsule, Torus, Mesh)
}


def _exactly_one(part: Part, what: str, names: tuple[str, ...] = ()) -> None:
    """Raise ValueError unless one field is given, of `names` or of all."""
    names = names or tuple(type(part).model_fields)
    given = [name for name in names if getattr(part, name) is not None]
    if len(given) != 1:
        raise ValueError(f"must hold exactly one {what} of {', '.join(names)} (got {', '.join(given) or 'none'})")


class Start(Part):
    """Where the indenter stands before it moves: its lowest point `clearance_mm` over the untouched face."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    clearance_mm: float = 0.0
    yaw_deg: float = 0.0
    tilt_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    tilt_axis_deg: float = 0.0

    @field_validator("clearance_mm")
    @classmethod
    def _outside(cls, value: float) -> float:
        if value < 0:
            raise ValueError(f"must be at least 0 (got {value:g}): the indenter would start inside the gel")
        return value


class Made(Part):
    """A movement of as many frames as one says; `duration_s` is what all of them take, where there is `dynamics`."""

    frames: Frames
    duration_s: Positive | None = None


class Press(Made):
    """Move along z to `depth_mm` below first touch of the untouched face, or until the gel bears `force_n`.

    On a dome first touch is wherever that is.

    With a force the frames go in equal steps of the normal force, from the one before to the one asked for.
    """

    depth_mm: Positive | None = None
    force_n: Positive | None = None

    @model_validator(mode="after")
    def _one(self) -> "Press":
        _exactly_one(self, "aim", ("depth_mm", "force_n"))
        return self


class Slide(Made):
    """Move sideways by this much from where the indenter is."""

    x_mm: float = 0.0
    y_mm: float = 0.0


class Twist(Made):
    """Turn about the indenter's own axis by this much."""

    angle_deg: float


class Tilt(Made):
    """Turn about a horizontal axis through the indenter's lowest point; the axis is `axis_deg` from x towards y."""

    angle_deg: Annotated[float, Field(gt=-90, lt=90)]
    axis_deg: float = 0.0


class Placement(Part):
    """Where one frame stands in another: its origin there, and its turn as a unit quaternion w, x, y, z."""

    position_mm: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UPRIGHT

    @field_validator("quaternion")
    @classmethod
    def _unit(cls, value: Quaternion) -> Quaternion:
        return unit(value)


class Replay(Part):
    """Go through the poses of a table, a frame a row: where the indenter's own frame stands in the sensor's.

    The table is CSV with a header: time_s, x_mm, y_mm, z_mm (or x_m, ...), qw, qx, qy, qz. Rows in another frame than
    the sensor's need `sensor_pose`, rows of another body's frame than the indenter's `indenter_pose`.
    """

    file: Annotated[str, Field(min_length=1)]  # a path that starts at the recipe's folder
    units: Literal["mm", "m"] | None = None  # of x, y, z where the header does not say; mm if neither does
    sensor_pose: Placement = Placement()  # of the sensor in the frame that the rows are given in
    indenter_pose: Placement = Placement()  # of the indenter in the frame of the body whose poses the rows are
    every: Annotated[int, Field(ge=1)] = 1  # take the first row and then each so many
    frames: Frames | None = None  # stop after so many; None: at the table's end
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None  # the file must be this one; bundles say it


class Hold(Made):
    """Stay."""


class Release(Made):
    """Lift back to the height of the start."""


Move = Press | Slide | Twist | Tilt | Replay | Hold | Release
ONE_KEY: dict[str, Any] = {"minProperties": 1, "maxProperties": 1}


class Segment(Part, json_schema_extra=ONE_KEY):
    """One step of the trajectory: `press: {depth_mm: 1, frames: 5}` and the like."""

    press: Press | None = None
    slide: Slide | None = None
    twist: Twist | None = None
    tilt: Tilt | None = None
    replay: Replay | None = None
    hold: Hold | None = None
    release: Release | None = None

    @model_validator(mode="after")
    def _one(self) -> "Segment":
        _exactly_one(self, "movement")
        return self

    @property
    def kind(self) -> str:
        """press, slide, twist, tilt, replay, hold or release."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    @property
    def move(self) -> Move:
        """The one movement that is given."""
        found: Move = getattr(self, self.kind)
        return found

    @property
    def frames(self) -> int:
        """How many frames it gives."""
        assert self.move.frames is not None, "only a plan knows how many rows a table has"
        return self.move.frames


class Contact(Part):
    """How indenter and gel touch."""

    friction: NotNegative = 0.0


class Rayleigh(Part):
    """Damping in proportion to mass and to stiffness."""

    alpha_per_s: NotNegative = 0.0
    beta_s: NotNegative = 0.0


class Dynamics(Part):
    """Let the gel's inertia and damping count. Without, it is as if everything moved infinitely slowly."""

    density_kg_m3: Positive
    rayleigh: Rayleigh = Rayleigh()
    frame_s: Positive | None = None  # what a frame takes; a movement's duration_s and a replay's times go before it
    step_s: Positive | None = None  # a frame that takes longer goes in several steps of time; None: in one


class Render(Part):
    """How camera images are made: `transport` without noise, or Mitsuba's `path` with the noise of `spp` paths."""

    method: Literal["transport", "path"] = "transport"


class Quality(NamedTuple):
    """Numbers that trade time for error."""

    edge_mm: float  # of the mesh under the contact
    dhat_mm: float  # range of the contact barrier
    spp: int  # samples a pixel


QUALITIES = {
    "draft": Quality(0.6, 0.05, 16),
    "default": Quality(0.4, 0.03, 64),
    "reference": Quality(0.2, 0.01, 512),
}


class QualityNumbers(Part):
    """Numbers given one by one; what is left out is as in `default`."""

    edge_mm: Positive | None = None
    dhat_mm: Positive | None = None
    spp: Annotated[int, Field(ge=1)] | None = None


def _quality_tag(value: Any) -> str:
    return "numbers" if isinstance(value, dict | QualityNumbers) else "preset"


class Distribution(Part, json_schema_extra=ONE_KEY):
    """Where the values of one varied path come from."""

    uniform: tuple[float, float] | None = None
    loguniform: tuple[Positive, Positive] | None = None
    integers: tuple[int, int] | None = None  # both ends included
    choice: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    linspace: tuple[float, float, Annotated[int, Field(ge=1, le=1_000_000)]] | None = None

    @field_validator("uniform", "loguniform", "integers")
    @classmethod
    def _ordered(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not value[0] < value[1]:
            raise ValueError(f"must be [low, high] with low < high (got [{value[0]:g}, {value[1]:g}])")
        return value

    @model_validator(mode="after")
    def _one(self) -> "Distribution":
        _exactly_one(self, "distribution")
        return self


class Vary(Part):
    """A batch: many scenes from one recipe."""

    method: Literal["grid", "random", "sobol", "lhs", "halton"] = "sobol"
    samples: Annotated[int | None, Field(ge=1, le=1_000_000, validate_default=True)] = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    over: Annotated[dict[str, Distribution], Field(min_length=1)]

    @field_validator("samples")
    @classmethod
    def _when_needed(cls, value: int | None, info: ValidationInfo) -> int | None:
        method = info.data.get("method")
        if method == "grid" and value is not None:
            raise ValueError("must be left out: a grid has as many scenes as its choices and linspaces give")
        if method not in (None, "grid") and value is None:
            raise ValueError(f"is missing: how many scenes to draw by {method}")
        return value


def _filled(value: frozenset[str]) -> frozenset[str]:
    if not value:
        raise ValueError(f"must name at least one of {', '.join(OUTPUTS)}")
    return value


Outputs = Annotated[frozenset[OutputName], AfterValidator(_filled), Field(json_schema_extra={"minItems": 1})]


class Recipe(Part):
    """What a person wrote: one scene, or with `vary` a batch of them."""

    tacgen: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    sensor: Annotated[str, Field(min_length=1)]
    sensor_overrides: dict[str, Any] = Field(default_factory=dict)
    indenter: Indenter
    start: Start = Start()
    trajectory: Annotated[tuple[Segment, ...], Field(min_length=1)]
    contact: Contact = Contact()
    dynamics: Dynamics | None = None
    render: Render = Render()
    outputs: Outputs
    quality: Annotated[
        Annotated[Literal["draft", "default", "reference"], Tag("preset")] | Annotated[QualityNumbers, Tag("numbers")],
        Discriminator(_quality_tag),
    ] = "default"
    vary: Vary | None = None

    def resolved(self) -> Quality:
        """The quality as numbers."""
        if isinstance(self.quality, str):
            return QUALITIES[self.quality]
        given = {name: value for name, value in self.quality.model_dump().items() if value is not None}
        return QUALITIES["default"]._replace(**given)

    @property
    def frames(self) -> int:
        """How many frames a scene has."""
        return sum(segment.frames for segment in self.trajectory)

    @property
    def files(self) -> tuple[KeyPath, ...]:
        """Where it names files by a path that starts at the recipe's folder."""
        tables = [("trajectory", i, "replay", "file") for i, step in enumerate(self.trajectory) if step.replay]
        return (*([("indenter", "file")] if self.indenter.shape == "mesh" else []), *tables)

    def document(self) -> dict[str, Any]:
        """Plain values that YAML and JSON can hold and that read back as the same recipe."""
        plain: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        plain["outputs"] = [name for name in OUTPUTS if name in self.outputs]
        return plain
