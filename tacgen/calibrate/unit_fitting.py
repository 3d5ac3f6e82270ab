"""The steps of the calibration of a unit: solved presses, the fit, its judgement by unseen presses, and the lights."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tacgen.calibrate import ball_dents, fit_clear, fit_unit, unit_bias, unseen
from tacgen.calibrate.ball_dents import Dents, with_thickness
from tacgen.calibrate.fit_unit import Gauge, Judged, UnitFit
from tacgen.calibrate.photos import TABLE, PhotographedPress, Photos
from tacgen.calibrate.press_colours import PressPicture, PressView
from tacgen.calibrate.result import Fitted
from tacgen.calibrate.unit import DEEP, Asked
from tacgen.calibrate.unit_bias import DentFace
from tacgen.calibrate.unit_photos import UnitPhotos
from tacgen.errors import UserError
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.surface_grid import Untouched
from tacgen.sensor.model import LitSensor

WIDER, GRADE = 1.2, 1.25  # contact radius that is solved, over the largest rough one; and its steps
SHOWN = 6  # presses to which lights are fitted
DEEPER = 0.4  # of the deepest press: least depth of those


@dataclass(frozen=True)
class Work:
    """All that the steps share."""

    sensor: LitSensor
    photos: UnitPhotos
    asked: Asked
    view: PressView
    pictures: tuple[PressPicture, ...]
    gauge: Gauge
    dents: tuple[Mapping[float, Dents], ...]  # by tried thickness, then by the ball's radius

    @classmethod
    def of(cls, sensor: LitSensor, photos: UnitPhotos, asked: Asked) -> "Work":
        """Solve presses of each ball at each tried thickness; minutes, unless they are in the cache.

        Raises UserError: presses that cannot be solved.
        """
        view, number = PressView(sensor), {name: k for k, name in enumerate(photos.recordings)}
        pictures = tuple(view.picture(p.picture, p.untouched, p.ball, number[p.recording]) for p in photos.presses)
        gauge = Gauge(*(np.array(part) for part in zip(
            *((p.force, number[p.recording], p.time) for p in photos.presses), strict=True)))  # fmt: skip
        rough = view.starts(pictures)
        step = sensor.gel.thickness_mm / 2  # rounded, so that other presses of the unit find them in the cache
        x, y = (float(step * np.round(v / step)) for v in np.median(rough[:, 1:], axis=0))
        tried = fit_unit.FACTORS if asked.thickness else (1.0,)
        dents = []
        for factor in tried:
            one = with_thickness(sensor, factor * sensor.gel.thickness_mm)
            each = {}
            for ball in sorted({picture.ball for picture in pictures}):
                here = [k for k, picture in enumerate(pictures) if picture.ball == ball]
                widest = np.log(WIDER * np.sqrt(1.6 * ball * rough[here, 0].max())) / np.log(GRADE)
                most = round(float(GRADE ** np.ceil(widest)), 3)
                each[ball] = ball_dents.solved(one, ball, (x, y), most, asked.friction, asked.quality)
            dents.append(each)
        return cls(sensor, photos, asked, view, pictures, gauge, tuple(dents))

    def fitted(self) -> UnitFit:
        """The fit to all presses. Raises UserError: too few presses."""
        try:
            return fit_unit.fit(
                fit_unit.optics(self.view, self.pictures, self.dents), self.pictures, self.dents, self.gauge
            )
        except ValueError as error:
            raise UserError(f"{self.photos.folder / TABLE}: {error}") from None

    def too_deep(self, found: UnitFit) -> Iterator[str]:
        """A line on each press that is deeper than what is solved."""
        k = found.optics.between(found.optics.best)[0]
        for press, picture, depth in zip(self.photos.presses, self.pictures, found.depth, strict=True):
            if depth > DEEP * (deepest := self.dents[k][picture.ball].depth[-1]):
                yield (f"{self.photos.folder / press.name}: is pressed deeper than {deepest:.3g} mm, the most that a"
                       f" gel of {found.thickness.value:.3g} mm is solved for: leave it out")  # fmt: skip

    def corrected(self, found: UnitFit) -> UnitFit:
        """The fit less the error that the method makes on rendered pictures of the same presses."""
        return unit_bias.corrected(found, self.at_thickness(found), self.view, self.pictures, self.dents, self.gauge)

    def judged(self) -> tuple[Judged, ...]:
        """Judgements by recordings that a fit has not seen, or by presses if there is one recording alone."""
        names = self.photos.recordings
        group = self.gauge.recording if len(names) > 1 else np.arange(len(self.pictures))
        out = []
        for held in unseen.folds(int(group.max()) + 1):
            where = np.isin(group + 1, held)
            name = (
                ", ".join(names[k - 1] for k in held)
                if len(held) == 1 and len(names) > 1
                else f"{where.sum()} held out"
            )
            try:
                _, found = fit_unit.judge(self.view, self.pictures, self.dents, self.gauge, where)
            except ValueError:
                continue  # the others are too few
            out.append(replace(found, name=name))
        return tuple(out)

    def at_thickness(self, fitted: UnitFit) -> LitSensor:
        """The sensor with the fitted thickness."""
        return with_thickness(self.sensor, fitted.thickness.value) if self.asked.thickness else self.sensor

    def lights(self, fitted: UnitFit) -> Fitted:
        """The lights of the sensor with the fitted thickness, fitted to how some of the presses at their found depths
        change the picture: the untouched one, with its glare, can be the background of rendered pictures."""
        sensor, some, first = self.at_thickness(fitted), self._some(fitted), self.photos.presses[0].untouched
        photos = Photos(self.photos.folder, first, self._shown(fitted, some))
        k, w = fitted.optics.between(fitted.optics.best)
        faces = []
        for n in some:
            both = [self.dents[j][self.pictures[n].ball] for j in (k, min(k + 1, len(self.dents) - 1))]
            at = float(fitted.depth[n]), *(float(v) for v in fitted.optics.placed[k].at[n, 1:])
            faces.append(DentFace(Untouched.of(sensor.gel), (both[0], both[1]), w, (at[0], at[1], at[2]), 0.0))
        return fit_clear.fit_faces(sensor, photos, faces, self.asked.limits, changes=True)

    @staticmethod
    def _some(fitted: UnitFit) -> list[int]:
        """Numbers of presses of different depths."""
        deep = [k for k in np.argsort(fitted.depth) if fitted.depth[k] > DEEPER * fitted.depth.max()]
        return [int(deep[round(k)]) for k in np.linspace(0, len(deep) - 1, min(SHOWN, len(deep)))]

    def _shown(self, fitted: UnitFit, some: list[int]) -> tuple[PhotographedPress, ...]:
        """Some presses, shown as changes of the first untouched picture."""
        best, camera = fitted.optics.between(fitted.optics.best)[0], PinholeCamera.from_sensor(self.sensor)
        first, out = self.photos.presses[0].untouched, []
        for k in some:
            press, (_, x, y), depth = self.photos.presses[k], fitted.optics.placed[best].at[k], float(fitted.depth[k])
            center = camera.project([[x, y, -depth]])[0]
            contact = self.dents[best][press.ball].contact_at(depth) / camera.mm_per_px
            shown = np.clip(first + (press.picture.astype(float) - press.untouched), 0, 255).astype(np.uint8)
            at, ball = (float(center[0]), float(center[1])), press.ball
            out.append(PhotographedPress(press.name, shown, ball, at, contact, depth, aspect=camera.aspect))
        return tuple(out)
