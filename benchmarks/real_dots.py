"""Markers against measured ones: dots of a real Mini, pressed by a ball, from where they were to where they are.

An end-to-end check of material, contact and camera. What nobody wrote down is fitted: first the depth of each press
alone, then also what the untouched picture and the hand add.
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
Moves = dict[str, dict[str, float]]
DEPTHS = np.r_[0.0, np.arange(0.25, 2.3, 0.25)]  # [mm]: untouched, and solved; between them motions are interpolated
FRICTION = 1.0  # assumed: a ball sticks to silicone; with less, it slides before the dots follow it
SIDEWAYS = 0.3  # [mm] by which the ball is slid; motions are taken as proportional to it
DARK, LEAST = 0.3, 25  # a dot is darker than its surroundings by this share, and has at least this area [px]
FARTHEST = 12.0  # longest motion of a dot [px], less than half of their distance
SHEET = 0.1  # distance of nodes of the face [mm]
ROUNDS = 6  # of fitting depths and the stretch of the untouched picture in turn
NOTE = (
    "A third unit with 9 x 7 dots, pressed by hand with a ball of 5 mm diameter; dots are found in the photographs"
    " as dark spots, in the untouched one too (the recorded untouched positions are those of the first press)."
    " Moved: how far off a gel that does not move would be. Depth: the only thing fitted in the column after it."
    " And a stretch: all presses show the untouched picture larger, by {:.1f} and {:.1f} px in 100 along x and y, at"
    " dots far from any ball too, so one affine map for all of them is fitted. And sideways: the hand also moves the"
    " ball along the face, two numbers a press. Friction {:g} is assumed."
)


@dataclass(frozen=True)
class Pressed:
    """A press: its dots untouched (n, 2) [px], their measured motion (n, 2), and computed ones (k, n, 2) at DEPTHS."""

    name: str
    rest: Array
    real: Array
    made: Array
    sideways: Sequence[Array] = ()  # motions (n, 2) for a ball slid by 1 mm along x and y

    def at(self, depth: float) -> Array:
        """Computed motion (n, 2) at a depth [mm]."""
        k = min(int(np.searchsorted(DEPTHS, depth, "right")) - 1, len(DEPTHS) - 2)
        part = (depth - DEPTHS[k]) / (DEPTHS[k + 1] - DEPTHS[k])
        return np.asarray((1 - part) * self.made[k] + part * self.made[k + 1])

    def fitted(self, stretch: Array, slid: bool = False) -> tuple[float, Array]:
        """Depth [mm] that suits best, and what is left (n, 2) [px] of the motion; `slid`: with the ball moved
        sideways too."""
        real = self.real - _affine(self.rest) @ stretch
        along = np.stack([motion.ravel() for motion in self.sideways], 1) if slid else np.zeros((real.size, 1))

        def left(depth: float) -> Array:
            off = (real - self.at(depth)).ravel()
            return np.asarray(off - along @ np.linalg.lstsq(along, off, rcond=None)[0]).reshape(real.shape)

        best = optimize.minimize_scalar(lambda d: rms(left(d)), bounds=(0.0, DEPTHS[-1]), method="bounded")
        return float(best.x), left(float(best.x))


def table(sensor: LitSensor, level: Level, say: Say) -> Table | None:
    """Of each press, the dots' motion and how far computed ones are from it; None without photographs."""
    folder = photographs.reference() / photographs.DOTTED
    if not (folder / "presses.csv").is_file():
        return None
    rest, presses = dots(read(folder / "background.png")), photographs.as_drawn(photographs.DOTTED, folder)
    every = [pressed(sensor, press, rest) for press in (presses[:1] if level == "smoke" else presses)]
    none, stretch, rows = np.zeros((3, 2)), stretched(every), list[list[Cell]]()
    for one in every:
        (depth, alone), (_, common), (last, slid) = one.fitted(none), one.fitted(stretch), one.fitted(stretch, True)
        rows.append([one.name, len(one.rest), rms(one.real), depth, *(rms(off) for off in (alone, common, slid)), last])
        say(f"{one.name}: {rms(alone):.2f} px of {rms(one.real):.2f}, at last {rms(slid):.2f}")
    means = [float(np.sqrt(np.mean([np.square(row[k]) for row in rows]))) for k in (2, 4, 5, 6)]  # type: ignore[arg-type]
    rows.append(["rms of all", None, means[0], None, *means[1:], None])
    heads = columns("press", "dots: d", "moved, rms [px]: .2f", "depth [mm]: .2f", "off, rms [px]: .2f",
                    "and a stretch [px]: .2f", "and sideways [px]: .2f", "last depth [mm]: .2f")  # fmt: skip
    return Table("Dots of a pressed Mini", heads, rows, NOTE.format(stretch[1, 0], stretch[2, 1], FRICTION))


