"""Imperfections in which units of one sensor type differ: grain, relief, marks and wear of the coating, glare, drift of
the camera's colours. All are off unless a sensor file gives them."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from tacgen.sensor.base_model import NO_SOURCE, Fraction, Part, Positive, Vec2

NOISE_STREAM = 2  # purpose of random numbers of a scene; a new purpose gets a new number, and sampling has 1
DRIFT_STREAM = 3  # as NOISE_STREAM
Seed = Annotated[int, Field(ge=0, le=999_999)]
Count = Annotated[int, Field(ge=0, le=1000)]
Contrast = Annotated[float, Field(ge=0, le=0.3)]
MIN_GLARE_CELLS, MAX_GLARE_CELLS = 2, 64  # along a side of the picture
_side = Field(min_length=MIN_GLARE_CELLS, max_length=MAX_GLARE_CELLS)
Cells = Annotated[tuple[Annotated[tuple[Annotated[float, Field(ge=-1, le=1)], ...], _side], ...], _side]
Width = Annotated[float, Field(ge=0.005, le=5)]
COATING_PATTERN_FIELDS = "grain", "relief", "marks", "wear"  # of the coating: what differs from place to place


class Grain(Part):
    """Grain of the coating: its reflectance differs from place to place, by the same factor in all colours. It is fixed
    to the gel and moves with it; normals and height do not have it."""

    contrast: Contrast
    """Standard deviation of the reflectance over its mean."""
    length_mm: Width
    """Correlation length: the correlation of two places falls as exp(-distance / length)."""
    seed: Seed = 0
    """Number of the random pattern."""
    source: str = NO_SOURCE


class Relief(Part):
    """Relief of the coating's outer side, fixed to the gel. What touches it flattens it, so that it shows inside there;
    normals and height do not have it."""

    height_mm: Annotated[float, Field(ge=0, le=0.1)]
    """Its standard deviation."""
    length_mm: Width
    """Correlation length, as that of grain."""
    seed: Seed = 0
    """Number of the random pattern."""
    source: str = NO_SOURCE


class Marks(Part):
    """Dust and scratches of the coating at random places of the pad, fixed to the gel. Each mark has a size and a depth
    of its own, between a quarter of the given one and the given one."""

    specks: Count = 0
    """Number of round specks of dust."""
    speck_mm: Width = 0.3
    """Diameter of the largest speck."""
    scratches: Count = 0
    """Number of straight scratches."""
    scratch_mm: Width = 1.5
    """Length of the longest scratch."""
    scratch_width_mm: Width = 0.12
    """Width of a scratch."""
    depth: Fraction = 0.2
    """Share of the light that the darkest mark takes away."""
    bright: Fraction = 0.0
    """Share of the specks that add as much light as dark ones take away."""
    seed: Seed = 0
    """Number of the random places, sizes and depths."""
    source: str = NO_SOURCE


class Wear(Part):
    """Wear of the coating where the pad is used most: less reflectance there, falling off as a Gaussian."""

    loss: Fraction
    """Share of the reflectance that is lost at the middle of the worn area."""
    radius_mm: Positive
    """Standard deviation of the Gaussian."""
    center_mm: Vec2 = (0.0, 0.0)
    """Middle of the worn area at rest."""
    source: str = NO_SOURCE


class Glare(Part):
    """Light of full scale 1 that is added to every picture, below 0 where the model has too much; in a gel that
    scatters it changes with the rest. Values are those at the middles of equal cells; between them it is smooth."""

    red: Cells
    """Rows of cells from the top."""
    green: Cells
    """The same for green."""
    blue: Cells
    """The same for blue."""
    source: str = NO_SOURCE

    @model_validator(mode="after")
    def _grid(self) -> Self:
        lengths = [[len(row) for row in rows] for rows in (self.red, self.green, self.blue)]
        if len({length for each in lengths for length in each}) > 1 or len({len(each) for each in lengths}) > 1:
            raise ValueError("must hold as many rows in each colour, all of one length")
        return self


class Drift(Part):
    """Slow change of the camera's gain, of each colour alone, over the frames of a scene. The untouched picture has
    none."""

    gain: Contrast
    """Standard deviation of the relative change."""
    frames: Positive
    """Correlation length in frames: the correlation of two frames falls as exp(-(difference / frames)^2 / 2)."""
    source: str = NO_SOURCE
