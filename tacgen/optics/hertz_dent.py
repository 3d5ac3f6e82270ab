"""The dent of a rigid ball in a thin bonded gel by formula, for calibration and tests without a solve."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Surface, Untouched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MAX_CONTACT_RADIUS_RATIO = 0.95  # largest contact radius over the ball's radius [-]
DECAY_LENGTH_RATIO = 0.1  # decay length of the depression around the contact, over the gel's thickness [-]
# of the contact radius: width in which the relief of photographed skins fades, half on either side of the circle
TOUCHED_RIM_RATIO = 0.2
MAX_RIM_SLOPE = 0.8  # largest slope at the contact's rim [-]


@dataclass(frozen=True)
class BallDent:
    """A spherical cap inside the contact circle, and around it a depression that starts with the ball's slope.

    Its shape is that of solved pads of 4 mm under balls of 1.9 to 4.8 mm, pressed by 0.6 to 1.5 mm, within 0.08 mm. On
    Hertz's half-space the rim would be two to three times as deep, and the depression several times as wide.
    """

    radius: float  # of the ball [mm]
    contact: float  # radius of the contact circle [mm], < radius
    center: tuple[float, float] = (0.0, 0.0)  # [mm]
    face: Surface = field(default_factory=Untouched)  # untouched; on a dome `radius` is relative
    thickness: float = 4.0  # of the gel [mm]

    @classmethod
    def seen(
        cls,
        camera: PinholeCamera,
        radius: float,
        center_px: tuple[float, float],
        contact_px: float,
        face: Surface | None = None,
        bend: float = 0.0,
    ) -> "BallDent":
        """The dent whose contact circle a photograph shows at `center_px` with radius `contact_px` [widths of a
        pixel].

        `face` is the untouched one, a plane at z = 0 if None, and `bend` its mean curvature [1/mm].
        """
        face, radius = face or Untouched(), 1 / (1 / radius + bend)
        gel = sum(camera.stack.thicknesses[2:] or camera.stack.thicknesses[1:])  # after the plate, if there is one
        contact, center = contact_px * camera.mm_per_px, np.zeros(2)
        for _ in range(5):  # the circle lies below the untouched face, where everything looks larger
            plane = (
                face.at(center[None])[0, 2]
                - cls(radius, min(contact, MAX_CONTACT_RADIUS_RATIO * radius), thickness=gel).rim
            )
            around = contact_px * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]]) / [1, camera.aspect]
            origin, direction = camera.rays(around + center_px)
            hit = (origin + direction * ((plane - origin[:, 2]) / direction[:, 2])[:, None])[:, :2]
            contact, center = float(np.linalg.norm(hit - hit.mean(axis=0), axis=1).mean()), hit.mean(axis=0)
        return cls(
            radius, min(contact, MAX_CONTACT_RADIUS_RATIO * radius), (float(center[0]), float(center[1])), face, gel
        )

    @property
    def rim(self) -> float:
        """How far the contact circle lies below the untouched face [mm]."""
        slope = self.contact / np.sqrt(self.radius**2 - self.contact**2)
        return float(DECAY_LENGTH_RATIO * self.thickness * min(slope, MAX_RIM_SLOPE))

    def at(self, xy: Any) -> "Floats":
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]; points move along z only."""
        xy = np.asarray(xy, dtype=np.float64)
        r, a, ball = self._away(xy), self.contact, self.radius
        dip = self.rim * np.exp(-np.maximum(r - a, 0) / (DECAY_LENGTH_RATIO * self.thickness))
        cap = np.sqrt(np.maximum(ball**2 - np.minimum(r, a) ** 2, 0)) - np.sqrt(ball**2 - a * a)
        return np.asarray(self.face.at(xy) - np.column_stack([0 * xy, dip + cap]))

    def touched(self, xy: Any) -> "Floats":
        """Share of contact (n,), 0 to 1, at rest positions (n, 2) [mm]."""
        rim = TOUCHED_RIM_RATIO * self.contact
        return np.asarray(np.clip((self.contact - self._away(np.asarray(xy, dtype=np.float64))) / rim + 0.5, 0.0, 1.0))

    def _away(self, xy: "Floats") -> "Floats":
        return np.asarray(np.hypot(xy[:, 0] - self.center[0], xy[:, 1] - self.center[1]))
