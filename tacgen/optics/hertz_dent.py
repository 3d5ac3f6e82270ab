"""The dent of a rigid ball by Hertz's formulas: a stand-in for a solved gel in calibration and tests."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.camera import Camera
from tacgen.optics.surface_grid import Surface, Untouched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SHALLOW = 0.95  # contact radius over the ball's, at most
FADE = 2.0  # [mm] over which a thin bonded gel, unlike Hertz's half-space, forgets the dent


@dataclass(frozen=True)
class BallDent:
    """A spherical cap of the ball inside the contact circle, Hertz's fading dip outside it."""

    radius: float  # of the ball [mm]
    contact: float  # radius of the contact circle [mm], < radius
    center: tuple[float, float] = (0.0, 0.0)  # [mm]
    face: Surface = field(default_factory=Untouched)  # untouched; on a dome `radius` is relative

    @classmethod
    def seen(
        cls,
        camera: Camera,
        radius: float,
        center_px: tuple[float, float],
        contact_px: float,
        face: Surface | None = None,
        bend: float = 0.0,
    ) -> "BallDent":
        """The dent whose contact circle a photograph shows at `center_px` with radius `contact_px` [px].

        `face` is the untouched one, a plane at z = 0 if None, and `bend` its mean curvature [1/mm].
        """
        face, radius = face or Untouched(), 1 / (1 / radius + bend)
        contact, center = contact_px * camera.mm_per_px, np.zeros(2)
        for _ in range(5):  # the circle lies below the untouched face, where everything looks larger
            plane = face.at(center[None])[0, 2] - contact**2 / (2 * radius)
            around = contact_px * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
            origin, direction = camera.rays(around + center_px)
            hit = (origin + direction * ((plane - origin[:, 2]) / direction[:, 2])[:, None])[:, :2]
            contact, center = float(np.linalg.norm(hit - hit.mean(axis=0), axis=1).mean()), hit.mean(axis=0)
        return cls(radius, min(contact, SHALLOW * radius), (float(center[0]), float(center[1])), face)

    def at(self, xy: Any) -> "Floats":
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]; points move along z only."""
        xy = np.asarray(xy, dtype=np.float64)
        r = np.hypot(xy[:, 0] - self.center[0], xy[:, 1] - self.center[1])
        a, ball = self.contact, self.radius
        far = np.maximum(r, a)
        dip = (2 * a * a - far**2) * np.arcsin(a / far) + a * np.sqrt(far**2 - a * a)
        dip *= np.exp(-(far - a) / FADE) / (np.pi * ball)
        cap = np.sqrt(np.maximum(ball**2 - np.minimum(r, a) ** 2, 0)) - np.sqrt(ball**2 - a * a)
        return np.asarray(self.face.at(xy) - np.column_stack([0 * xy, dip + cap]))
