"""Solved presses of a ball into the gel of a sensor file, at several thicknesses: force and shape of the face by depth.

Forces are proportional to the moduli, and the face does not depend on them: one table serves every modulus. Around the
contact the face is taken as round: it is averaged over the angle.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from tacgen import mechanics
from tacgen.base import array_cache
from tacgen.base.errors import UserError
from tacgen.calibrate import solved_presses, steps
from tacgen.calibrate.sensor_fit import moduli
from tacgen.calibrate.solved_presses import MAX_PRESS_DEPTH_RATIO, MIN_PRESS_DEPTH_RATIO
from tacgen.optics.surface_grid import Untouched
from tacgen.outputs import gel_surface
from tacgen.sensor.model import Gel, LitSensor

Array = np.ndarray
DENT_TABLE_VERSION = 2  # of this table, in the key of the cache
DENT_DEPTHS = 9  # depths at which each thickness is solved
DENT_RAYS = 16  # rays around the contact, along which the face is averaged
# radii over sqrt(ball radius x depth)
DENT_RADII = np.concatenate([np.linspace(0, 2, 81), np.geomspace(2, 12, 60)[1:]])
HERTZ_FORCE_POWER = 2 / 3  # F^(2/3) is nearly linear in the depth (Hertz)
# most points of the radius on which slopes are smoothed, and the least width in these
MAX_BLUR_POINTS, MIN_BLUR_SPACINGS = 1200, 0.3
POINTS_PER_BLUR_STD = 10  # points per standard deviation of the smoothing, at least unless MAX_BLUR_POINTS limits them
MAX_DENT_DEPTH_BY_WIDTH = 0.75  # deepest press times the ball's radius, over the square of the largest contact radius
MAX_DEPTH_PER_BALL_RADIUS = 0.8  # of the ball's radius: deepest press


@dataclass(frozen=True)
class Dents:
    """Presses of one ball into a gel of one thickness; depths (n,) [mm] rise from above 0.

    force (n,) [N] at the file's moduli; drop and slope (n, len(DENT_RADII)): change of z over the depth, and of the
    slope over sqrt(depth / ball radius), at DENT_RADII radii; contact (n,): contact radius [mm].
    """

    ball: float  # radius [mm]
    thickness: float  # [mm]
    depth: Array
    force: Array
    drop: Array
    slope: Array
    contact: Array

    def force_at(self, depth: Array) -> Array:
        """Force (k,) [N] at depths (k,) [mm], at the file's moduli; 0 above the gel."""
        force = np.append(0.0, self.force**HERTZ_FORCE_POWER)
        rooted = PchipInterpolator(np.append(0.0, self.depth), force, extrapolate=True)
        return np.asarray(np.maximum(rooted(np.maximum(depth, 0.0)), 0.0) ** (1 / HERTZ_FORCE_POWER))

    def contact_at(self, depth: float) -> float:
        """Contact radius [mm] at a depth [mm]."""
        scaled = self.contact / np.sqrt(self.ball * self.depth)
        return float(np.interp(depth, self.depth, scaled) * np.sqrt(self.ball * max(depth, 0.0)))

    def face(self, depth: float, r: Array, blur: float = 0.0) -> tuple[Array, Array]:
        """Change of z (k,) [mm] and of the radial slope (k,) at distances r (k,) [mm] from the centre of a press.

        `blur`: standard deviation [mm] by which the slope is smoothed along the radius.
        """
        if depth <= 0:
            return np.zeros_like(r), np.zeros_like(r)
        profile = self.profile(depth, blur)
        return profile.drop_at(r), profile.slope_at(r)

    def profile(self, depth: float, blur: float) -> "DentProfile":
        """The face of a press to a depth > 0 [mm]; `blur`: see `face`."""
        k = int(np.clip(np.searchsorted(self.depth, depth) - 1, 0, len(self.depth) - 2))
        w = float(np.clip((depth - self.depth[k]) / (self.depth[k + 1] - self.depth[k]), 0.0, 1.0))
        drop, slope = ((1 - w) * table[k] + w * table[k + 1] for table in (self.drop, self.slope))
        reach = np.sqrt(self.ball * depth)
        width = blur / reach  # in scaled radii
        points = 2 + int(POINTS_PER_BLUR_STD * DENT_RADII[-1] / width) if width else MAX_BLUR_POINTS
        fine = np.linspace(0, DENT_RADII[-1], min(MAX_BLUR_POINTS, points))
        radial = np.interp(fine, DENT_RADII, slope)
        if width > MIN_BLUR_SPACINGS * fine[1]:
            both = np.concatenate([-radial[:0:-1], radial])  # odd in the radius
            radial = gaussian_filter1d(both, width / fine[1])[len(fine) - 1 :]
        return DentProfile(reach * DENT_RADII, depth * drop, reach * fine, np.sqrt(depth / self.ball) * radial)


@dataclass(frozen=True)
class DentProfile:
    """Change of z [mm] and slope of the face by the distance from the centre of a press [mm]; 0 beyond the last."""

    drop_radii: Array
    drop: Array
    slope_radii: Array
    slope: Array

    def drop_at(self, r: Array) -> Array:
        """Change of z (k,) [mm] at distances r (k,) [mm]."""
        return np.asarray(np.interp(r, self.drop_radii, self.drop, right=0.0))

    def slope_at(self, r: Array) -> Array:
        """Radial slope (k,) at distances r (k,) [mm]."""
        return np.asarray(np.interp(r, self.slope_radii, self.slope, right=0.0))


