"""The model of a recipe file: its keys, their types and their ranges. Lengths in mm, angles in degrees."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from tacgen.outputs import OUTPUT_NAMES
from tacgen.recipe.indenters import Indenter
from tacgen.recipe.trajectory import Segment, Start, Vector
from tacgen.sensor.base_model import ONE_KEY, FilePath, NotNegative, Part, Positive, Sha256, exactly_one
from tacgen.sensor.yaml_source import KeyPath

if TYPE_CHECKING:
    OutputName = str
else:
    OutputName = Literal[OUTPUT_NAMES]
Element = Literal["hex", "tet", "linear_tet"]  # linear tets lock in a nearly incompressible gel: for comparison only


class ContactSettings(Part):
    """How indenter and gel touch."""

    friction: NotNegative = 0.0


class Grasp(Part):
    """Two fingers close on the indenter, a free rigid object that stands upright between them; gives two bundles.

    World frame: x is the closing axis, from the left finger to the right one; z is up; the origin is midway between.
    """

    mass_kg: Positive
    right: Annotated[str, Field(min_length=1)] | None = None  # the right finger's sensor; None: as the left
    height_mm: Positive | None = None  # fingers' middle above the object's lowest point; None: half its height
    y_mm: float = 0.0  # y of the object in the world frame
    yaw_deg: float = 0.0  # rotation of the object about the vertical
    centre_mm: Vector | None = None  # centre of mass in the object's frame; None: on its axis, at the fingers' height
    gravity: Vector = (0.0, 0.0, -1.0)  # direction of gravity in the world frame
    fall_mm: Positive = 0.5  # how far the object sinks in one frame when friction cannot carry it

    @field_validator("gravity")
    @classmethod
    def _somewhere(cls, value: Vector) -> Vector:
        if not 1e-100 < max(map(abs, value)) < 1e100:  # the squares of others are 0 or inf
            raise ValueError(f"must be a direction, such as 0, 0, -1 (got {', '.join(f'{part:g}' for part in value)})")
        return value


class Rayleigh(Part):
    """Rayleigh damping: alpha times the mass matrix plus beta times the stiffness matrix."""

    alpha_per_s: NotNegative = 0.0
    beta_s: NotNegative = 0.0


class Dynamics(Part):
    """Inertia and damping of the gel. Without this part every frame is a static equilibrium."""

    density_kg_m3: Positive
    rayleigh: Rayleigh = Rayleigh()
    frame_s: Positive | None = None  # duration of a frame, unless a movement's duration_s or a replay's times give it
    step_s: Positive | None = None  # longest time step, into which frames are divided; None: one step a frame


class Render(Part):
    """How camera images are made.

    `transport` computes the light without sampling noise; `path` is Mitsuba's path tracer with `spp` samples a pixel;
    `table` is Taxim's look-up of colour by slope and position, which takes milliseconds and is less accurate.
    `noise` adds the camera's noise of the sensor file to /frames/rgb.
    """

    method: Literal["transport", "path", "table"] = "transport"
    noise: bool = True
    # photograph of your own untouched unit, with its dots where the sensor file has them: the image is
    # photograph x (render of the deformed gel / render of the untouched gel)
    background: FilePath | None = None
    background_sha256: Sha256 | None = None


class MarkerMotion(Part):
    """How markers move: `fem`, with the solved gel; or `analytic`, by FOTS's exponential functions of the indenter's
    pose, whose constants are in the sensor file."""

    method: Literal["fem", "analytic"] = "fem"


class MaterialDeviation(Part):
    """Standard deviations of the gel's constants: `modulus` is relative and for all layers, the others absolute.

    They are propagated to first order, which says nothing of larger ones.
    """

    modulus: Annotated[float, Field(ge=0, le=1)] = 0.0
    poissons_ratio: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    friction: Annotated[float, Field(ge=0, le=1)] = 0.0


class PoseDeviation(Part):
    """Standard deviation of the depth, common to all poses."""

    depth_mm: NotNegative = 0.0


class Uncertainty(Part):
    """Standard deviations of the inputs, which are propagated to forces and maps to first order."""

    material: MaterialDeviation = MaterialDeviation()
    pose: PoseDeviation = PoseDeviation()
    mesh: bool = False  # include the discretisation error, estimated by a second solve on a coarser mesh

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations by the names of the inputs; of the depth [mm]."""
        return {**self.material.model_dump(), "depth": self.pose.depth_mm}


class Quality(NamedTuple):
    """Numerical parameters that trade run time for accuracy."""

    edge_mm: float  # element edge under the contact
    dhat_mm: float  # range of the contact barrier
    spp: int  # samples a pixel


QUALITIES = {"draft": Quality(0.6, 0.05, 16), "default": Quality(0.36, 0.02, 64), "reference": Quality(0.2, 0.01, 512)}


class QualityNumbers(Part):
    """Single parameters; those that are left out are as in `default`."""

    edge_mm: Positive | None = None
    dhat_mm: Positive | None = None
    spp: Annotated[int, Field(ge=1)] | None = None
    # expected, of the force [-]: chooses edge and dhat
    force_error: Annotated[float, Field(gt=0, le=0.5)] | None = None

    @model_validator(mode="after")
    def _by_one(self) -> "QualityNumbers":
        if self.force_error is not None and (self.edge_mm is not None or self.dhat_mm is not None):
            raise ValueError("force_error chooses edge_mm and dhat_mm: give it or them")
        return self


def _quality_tag(value: Any) -> str:
    return "numbers" if isinstance(value, dict | QualityNumbers) else "preset"


