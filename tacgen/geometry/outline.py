"""The outline of a pad and the height of its face."""

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Pad:
    """A rectangle with rounded corners or with one semicircular end, centred on 0; width along x, height along y [mm].

    tip: the end in y (-1, +1) that is a semicircle over the whole width, 0 for none; radii of the dome along x and y
    [mm].
    """

    width: float
    height: float
    corner_radius: float = 0.0
    tip: int = 0
    radii: tuple[float, float] = (np.inf, np.inf)

    @property
    def flat(self) -> bool:
        """Whether the whole face lies at z = 0."""
        return bool(np.isinf(self.radii).all())

    def top(self, x: Array | float, y: Array | float) -> Array:
        """z of the untouched face [mm], 0 at the crown; x and y broadcast; nan where they are."""
        if self.flat:
            return np.asarray(0.0 * np.abs(x + y))
        return np.asarray(0.0 - np.hypot(x * x / (2 * self.radii[0]), y * y / (2 * self.radii[1])))

    def contains(self, x: Array | float, y: Array | float, slack: float = 0.0) -> Array:
        """Whether points lie inside the outline, or at most `slack` [mm] outside; x and y broadcast."""
        w, h, r = self.width / 2, self.height / 2, self.corner_radius
        if self.tip:
            past = self.tip * y - (h - w)  # beyond the semicircle's centre, toward the tip
            return np.asarray((-self.tip * y <= h + slack) & (np.hypot(x, np.maximum(past, 0)) <= w + slack))
        beyond = np.hypot(np.maximum(np.abs(x) - (w - r), 0), np.maximum(np.abs(y) - (h - r), 0))
        within = (np.abs(x) <= w + slack) & (np.abs(y) <= h + slack) & (beyond <= max(r, 1e-12) + slack)
        return np.asarray(within)

    def drawn_in(self, xy: Array) -> Array:
        """Points (n, 2) of the bounding box; those outside a semicircle or a rounded corner are moved to its arc."""
        if self.tip:
            radius = self.width / 2
            out = xy - (0.0, self.tip * (self.height / 2 - radius))
            far = np.linalg.norm(out, axis=1)
            beyond = (self.tip * out[:, 1] > 0) & (far > radius)
            return np.asarray(xy + np.where(beyond, radius / np.maximum(far, 1e-300) - 1.0, 0.0)[:, None] * out)
        if not self.corner_radius:
            return xy
        core = np.array([self.width, self.height]) / 2 - self.corner_radius
        inner = np.clip(xy, -core, core)
        out = xy - inner
        far = np.linalg.norm(out, axis=1)
        shrink = np.minimum(1.0, self.corner_radius * (1 - 1e-9) / np.maximum(far, 1e-300))
        return np.asarray(inner + out * shrink[:, None])

    def outline(self, sag: float) -> Array:
        """Corners (n, 2) of a polygon inside the pad, counter-clockwise; its sides lie within `sag` [mm] of arcs."""
        w, h, r = self.width / 2, self.height / 2, self.corner_radius
        if self.tip:
            arc = np.linspace(0, np.pi, _corners(np.pi, w, sag))
            end = np.column_stack([w * np.cos(arc), h - w + w * np.sin(arc)])
            whole = np.concatenate([[[-w, -h], [w, -h]], end])
            return whole if self.tip > 0 else -whole
        arc = np.linspace(0, np.pi / 2, _corners(np.pi / 2, r, sag))
        quarter = np.column_stack([np.cos(arc), np.sin(arc)]) * r
        turns = [np.array([[c, -s], [s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        centres = np.array([[w - r, h - r], [r - w, h - r], [r - w, r - h], [w - r, r - h]])
        return np.concatenate([quarter @ R.T + c for R, c in zip(turns, centres, strict=True)])

    def housing(self, margin: float) -> "Pad":
        """The outline at a distance `margin` [mm] around the pad, with square corners."""
        return replace(self, width=self.width + 2 * margin, height=self.height + 2 * margin, corner_radius=0.0)

    def walls(self, pieces: int) -> Array:
        """Corners (n, 2) of a polygon around the pad, from +x to +y; a semicircle has `pieces` sides."""
        w, h = self.width / 2, self.height / 2
        square = np.array([[w, h], [-w, h], [-w, -h], [w, -h]])
        if not self.tip:
            return square
        turn = np.pi * (1 + (np.arange(pieces) + 0.5) / pieces)
        arc = np.column_stack([np.cos(turn), np.sin(turn)]) * w / np.cos(np.pi / pieces / 2) + [0, w - h]
        round_at_top = np.concatenate([square[:2], arc])
        return round_at_top if self.tip < 0 else round_at_top[::-1] * [1, -1]


def _corners(angle: float, radius: float, sag: float) -> int:
    """Number of points on an arc, ends included, so that chords are within `sag` of it."""
    return 1 + int(np.ceil(angle / (2 * np.arccos(1 - min(sag, radius) / radius)))) if radius else 1
