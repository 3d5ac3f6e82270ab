"""Fit of a sensor with a clear gel, with the ridge that suits unseen presses best, and the judgement by those."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacgen.calibrate import contact_circle, press_faces
from tacgen.calibrate.clear_fits import RIDGES, Fits
from tacgen.calibrate.clear_trials import Tolerance
from tacgen.calibrate.likeness import Comparison, Likeness
from tacgen.calibrate.photos import Photos
from tacgen.calibrate.result import Fitted
from tacgen.calibrate.unseen import Unseen, folds
from tacgen.optics.surface_grid import Surface
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath

if TYPE_CHECKING:
    from tacgen.calibrate.led_fit import FitLimits

LIGHTLY = 0.1  # weight of a pixel of the untouched picture where changes are what matters


def fit(sensor: LitSensor, photos: Photos, folders: dict[KeyPath, Path], asked: "FitLimits") -> Fitted:
    """Fit the radiance and, with presses, the other parameters, with the ridge that suits unseen presses best."""
    press_faces.check(sensor, photos)
    if sensor.gel.dome is None:  # on a dome the rim is hidden by the change of shadows
        refined = tuple(contact_circle.refined(press, photos.untouched) for press in photos.presses)
        photos = replace(photos, presses=refined)
    return fit_faces(sensor, photos, [press_faces.face(sensor, press, folders) for press in photos.presses], asked)


def fit_faces(
    sensor: LitSensor, photos: Photos, faces: Sequence[Surface], asked: "FitLimits", *, changes: bool = False
) -> Fitted:
    """Fit a sensor with a clear gel to presses whose faces are known.

    `changes`: how presses change the picture is fitted and judged alone; the untouched picture counts LIGHTLY.
    """
    tolerance = Tolerance(asked.mm, float(np.radians(asked.deg)) if asked.mm else 0.0)
    trial = Fits(sensor, photos, faces, tolerance, asked.bare, LIGHTLY if changes else 1.0)
    if not (groups := folds(len(photos.presses))):
        return trial.whole(RIDGES[-1], asked.steps)
    counts, made = trial.judged(groups, asked.steps)
    best = int(np.argmin(counts[1:].mean(axis=1)))
    held_out = [k - 1 for group in groups for k in group]
    presses, seen = [photos.presses[k] for k in held_out], [faces[k] for k in held_out]
    fits = [_at_scale(sensor, one) for one in made[best]]
    alike: tuple[Likeness, Likeness] | None = None
    if not changes and all(press.contact is not None for press in presses):
        after, done = [], 0
        for group, one in zip(groups, fits, strict=True):
            part = slice(done, done := done + len(group))
            after.append(Comparison(one).likeness(presses[part], seen[part], photos.untouched))
        alike = Comparison(sensor).likeness(presses, seen, photos.untouched), Likeness.over(after)
    each = tuple(one for group, one in zip(groups, fits, strict=True) for _ in group)
    unseen = Unseen(tuple(presses), tuple(seen), each, counts[[0, best + 1]], alike)
    return replace(trial.whole(RIDGES[best], asked.steps), unseen=unseen)


def _at_scale(sensor: LitSensor, fitted: LitSensor) -> LitSensor:
    """A sensor with the lights, the coating and the camera's fitted values of one at the fit's scale."""
    light = {key: getattr(fitted.camera, key) for key in ("ambient", "vignette_mm", "crop_mm")}
    eye = sensor.camera.model_copy(update=light)
    return sensor.model_copy(update={"leds": fitted.leds, "coating": fitted.coating, "camera": eye})
