"""Calibration of a sensor file's LEDs to photographs of a unit, by least squares on the light transport."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from tacgen.base.errors import UserError
from tacgen.calibrate import glare_fit, photometric_fit, scattering_fit
from tacgen.calibrate import photos as reading
from tacgen.calibrate.cross_validation import Fitted
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.sensor_fit import Evidence, SensorFit, digits, lit_sensor
from tacgen.recipe import assets, loading
from tacgen.sensor.model import LitSensor
from tacgen.sensor.yaml_source import KeyPath

OPTICS_SOURCE = "by tacgen calibrate optics"
MIN_DETERMINED_SHARE = 0.5  # share from which a parameter counts as determined by the photographs
MAX_TOLERANCE_MM, MAX_TOLERANCE_DEG = 10.0, 90.0  # largest tolerances; farther off, the file is of another sensor


@dataclass(frozen=True)
class Calibrated(SensorFit):
    """A fit to photographs."""

    photographs: str
    untouched: np.ndarray  # photograph (H, W, 3), 8 bit
    fitted: Fitted

    @property
    def interrupted(self) -> str:
        """Note on what Ctrl-C has left out of the fit."""
        return self.fitted.interrupted

    def lines(self) -> Iterator[str]:
        """Report in text."""
        yield f"{self.sensor.name}: fitted to {self.photographs}"
        fitted = self.fitted
        if fitted.interrupted:
            yield fitted.interrupted
        yield f"untouched: off by {fitted.untouched:.1f} counts rms (before the fit: {fitted.before:.1f})"
        if fitted.presses is not None:
            yield f"change under the presses: off by {fitted.presses:.1f} counts rms"
        if fitted.drift:
            yield f"drift of the untouched picture, far from the presses, left out: {fitted.drift:.1f} counts rms"
        if (unseen := fitted.unseen) is None:
            if not fitted.interrupted:
                yield "not judged: fewer than two presses, so none can be left out of a fit"
        else:
            yield f"presses not seen by the fit: {unseen}: {'better' if unseen.better else 'NOT BETTER'}"
            for k, press in enumerate(unseen.presses):
                yield f"  {press.name}: {unseen.score(0, k)} before, {unseen.score(1, k)} after"
            for when, like in zip(("before", "after"), unseen.likeness or (), strict=False):
                yield f"  {when}: {like}"
        if fitted.deeper != 1:
            yield f"all depths appear to be {fitted.deeper:g} times the given ones"
        for led, now in zip(self.sensor.leds or (), fitted.sensor.leds, strict=True):
            before = sum(led.light)
            times = f"{sum(now.light) / before:.2f} times as strong" if before else "lit"
            moved = sum((a - b) ** 2 for a, b in zip(led.center_mm, now.center_mm, strict=True)) ** 0.5
            yield f"  {led.name}: {times}, moved {moved:.2f} mm, radiance {digits(now.radiance)}"
        sure = [name for name, share in fitted.determined.items() if share >= MIN_DETERMINED_SHARE]
        held = [name for name in fitted.determined if name not in sure]
        yield f"determined by the photographs: {', '.join(sure) or 'nothing'}"
        yield f"held at the file's values: {', '.join(held) or 'nothing'}"

    def plain(self) -> dict[str, Any]:
        """Report as JSON values."""
        fitted = self.fitted
        errors = {
            name: getattr(fitted, name) for name in ("untouched", "before", "presses", "drift", "deeper", "ridge")
        }
        unseen = None if fitted.unseen is None else fitted.unseen.plain()
        return {"sensor": self.sensor.name, **errors, "unseen": unseen, "determined": dict(fitted.determined),
                "changes": self.changed}  # fmt: skip

    def evidence(self) -> Evidence:
        """The judgement by unseen presses."""
        unseen = self.fitted.unseen
        if unseen is None and self.interrupted:
            return Evidence()
        if unseen is None:
            return Evidence(unseen="the fit is not judged: it takes two presses at least")
        return Evidence(
            unseen="" if unseen.better else f"the fit is not better on presses that it has not seen: {unseen}"
        )

    def draw(self, out: Path) -> None:
        """Write a figure of the unseen presses: photographed, rendered before and after the fit.

        Raises UserError: no press is unseen.
        """
        if self.fitted.unseen is None:
            raise UserError(f"--figure: {out}: {self.evidence().unseen}")
        self.fitted.unseen.draw(cast(LitSensor, self.sensor), self.untouched, out)


def optics(name: str, folder: Path, asked: FitLimits | None = None) -> Calibrated:
    """Fit the LEDs of a sensor file, given by name or path, to the photographs in a folder.

    Raises:
        UserError: photographs that are missing or cannot be used, a line each.
    """
    asked, path = asked or FitLimits(), assets.sensor_path(name)
    for unit, value, most in (("mm", asked.mm, MAX_TOLERANCE_MM), ("deg", asked.deg, MAX_TOLERANCE_DEG)):
        if not 0 <= value <= most:  # nor nan
            raise UserError(f"--tolerance-{unit}: must be from 0 to {most:g} (got {value:g})")
    return calibrated(path, reading.read(folder, lit_sensor(path)[0].camera), asked)


def calibrated(path: Path, photos: reading.Photos, asked: FitLimits) -> Calibrated:
    """The fit of the LEDs of a sensor file to photographs. Raises UserError: presses that cannot be solved."""
    sensor, tree = lit_sensor(path)
    folders = {("sensor", *loading.SOLID_FILE_KEY): loading.solid_folder(tree)} if sensor.gel.solid else {}
    scatters = any(layer.scattering for layer in sensor.gel.clear_layers)
    if scatters:
        fitted = scattering_fit.fit(sensor, photos, folders)
    else:
        fitted = photometric_fit.fit(sensor, photos, folders, asked)
    said = _said(photos)
    changes = changes_of(sensor, fitted, said, bare=asked.bare)
    if asked.bare or sensor.markers is None:  # dots would be in it
        left = glare_fit.glare(
            fitted.sensor if scatters else photometric_fit.at_scale(sensor, fitted.sensor), photos.untouched
        )
        changes["camera", "glare"] = left.model_dump(mode="json")
    return Calibrated(path, sensor, changes, said, photos.untouched, fitted)


def _said(photos: reading.Photos) -> str:
    count = len(photos.presses)
    presses = f" and {count} press{'es' * (count > 1)}" if count else ""
    return f"an untouched picture{presses} of one unit ({photos.folder.resolve().name})"


def changes_of(sensor: LitSensor, fitted: Fitted, said: str, *, bare: bool) -> dict[KeyPath, Any]:
    """Changed values of the sensor file by path; None for keys to remove."""
    now, by = fitted.sensor, f"fitted to {said} {OPTICS_SOURCE}"
    by += f"; on unseen presses {fitted.unseen}" if fitted.unseen else "; not judged by unseen presses"
    by += ", interrupted" if fitted.interrupted else ""
    out: dict[KeyPath, Any] = {}
    for k, (led, new) in enumerate(zip(sensor.leds, now.leds, strict=True)):
        out["leds", k, "radiance"] = digits(new.radiance)
        out["leds", k, "power"] = None
        if new.center_mm != led.center_mm:
            out["leds", k, "center_mm"] = [round(v, 3) for v in new.center_mm]
            out["leds", k, "normal"] = [round(v, 4) for v in new.normal]
            out["leds", k, "size_mm"] = [round(v, 2) for v in new.size_mm]
        out["leds", k, "source"] = by
    for part, keys in (("coating", ("specular", "roughness")), ("camera", ("ambient", "vignette_mm", "crop_mm"))):
        before, after = getattr(sensor, part), getattr(now, part)
        new_keys = [key for key in keys if getattr(after, key) != getattr(before, key)]
        out |= {(part, key): digits(getattr(after, key)) for key in new_keys}
        if new_keys:
            names = ", ".join(key.removesuffix("_mm") for key in new_keys)
            own = before.source
            if OPTICS_SOURCE in own:  # of an earlier fit
                own = own.split(f"; {new_keys[0].removesuffix('_mm')}")[0]
            out[part, "source"] = f"{own}; {names} {by}"
    if now.thickness_response is not None and now.thickness_response != sensor.thickness_response:
        table = now.thickness_response
        out["thickness_response",] = {
            "change_mm": digits(table.change_mm),
            "gain": [digits(row) for row in table.gain],
            "spread_mm": table.spread_mm,
            "source": f"{by}: what the unit shows beyond light transport, of unknown cause",
        }
    if bare and sensor.markers is not None:
        out["markers",] = None
    return out