def pressed(sensor: LitSensor, press: PhotographedPress, untouched: Array) -> Pressed:
    """Measured and computed motions of the dots (n, 2) [px] that are found again."""
    real = motion(untouched, dots(press.picture))
    seen = np.isfinite(real).all(1)
    rest, camera, sheet = untouched[seen], PinholeCamera.from_sensor(sensor), Sheet.over(sensor.gel, SHEET)
    places = np.array([press_faces.place(sensor, (x, y), 0.0) for x, y in rest])
    points = MaterialPoints(places, Untouched.of(sensor.gel), camera)

    def moved(depth: float, moves: list[Moves]) -> list[Array]:
        """Motion of the dots (n, 2) in each frame, from where the camera sees the ball on a face pressed by `depth`."""
        faces = _solved(sensor, press, depth, moves)
        return [np.asarray(points.at(DrawnFace(sheet, face, camera))[0] - points.undisturbed) for face in faces]

    made = moved(0.0, [{"press": {"depth_mm": float(d), "frames": 1}} for d in DEPTHS[1:]])
    one = Pressed(press.name, rest, real[seen], np.array([np.zeros(rest.shape), *made]))
    depth, slid = one.fitted(np.zeros((3, 2)))[0], []
    for way in ("x_mm", "y_mm"):
        slide = {"slide": {way: SIDEWAYS, "frames": 1}}
        before, after = moved(depth, [{"press": {"depth_mm": depth, "frames": 2}}, slide])[-2:]
        slid.append((after - before) / SIDEWAYS)
    return Pressed(one.name, one.rest, one.real, one.made, slid)


def stretched(every: Sequence[Pressed]) -> Array:
    """The affine map (3, 2), see _affine, of the untouched picture that suits all presses best."""
    stretch, at = np.zeros((3, 2)), np.concatenate([_affine(one.rest) for one in every])
    for _ in range(ROUNDS):
        off = [one.real - one.at(one.fitted(stretch)[0]) for one in every]
        stretch = np.asarray(np.linalg.lstsq(at, np.concatenate(off))[0])
    return stretch


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


def _affine(at: Array) -> Array:
    """1, x and y (n, 3), in hundreds of pixels."""
    return np.column_stack([np.ones(len(at)), at / 100])


def _solved(sensor: LitSensor, press: PhotographedPress, depth: float, moves: list[Moves]) -> Sequence[Surface]:
    """The face in each frame of moves from where the camera sees the ball on a face pressed by `depth` [mm]."""
    x, y = press_faces.place(sensor, press.center, depth)
    recipe = {
        "tacgen": 1, "name": "dots", "sensor": sensor.name, "outputs": ["force"], "start": {"x_mm": x, "y_mm": y},
        "indenter": {"shape": "sphere", "radius_mm": press.ball}, "contact": {"friction": FRICTION},
        "quality": "draft", "trajectory": moves,
    }  # fmt: skip
    (row,) = plan.expand(loading.checked(Recipe.model_validate(recipe), sensor)).rows
    return list(press_faces.faces(row))[1:]
