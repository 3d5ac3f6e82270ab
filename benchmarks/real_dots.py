"""Markers against measured ones: dots of a real Mini, pressed by a ball, from where they were to where they are.

An end-to-end check of material, contact and camera. The depth of each press, which nobody wrote down, is fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, optimize

from benchmarks import photographs
from benchmarks.results_page import Cell, Level, Say, Table, columns
from tacgen.calibrate import press_faces
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.material_flow import MaterialPoints
from tacgen.optics.surface_grid import Sheet, Surface, Untouched
from tacgen.recipe import loading, plan
from tacgen.recipe.background_photo import read
from tacgen.recipe.model import Recipe
from tacgen.sensor.model import LitSensor

Array = np.ndarray
DEPTHS = np.r_[0.0, np.arange(0.25, 2.3, 0.25)]  # [mm]: untouched, and solved; between them motions are interpolated
FRICTION = 1.0  # assumed: a ball sticks to silicone; with less, it slides before the dots follow it
DARK, LEAST = 0.3, 25  # a dot is darker than its surroundings by this share, and has at least this area [px]
FARTHEST = 12.0  # longest motion of a dot [px], less than half of their distance
SHEET = 0.1  # distance of nodes of the face [mm]
NOTE = (
    "A third unit with 9 x 7 dots, pressed by hand with a ball of 5 mm diameter; dots are found in the photographs"
    " as dark spots, in the untouched one too (the recorded untouched positions are those of the first press)."
    " Moved: how far off a gel that does not move would be. Depth: the only thing that is fitted, to this press."
    f" Friction {FRICTION:g} is assumed. Much of what is left is the hand's: with an affine map common to all presses"
    " and a sideways motion of each ball fitted too, .54 px are left in all (`benchmarks/real_dots.py` in commit"
    " f8101efd)."
)


@dataclass(frozen=True)
class Pressed:
    """A press: its dots untouched (n, 2) [px], their measured motion (n, 2), and computed ones (k, n, 2) at DEPTHS."""

    name: str
    rest: Array
    real: Array
    made: Array

    def at(self, depth: float) -> Array:
        """Computed motion (n, 2) at a depth [mm]."""
        k = min(int(np.searchsorted(DEPTHS, depth, "right")) - 1, len(DEPTHS) - 2)
        part = (depth - DEPTHS[k]) / (DEPTHS[k + 1] - DEPTHS[k])
        return np.asarray((1 - part) * self.made[k] + part * self.made[k + 1])

    def fitted(self) -> tuple[float, Array]:
        """Depth [mm] that suits best, and what is left (n, 2) [px] of the motion."""
        best = optimize.minimize_scalar(
            lambda d: rms(self.real - self.at(d)), bounds=(0.0, DEPTHS[-1]), method="bounded"
        )
        return float(best.x), self.real - self.at(float(best.x))


def table(sensor: LitSensor, level: Level, say: Say) -> Table | None:
    """The dots' motion in each press and how far computed ones are from it; None without photographs."""
    folder = photographs.reference() / photographs.DOTTED
    if not (folder / "presses.csv").is_file():
        return None
    rest, presses = dots(read(folder / "background.png")), photographs.as_drawn(photographs.DOTTED, folder)
    rows: list[list[Cell]] = []
    for press in presses[:1] if level == "smoke" else presses:
        one = pressed(sensor, press, rest)
        depth, left = one.fitted()
        rows.append([one.name, len(one.rest), rms(one.real), depth, rms(left)])
        say(f"{one.name}: {rms(left):.2f} px of {rms(one.real):.2f}")
    moved, off = (float(np.sqrt(np.mean([np.square(row[k]) for row in rows]))) for k in (2, 4))  # type: ignore[arg-type]
    rows.append(["rms of all", None, moved, None, off])
    heads = columns("press", "dots: d", "moved, rms [px]: .2f", "depth [mm]: .2f", "off, rms [px]: .2f")
    return Table("Dots of a pressed Mini", heads, rows, NOTE)


def pressed(sensor: LitSensor, press: PhotographedPress, untouched: Array) -> Pressed:
    """Measured and computed motions of the dots (n, 2) [px] that are found again."""
    real = motion(untouched, dots(press.picture))
    seen = np.isfinite(real).all(1)
    rest, camera, sheet = untouched[seen], PinholeCamera.from_sensor(sensor), Sheet.over(sensor.gel, SHEET)
    places = np.array([press_faces.place(sensor, (x, y), 0.0) for x, y in rest])
    points = MaterialPoints(places, Untouched.of(sensor.gel), camera)
    faces = solved(sensor, press)
    made = [np.asarray(points.at(DrawnFace(sheet, face, camera))[0] - points.undisturbed) for face in faces]
    return Pressed(press.name, rest, real[seen], np.array([np.zeros(rest.shape), *made]))


def dots(picture: Array) -> Array:
    """Centres (n, 2) [px] of the dark spots of a picture (h, w, 3)."""
    weight = np.clip(photographs.darker(picture) - DARK, 0, None)
    label, count = ndimage.label(weight > 0)
    which = range(1, count + 1)
    center = np.array(ndimage.center_of_mass(weight, label, which)).reshape(-1, 2)[:, ::-1] + 0.5
    return np.asarray(center[ndimage.sum(weight > 0, label, which) >= LEAST])


def motion(before: Array, after: Array) -> Array:
    """Motion (n, 2) [px] of dots (n, 2) to the nearest of others (m, 2); nan where that is too far."""
    away = np.linalg.norm(before[:, None] - after, axis=2)
    found = after[away.argmin(1)] - before
    found[away.min(1) > FARTHEST] = np.nan
    return np.asarray(found)


def rms(motions: Array) -> float:
    """Root of the mean square length of motions (n, 2)."""
    return float(np.sqrt((motions**2).sum(axis=1).mean()))


def solved(sensor: LitSensor, press: PhotographedPress) -> Sequence[Surface]:
    """The face under the ball, from where the camera sees it, at DEPTHS but the first."""
    x, y = press_faces.place(sensor, press.center, 0.0)
    recipe = {
        "tacgen": 1, "name": "dots", "sensor": sensor.name, "outputs": ["force"], "start": {"x_mm": x, "y_mm": y},
        "indenter": {"shape": "sphere", "radius_mm": press.ball}, "contact": {"friction": FRICTION},
        "quality": "draft", "trajectory": [{"press": {"depth_mm": float(d), "frames": 1}} for d in DEPTHS[1:]],
    }  # fmt: skip
    (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
    return list(press_faces.faces(row))[1:]
