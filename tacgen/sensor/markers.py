"""Markers of a sensor file: where dots are printed on its coating, and the constants of their analytic motion."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from tacgen.sensor.base_model import NO_SOURCE, Fraction, Part, Positive, Vec2

MAX_DOTS = 10_000  # dots of a sensor


class Motion(Part):
    """Constants of the analytic marker motion, `markers: {method: analytic}`; see outputs/fots_markers."""

    press: tuple[float, Positive]
    """Gain [1/mm^3] and decay [1/mm^2]."""
    shear: tuple[Positive, Positive]
    """Largest drag of the contact's centre [mm], and decay [1/mm^2]."""
    twist: tuple[Positive, Positive]
    """Largest rotation [deg], and decay [1/mm^2]."""
    source: str = NO_SOURCE


class MarkersBase(Part):
    """Markers: dots printed on the coating, in rows along x."""

    diameter_mm: Positive
    """Diameter of a dot."""
    albedo: Fraction
    """Diffuse reflectance of a dot."""
    offset_mm: Vec2 | None = None
    """From the pad's middle to the lattice's, along x and y; none if absent."""
    motion: Motion | None = None
    """Constants of the analytic motion; without them `markers: {method: analytic}` is refused."""
    source: str = NO_SOURCE

    @property
    def count(self) -> int:
        """Number of dots."""
        raise NotImplementedError

    @property
    def middle_mm(self) -> Vec2:
        """The lattice's middle on the coating."""
        return self.offset_mm or (0.0, 0.0)

    @model_validator(mode="after")
    def _few(self) -> Self:
        if self.count > MAX_DOTS:
            raise ValueError(f"must be at most {MAX_DOTS} dots (got {self.count})")
        return self


class GridMarkers(MarkersBase):
    """Dots in a rectangular grid; the default layout."""

    layout: Literal["grid"] = "grid"
    """A rectangular grid."""
    columns: Annotated[int, Field(ge=1)]
    """Number of dots along x."""
    rows: Annotated[int, Field(ge=1)]
    """Number of dots along y."""
    pitch_mm: tuple[Positive, Positive]
    """Distance between columns, and between rows."""

    @property
    def count(self) -> int:
        return self.columns * self.rows

    @property
    def row_counts(self) -> tuple[int, ...]:
        """Number of dots in each row, from the least y."""
        return (self.columns,) * self.rows

    @property
    def spacing_mm(self) -> Vec2:
        """Between the dots of a row, and between rows."""
        return self.pitch_mm

    @property
    def nearest_mm(self) -> float:
        """Distance of a dot from the nearest other one; inf if there is none."""
        counts = zip((self.columns, self.rows), self.pitch_mm, strict=True)
        return min((pitch for count, pitch in counts if count > 1), default=math.inf)


class HexagonalMarkers(MarkersBase):
    """Dots in hexagonal rings around one in the middle: 6 dots in the first ring, and 6 more in each further one."""

    layout: Literal["hexagonal"]
    """Hexagonal rings around a dot in the middle."""
    rings: Annotated[int, Field(ge=1)]
    """Number of rings."""
    pitch_mm: Positive
    """Distance between nearest dots, six of which surround each inner one; two of them along x."""

    @property
    def count(self) -> int:
        return 1 + 3 * self.rings * (self.rings + 1)

    @property
    def row_counts(self) -> tuple[int, ...]:
        """As of a grid: the row through the middle has 2 rings + 1 dots, and each beyond it one fewer."""
        return tuple(2 * self.rings + 1 - abs(row) for row in range(-self.rings, self.rings + 1))

    @property
    def spacing_mm(self) -> Vec2:
        """As of a grid."""
        return self.pitch_mm, self.pitch_mm * math.sqrt(3) / 2

    @property
    def nearest_mm(self) -> float:
        """As of a grid."""
        return self.pitch_mm


def layout(value: Any) -> str:
    """The layout that a mapping or model says, or `grid`. Error messages show this function's name as the key."""
    return str(value.get("layout", "grid") if isinstance(value, dict) else getattr(value, "layout", "grid"))


Markers = Annotated[
    Annotated[GridMarkers, Tag("grid")] | Annotated[HexagonalMarkers, Tag("hexagonal")], Discriminator(layout)
]