def with_thickness(sensor: LitSensor, thickness: float) -> LitSensor:
    """The sensor with a gel of this total thickness [mm]: its layers change in proportion, and its lights stay where
    they are beside the plate."""
    factor = thickness / sensor.gel.thickness_mm
    layers = tuple(one.model_copy(update={"thickness_mm": one.thickness_mm * factor}) for one in sensor.gel.layers)
    gel, leds = sensor.gel.model_copy(update={"layers": layers}), []
    for led in sensor.leds:
        x, y, z = led.center_mm
        leds.append(led.model_copy(update={"center_mm": (x, y, z - (thickness - sensor.gel.thickness_mm))}))
    return sensor.model_copy(update={"gel": gel, "leds": tuple(leds)})


def solved(
    sensor: LitSensor, ball: float, at: tuple[float, float], widest: float, friction: float, quality: str
) -> Dents:
    """Presses of a ball of radius `ball` [mm] at (x, y) [mm], up to a contact radius of about `widest` [mm].

    They are kept in the cache. Raises UserError: the solver fails before the last two depths.
    """
    thick = sensor.gel.thickness_mm - sensor.gel.drop_mm(*at)
    by_width, by_ball = MAX_DENT_DEPTH_BY_WIDTH * widest**2 / ball, MAX_DEPTH_PER_BALL_RADIUS * ball
    largest = min(by_width, MAX_PRESS_DEPTH_RATIO * thick, by_ball)
    depths = np.geomspace(max(0.02 * largest, MIN_PRESS_DEPTH_RATIO * thick), largest, DENT_DEPTHS)
    scale, shape = _scaled_out(sensor.gel)
    key = array_cache.digest([DENT_TABLE_VERSION, shape, ball, at, depths, friction, quality, DENT_DEPTHS, DENT_RADII])
    found = array_cache.kept("dents", key, lambda: _solved(sensor, ball, at, depths, friction, quality, scale))
    depth, force, *rest = found
    return Dents(ball, sensor.gel.thickness_mm, depth, scale * force, *rest)


def _scaled_out(gel: Gel) -> tuple[float, str]:
    """The first modulus of a gel [MPa], to which its forces are proportional, and all else that they depend on."""
    scale = next(getattr(layer, key) for layer in gel.layers for key in moduli(layer))
    layers = [{**layer.model_dump(mode="json", exclude={"source"}),
               **{key: float(f"{getattr(layer, key) / scale:.6g}") for key in moduli(layer)}}
              for layer in gel.layers]  # fmt: skip
    return scale, f"{gel.model_dump_json(exclude={'layers', 'source'})} {layers}"


def _solved(
    sensor: LitSensor, ball: float, at: tuple[float, float], depths: Array, friction: float, quality: str, scale: float
) -> tuple[Array, ...]:
    """The arrays of Dents, with forces over `scale`."""
    aims = [{"depth_mm": float(depth)} for depth in depths]
    problem, states = solved_presses.solved_states(solved_presses.press_row(sensor, ball, at, aims, quality, friction))
    untouched, found = gel_surface.seen(problem.mesh, len(sensor.gel.clear_layers)), []
    try:
        for state, depth in zip(states, depths, strict=False):
            around = _profile(untouched.pressed(problem, state), Untouched.of(sensor.gel), at, ball, float(depth))
            found.append((mechanics.normal_force(state), *around, solved_presses.contact_radius(problem, state)))
            steps.go_on(f"{len(found)} of {DENT_DEPTHS} depths")
    except mechanics.NotConverged as error:
        if len(found) < DENT_DEPTHS - 2:
            raise UserError(
                f"a ball of {ball:g} mm pressed {depths[len(found)]:.3g} mm into a gel of"
                f" {sensor.gel.thickness_mm:.3g} mm: cannot be solved: {error}"
            ) from None
    force, drop, slope, contact = (np.array(part) for part in zip(*found, strict=True))
    return depths[: len(found)], force / scale, drop, slope, contact


def _profile(
    face: gel_surface.GelSurface, untouched: Untouched, at: tuple[float, float], ball: float, depth: float
) -> tuple[Array, Array]:
    """Scaled change of z and of the slope at DENT_RADII radii, averaged over the angle."""
    reach, angle = np.sqrt(ball * depth), 2 * np.pi * (np.arange(DENT_RAYS) + 0.5) / DENT_RAYS
    r = DENT_RADII * reach
    rest = np.array(at) + r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, high = face.rest[:, :2].min(axis=0), face.rest[:, :2].max(axis=0)
    inside = (np.abs(rest) < high).all(axis=2)
    now = face.at(np.clip(rest.reshape(-1, 2), low, high)).reshape(*rest.shape[:2], 3)
    z = now[..., 2] - untouched.at(now[..., :2].reshape(-1, 2))[:, 2].reshape(inside.shape)
    away = np.hypot(*np.moveaxis(now[..., :2] - at, 2, 0))
    lines = [np.interp(r, away[inside[:, k], k], z[inside[:, k], k], right=0.0) for k in range(DENT_RAYS)]
    seen = [r <= away[inside[:, k], k].max() for k in range(DENT_RAYS)]
    drop = np.sum(lines, axis=0) / np.maximum(np.sum(seen, axis=0), 1)
    slope = np.gradient(drop, r)
    return drop / depth, slope * np.sqrt(ball / depth)
