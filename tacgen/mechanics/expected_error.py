"""About how far a frame's force is off because of the mesh, from the element edge and the width of the contact."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.base.errors import UserError
from tacgen.mechanics.face_overlap import FaceGrid, Overlap
from tacgen.mechanics.scene import Scene

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody

Array = np.ndarray
# fitted to 45 scenes by a script, last in f8101efd
SMOOTH_ERROR_AT_1_MM, EDGE_EXPONENT, WIDTH_EXPONENT = 0.110, 1.8, -0.45
SHARP_EDGE_ERROR = 0.2  # error over edge / size of a contact at edges sharper than the mesh [-], by benchmarks/sharp.py
# radius over the element edge, below which it is such an edge; above, the error falls as 1 / radius [-]
SHARP_RADIUS_RATIO = 1.5
# within which most measured errors are: 77 % of 75 errors of 15 scenes that the fit has not seen
ERROR_ESTIMATE_FACTOR = 2
MAX_EXPECTED_ERROR = 0.5  # expected error [-] above which a force is not shipped


def expected_force_error(edge: float, contact: Overlap, radius: float) -> float:
    """Expected error of the force by the mesh, over the force [-], within a factor of 2; nan without contact:

        .110 edge^1.8 width^-.45 + .2 min(1, 1.5 edge / radius) edge / size,    size^2 = width area^1/2

    The second part is that of edges and tips: a mesh cannot dent more narrowly than its edge, so the gel is pressed on
    a wider strip around a sharp rim. It says how large the error is, not its sign (mostly the force is too large).
    Measured for hexahedra and contact by distance, with edges from .3 to 1.2 mm against .21 mm, in presses of ordinary
    scenes (benchmarks/draws.py), and of sharp ones (benchmarks/sharp.py). Long frames with friction, folds and the
    gel's constants have errors of their own.

    Args:
        edge: element edge under the contact [mm]. radius: the indenter's smallest one in contact [mm].
    """
    if not (width := contact.width) > 0:
        return math.nan
    smooth = SMOOTH_ERROR_AT_1_MM * edge**EDGE_EXPONENT * width**WIDTH_EXPONENT
    sharp = (
        SHARP_EDGE_ERROR
        * min(1.0, SHARP_RADIUS_RATIO * edge / max(radius, 1e-9))
        * edge
        / math.sqrt(width * math.sqrt(contact.area))
    )
    return float(smooth + sharp)


def frame_error(gel: "GelBody", shape: "Shape", pose: Array, edge: float) -> float:
    """Expected error of the force [-] of an indenter at a pose (4, 4), see expected_force_error."""
    face = FaceGrid.of(gel)
    contact = face.overlap(shape, pose)
    return expected_force_error(edge, contact, face.radius(shape, pose) if contact.area else math.inf)


@dataclass(frozen=True)
class Expected:
    """The expected error of the force [-] in that frame of a scene whose contact is widest, by an element `edge` [mm]
    and the indenter's smallest radius in contact [mm]."""

    error: float
    edge: float
    contact: Overlap
    radius: float

    @classmethod
    def of(cls, scene: Scene) -> "Expected | None":
        """None where it is not known: without contact, and for linear tetrahedra."""
        if scene.element == "linear_tet":
            return None
        contact, pose = max(scene.overlaps, key=lambda each: each[0].area)
        if not contact.perimeter:
            return None
        radius = FaceGrid.of(scene.gel).radius(scene.shape, pose)
        return cls(expected_force_error(scene.edge, contact, radius), scene.edge, contact, radius)

    def edge_with(self, error: float, longest: float, ratio: float) -> float:
        """The longest element edge [mm] with at most this expected error [-], of `longest` and its products with powers
        of `ratio` [-]."""
        edge = longest
        while expected_force_error(edge, self.contact, self.radius) > error:
            edge *= ratio
        return edge

    def note(self) -> str:
        """A line on the error, as `validate` and the bundle tell it."""
        sharp = f", where the indenter has a radius of {self.radius:.2g} mm" if self.radius < self.edge else ""
        return (
            f"expected error of the force by the mesh: about {_rounded(100 * self.error)} %, within a factor of"
            f" {ERROR_ESTIMATE_FACTOR} (edges of {self.edge:g} mm, a contact {self.contact.width:.2g} mm wide{sharp}); "
            f"more where the"
            " contact is narrower"
        )

    def refuse(self) -> None:
        """Raise UserError if no frame can be right."""
        if self.error <= MAX_EXPECTED_ERROR:
            return
        fine = self.edge_with(MAX_EXPECTED_ERROR / 2, self.edge, 0.9)
        raise UserError(
            f"quality: edges of {self.edge:g} mm are too long for a contact {self.contact.width:.2g} mm wide: forces"
            f" would be about {_rounded(100 * self.error)} % off; ask for quality: {{edge_mm: {fine:.2g}}}"
        )


def _rounded(percent: float) -> str:
    """To one digit, without an exponent."""
    return f"{float(f'{percent:.1g}'):g}"