class Distribution(Part, json_schema_extra=ONE_KEY):
    """The distribution of one varied path."""

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

    _one = exactly_one("one distribution")


# samples up to which an optimised Latin hypercube is used: more even than Sobol's, computed within 1 s
MAX_LHS_SAMPLES = 256


class Vary(Part):
    """A batch: many scenes from one recipe. Each sample of `over` is taken at each point of `grid`."""

    method: Literal["grid", "random", "sobol", "lhs", "halton"] | None = None  # None: lhs for few, sobol for many
    samples: Annotated[int | None, Field(ge=1, le=1_000_000, validate_default=True)] = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    over: Annotated[dict[str, Distribution], Field(min_length=1)]
    grid: dict[str, Distribution] = Field(default_factory=dict)

    @field_validator("samples")
    @classmethod
    def _when_needed(cls, value: int | None, info: ValidationInfo) -> int | None:
        method = info.data.get("method")
        if method == "grid" and value is not None:
            raise ValueError("must be left out: a grid has as many scenes as its choices and linspaces give")
        if method != "grid" and value is None:
            raise ValueError("is missing: how many scenes to draw" + (f" by {method}" if method else ""))
        return value

    @property
    def design(self) -> str:
        """The method: the one that is named, or the one that is chosen by the number of samples."""
        return self.method or ("lhs" if (self.samples or 0) <= MAX_LHS_SAMPLES else "sobol")

    @property
    def paths(self) -> dict[str, KeyPath]:
        """The varied paths, and the place in the recipe where each is written."""
        return {name: ("vary", key, name) for key in ("over", "grid") for name in getattr(self, key)}


def _not_empty(value: frozenset[str]) -> frozenset[str]:
    if not value:
        raise ValueError(f"must name at least one of {', '.join(OUTPUT_NAMES)}")
    return value


SensorName = Annotated[str, Field(min_length=1)]
Outputs = Annotated[frozenset[OutputName], AfterValidator(_not_empty), Field(json_schema_extra={"minItems": 1})]


class Recipe(Part):
    """A recipe as a person wrote it: one scene, or with `vary` a batch of them."""

    tacgen: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    sensor: SensorName
    sensors: Annotated[tuple[SensorName, ...] | None, Field(min_length=2)] = None  # each scene on each of them
    sensor_overrides: dict[str, Any] = Field(default_factory=dict)
    indenter: Indenter
    start: Start = Start()
    trajectory: Annotated[tuple[Segment, ...], Field(min_length=1)]
    grasp: Grasp | None = None
    contact: ContactSettings = ContactSettings()
    dynamics: Dynamics | None = None
    mesh: Element | None = None  # None: hex for a pad, tet for a gel that is read from a file
    render: Render = Render()
    markers: MarkerMotion = MarkerMotion()
    uncertainty: Uncertainty | None = None
    may_miss: bool = False  # whether a scene that touches the gel in no frame is ok; if not, it is rejected
    folds: Literal["keep", "end"] = "keep"  # at the first fold, wrinkle or snap: go on, or end the scene before it
    outputs: Outputs
    quality: Annotated[
        Annotated[Literal["draft", "default", "reference"], Tag("preset")] | Annotated[QualityNumbers, Tag("numbers")],
        Discriminator(_quality_tag),
    ] = "default"
    vary: Vary | None = None

    @field_validator("sensors")
    @classmethod
    def _each_once(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value is not None and len(set(value)) < len(value):
            raise ValueError("must name each sensor once: leave the repeated one out")
        return value

    @field_validator("grasp")
    @classmethod
    def _of_two_sensors(cls, value: Grasp | None, info: ValidationInfo) -> Grasp | None:
        if value is not None and info.data.get("sensors"):
            raise ValueError("cannot be given beside sensors: its fingers' are sensor and right")
        return value

    def resolved(self) -> Quality:
        """The quality as numbers; those that `force_error` chooses are of `default` until a scene is built."""
        if isinstance(self.quality, str):
            return QUALITIES[self.quality]
        given = self.quality.model_dump(exclude={"force_error"}, exclude_none=True)
        return QUALITIES["default"]._replace(**given)

    @property
    def force_error(self) -> float | None:
        """The expected error of the force that is asked for [-]."""
        return None if isinstance(self.quality, str) else self.quality.force_error

    @property
    def frames(self) -> int:
        """How many frames a scene has."""
        return sum(segment.frames for segment in self.trajectory)

    @property
    def differentiable(self) -> bool:
        """Whether derivatives by inputs are asked for that move nodes, as a scale of all moduli does not."""
        deviations = {} if self.uncertainty is None else self.uncertainty.deviations
        return any(value > 0 for name, value in deviations.items() if name != "modulus")

    @property
    def match(self) -> str | None:
        """If a replayed table is met by other things than its poses: force or grip."""
        matched = (step.replay.match for step in self.trajectory if step.replay and step.replay.matched)
        return next(matched, None)

    @property
    def files(self) -> tuple[KeyPath, ...]:
        """The places in the recipe that name files, whose paths are relative to the file they are written in."""
        tables = [("trajectory", i, "replay", "file") for i, step in enumerate(self.trajectory) if step.replay]
        photo = [("render", "background")] if self.render.background is not None else []
        return (*photo, *([("indenter", "file")] if self.indenter.shape == "mesh" else []), *tables)

    def document(self) -> dict[str, Any]:
        """Plain values that YAML and JSON can hold and that read back as the same recipe."""
        plain: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        plain["outputs"] = [name for name in OUTPUT_NAMES if name in self.outputs]
        return plain
