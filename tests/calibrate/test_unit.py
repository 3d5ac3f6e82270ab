"""Thickness, modulus, zero and lag from presses with forces: found where they are known, or said to be open."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from helpers.photographed import calibrate, refused, save, table, written
from helpers.tiny import sensor

from tacgen.calibrate import contrast_fit, dent_tables, indentation_fit, press_localisation
from tacgen.calibrate import unit as calibration
from tacgen.calibrate.dent_tables import DENT_RADII, Dents, with_thickness
from tacgen.calibrate.indentation_fit import Gauge, GaugedPresses
from tacgen.calibrate.material_fit import Estimate
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.press_localisation import LocatedPresses, PressPicture, PressView
from tacgen.recipe import loading
from tacgen.render.images import Renderer
from tacgen.sensor.model import LitSensor

BALL, MODULUS, ZERO = 4.0, 1.4, 0.3  # [mm], times the file's, [N]
WIDE, WIDEST = 12.0, 60.0  # balls wider than the picture, and with contacts that cover it [mm]
FINE = {"mm_per_px": 0.1, "width_px": 96, "height_px": 80, "noise": None}
DEPTHS = np.array([0.15, 0.3, 0.45, 0.6, 0.75, 0.9])
PLACES = ((0.0, 0.0), (0.8, -0.5), (-0.7, 0.6), (0.4, 0.5), (-0.5, -0.4), (0.2, 0.0))


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few pixels and few thicknesses."""
    monkeypatch.setattr(press_localisation, "COMPARED_PIXELS", 300)
    monkeypatch.setattr(indentation_fit, "THICKNESS_FACTORS", (0.7, 0.85, 1.0, 1.2, 1.44))


@pytest.fixture(scope="module")
def unit() -> LitSensor:
    """The file's; its gel is 3 mm thick."""
    return cast(LitSensor, sensor(camera=FINE, markers=None))


def formula(one: LitSensor, ball: float, at: Any = None, widest: float = 0.0, *_: Any, deepest: float = 1.6) -> Dents:
    """Presses by a formula whose face and force depend on the thickness as those of solved ones do: the face falls
    steeper and bulges more around the contact of a thin gel."""
    thick, depth = one.gel.thickness_mm, np.geomspace(0.02, deepest, 9)
    inside, slope = 1.2, np.zeros((9, len(DENT_RADII)))
    for k, d in enumerate(depth):
        away = (DENT_RADII - inside) * np.sqrt(ball * d) / thick
        beyond = inside * np.exp(-6 * away) - 1.5 * np.sqrt(ball * d) / thick * away * np.exp(-3 * away)
        slope[k] = np.where(inside > DENT_RADII, DENT_RADII, beyond)
    steps = (slope[:, 1:] + slope[:, :-1]) / 2 * np.diff(DENT_RADII)
    drop = -np.cumsum(np.pad(steps, ((0, 0), (0, 1)))[:, ::-1], axis=1)[:, ::-1]
    modulus = one.gel.layers[0].model_dump()["youngs_modulus_mpa"]
    force = 20 * modulus * np.sqrt(ball) * depth**1.5 * (1 + 2 * ball * depth / thick**2)
    return Dents(ball, thick, depth, force, drop, slope, inside * np.sqrt(ball * depth))


def painted(one: LitSensor, thick: float, presses: list[tuple[float, float, float]]) -> list[np.ndarray]:
    """Changes of pictures (H, W, 3) [counts] with colours that no press tells."""
    with pytest.MonkeyPatch.context() as patch:  # all pixels
        patch.setattr(press_localisation, "COMPARED_PIXELS", 1e9)
        patch.setattr(press_localisation, "OMITTED_RIM_SHARE", 0.0)
        view = PressView(one)
    colours = np.random.default_rng(1).uniform(-60, 60, (12, 3))
    colours[:2], colours[2:5], colours[-4:] = [[90, -20, 30], [10, 80, -70]], colours[2:5] / 4, 0.0
    dents = formula(with_thickness(one, thick), BALL)
    shape = one.camera.height_px, one.camera.width_px, 3
    return [(view.columns(dents, np.array(at), 0.0, False) @ colours).reshape(shape) for at in presses]


def presses(depths: np.ndarray = DEPTHS) -> list[tuple[float, float, float]]:
    return [(float(d), *PLACES[k % len(PLACES)]) for k, d in enumerate(depths)]


def fitted(one: LitSensor, thick: float, gauge: Gauge | None = None, depths: np.ndarray = DEPTHS, seed: int = 0):
    """The fit to pictures with noise of presses of a gel."""
    random, view = np.random.default_rng(seed), PressView(one)
    changes = [c + random.normal(0, 1.5, c.shape) for c in painted(one, thick, presses(depths))]
    groups = range(len(depths)) if gauge is None else gauge.recording
    pictures = [view.picture(c, 0.0 * c, BALL, int(g)) for c, g in zip(changes, groups, strict=True)]
    thicknesses = [factor * one.gel.thickness_mm for factor in indentation_fit.THICKNESS_FACTORS]
    dents = [{BALL: formula(with_thickness(one, tried), BALL)} for tried in thicknesses]
    if gauge is None:
        true = ZERO + MODULUS * formula(with_thickness(one, thick), BALL).force_at(depths)
        read = true + random.normal(0, 0.01 * true.max(), len(true))
        gauge = Gauge(read, np.arange(len(depths)), np.full(len(depths), np.nan))
    seen = GaugedPresses(view, pictures, gauge, dents)
    return indentation_fit.fit(indentation_fit.thickness_scan(seen, rich=False), seen)


@pytest.mark.parametrize(("thick", "ball"), [(2.4, BALL), pytest.param(3.7, BALL, marks=pytest.mark.slow), (2.4, WIDE)])
def test_thickness_modulus_and_zero_of_a_known_gel_are_within_their_intervals(
    unit: LitSensor, thick: float, ball: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"{__name__}.BALL", ball)
    found = fitted(unit, thick)
    assert found.thickness.value == pytest.approx(thick, rel=0.08)
    assert found.modulus.value == pytest.approx(MODULUS, rel=0.12)
    for one, true in ((found.thickness, thick), (found.modulus, MODULUS), (found.zero, ZERO)):
        assert one.low < true < one.high
        assert not one.open
    assert found.depth == pytest.approx(DEPTHS, abs=0.03)
    assert found.scan.explained > 0.9


@pytest.mark.slow
def test_rims_softer_than_any_blur_that_is_tried_leave_the_thickness_unsure(
    unit: LitSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A softer rim and a thinner gel replace each other."""
    sharp = fitted(unit, 2.4).thickness
    monkeypatch.setattr(press_localisation, "MAX_SLOPE_BLUR", 0.5 * press_localisation.SLOPE_BLUR_TOL)
    soft = fitted(unit, 2.4).thickness
    assert soft.low < 2.4 < soft.high
    assert np.log(soft.high / soft.low) > 3 * np.log(sharp.high / sharp.low)


@pytest.mark.slow
def test_the_lag_of_a_gauge_is_found_and_does_not_shift_the_modulus(unit: LitSensor) -> None:
    up = np.concatenate([np.linspace(0.1, 0.9, 7), [0.9] * 3, np.linspace(0.8, 0.1, 6)])
    time, lag = np.arange(len(up)) / 30, 0.05
    true = ZERO + MODULUS * formula(unit, BALL).force_at(up)
    gauge = Gauge(np.interp(time - lag, time, true), np.zeros(len(up), int), time)
    found = fitted(unit, 3.0, gauge, up)
    assert found.lags[0].value == pytest.approx(lag, abs=0.01)
    assert found.modulus.value == pytest.approx(MODULUS, rel=0.15)
    early = np.abs(gauge.lagged(true, {}) - gauge.force).mean()
    assert np.abs(gauge.lagged(true, {0: lag}) - gauge.force).mean() < 1e-9 < early


@pytest.mark.slow
def test_a_recording_with_another_contrast_tells_it_by_its_own_pictures(unit: LitSensor) -> None:
    view, thick, random = PressView(unit), 3.0, np.random.default_rng(0)
    dents = [{BALL: formula(with_thickness(unit, f * 3.0), BALL)} for f in indentation_fit.THICKNESS_FACTORS[1:4]]
    depths = np.tile(np.linspace(0.2, 0.9, 8), 2)
    force = MODULUS * formula(with_thickness(unit, thick), BALL).force_at(depths)
    second = np.arange(16) >= 8
    changes = painted(unit, thick, presses(depths))
    pictures = [view.picture((0.9 if late else 1.0) * c + random.normal(0, 1.5, c.shape), 0 * c, BALL, int(late))
                for c, late in zip(changes, second, strict=True)]  # fmt: skip
    gauge = Gauge(force, second.astype(int), np.full(16, np.nan))
    found = indentation_fit.held_out_forces(GaugedPresses(view, pictures, gauge, dents), second)
    assert found.mae(found.predicted) < 0.5 * found.mae(found.foreign)
    assert found.mae(found.predicted) < 0.05 * force.max()


def test_a_face_is_that_of_its_depth_and_blur_softens_its_rim_alone(unit: LitSensor) -> None:
    dents, r = formula(unit, BALL), np.linspace(0, 4, 400)
    drop, slope = dents.face(0.6, r)
    assert drop[0] < drop[200] < 0.02
    assert slope[50] == pytest.approx(r[50] / BALL, rel=0.01)
    assert np.gradient(drop, r)[50:150:20] == pytest.approx(slope[50:150:20], abs=0.02)
    soft = dents.face(0.6, r, 0.3)[1]
    assert soft.max() < 0.95 * slope.max()
    assert soft[40] == pytest.approx(slope[40], rel=0.05)
    assert dents.face(0.0, r) == (pytest.approx(0.0), pytest.approx(0.0))


def photographed(one: LitSensor, folder: Path, depths: np.ndarray = DEPTHS) -> tuple[Path, Path]:
    """A sensor file, and a folder of pictures of a gel of 3.5 mm with forces."""
    folder.mkdir(exist_ok=True)
    shape = one.camera.height_px, one.camera.width_px, 3
    save(np.full(shape, 120), folder / "background.png")
    random, rows = np.random.default_rng(0), []
    forces = ZERO + MODULUS * formula(with_thickness(one, 3.5), BALL).force_at(depths)
    for k, (change, force) in enumerate(zip(painted(one, 3.5, presses(depths)), forces, strict=True)):
        save(120 + change + random.normal(0, 1.5, shape), folder / f"{k}.png")
        rows.append((f"{k}.png", f"{BALL:g}", f"{force + random.normal(0, 0.05):.3f}"))
    table(folder, ("file", "ball_radius_mm", "force_n"), rows)
    return written(one, folder.parent / "sensor.yaml"), folder


def called(file: Path, folder: Path, *more: object) -> Any:
    return calibrate("unit", "--sensor", file, "--images", folder, "--no-lights", *more)


@pytest.mark.slow
def test_the_command_writes_a_sensor_file_with_what_was_found_and_unseen_forces(
    unit: LitSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dent_tables, "solved", formula)
    mine = tmp_path / "mine.yaml"
    done = called(*photographed(unit, tmp_path / "images"), "-o", mine, "--plot", tmp_path / "fit.png")
    assert done.exit_code == 0, done.output
    assert "presses not seen by the fit (2 held out): off by" in done.stdout
    assert "mean of the seen forces:" in done.stdout
    text, made = mine.read_text(), loading.read_sensor(mine)[0]
    assert text.startswith("# Fitted by tacgen calibrate unit to 6 presses of balls of radius 4 mm")
    assert "#   thickness: " in text
    assert "# a unit of ours" in text
    assert made.gel.thickness_mm == pytest.approx(3.5, rel=0.15)
    assert made.gel.layers[0].model_dump()["youngs_modulus_mpa"] == pytest.approx(0.3 * MODULUS, rel=0.3)
    assert "with 95 %), fitted to 6 presses" in made.gel.layers[0].source
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_contacts_over_the_picture_are_refused(
    unit: LitSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slopes inside are the ball's at any depth."""
    monkeypatch.setattr(dent_tables, "solved", formula)
    monkeypatch.setattr(f"{__name__}.BALL", WIDEST)
    done = called(*photographed(unit, tmp_path / "images"), "--keep-thickness")
    assert done.exit_code == 2
    assert "5.png: its contact, " in done.stderr
    assert "0.png: its contact" not in done.stderr


def test_the_colours_of_a_unit_are_found_without_forces() -> None:
    unit = cast(LitSensor, sensor(camera={**FINE, "response": "linear", "ambient": [0.2, 0.2, 0.2]}, markers=None))
    at, true = np.array(presses()), np.array([1.2, 1.0, 0.7])
    seen = LocatedPresses(at, np.zeros(0), 0.1, np.ones((len(at), 1)), 1.0)
    scan = indentation_fit.ThicknessScan(np.array([3.0]), (seen,), False, float(np.log(3.0)), 0.0, 1)
    none = Estimate("none", 1.0, 1.0, 1.0)
    found = indentation_fit.IndentationFit(scan, none, none, none, {}, np.ones(len(at)), at[:, 0])
    gauge = Gauge(np.ones(len(at)), np.zeros(len(at), int), np.full(len(at), np.nan))
    blank = PressPicture(np.zeros((1, 3)), BALL, 0, 0.0)
    known = GaugedPresses(PressView(unit), [blank] * len(at), gauge, [{BALL: formula(unit, BALL)}])
    camera = Renderer(contrast_fit.scaled(unit, true), 1, 0, markers=False)
    shown = [camera.develop(camera.image(found.face(camera.untouched, known, k))) for k in range(len(at))]
    flat = camera.develop(camera.flat())
    real = replace(known, pictures=[known.view.picture(one, flat, BALL, 0) for one in shown])
    assert contrast_fit.ContrastByColour(unit, found, real).over(np.ones(len(at), bool)) == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.replace("force_n", "newtons"), "presses.csv: has no column force_n"),
        (lambda t: t.replace("0.png,4,", "0.png,4e3,"), ":2: ball_radius_mm: must be a number from 0.1 to 100"),
        (lambda t: t.replace("1.png,4,", "1.png,4,x"), ":3: force_n: must be a number from -1e+06 to 1e+06"),
        (lambda t: t.replace("2.png", "gone.png"), "gone.png: cannot be read"),
        (lambda t: "\n".join(t.splitlines()[:4]), "3 of its pictures show a press, and a fit takes 4 at least"),
        (lambda t: "\n".join(t.splitlines()[:1] + [line.rsplit(",", 1)[0] + ",2" for line in t.splitlines()[1:]]),
         "force_n: all forces are alike: press lightly and hard"),
        (lambda t: t.replace("4,", "7,", 1).replace("4,", "8,", 1).replace("4,", "9,", 1).replace("4,", "10,", 1)
         .replace("4,", "11,", 1), "has 6 sizes, and 5 are the most"),
    ],
)  # fmt: skip
def test_an_unusable_table_is_told_in_one_line(unit: LitSensor, tmp_path: Path, change: Any, says: str) -> None:
    file, folder = photographed(unit, tmp_path / "images")
    (folder / "presses.csv").write_text(change((folder / "presses.csv").read_text()))
    refused(called(file, folder), says)


@pytest.mark.slow
def test_a_thickness_that_the_pictures_leave_open_is_said_and_nothing_written(
    unit: LitSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sector of the pictures tells another thickness."""
    monkeypatch.setattr(dent_tables, "solved", formula)
    monkeypatch.setattr(
        indentation_fit,
        "_lowest",
        lambda thickness, misfit: float(np.log(3.0) + 0.4 * np.sign(np.sin(1e6 * misfit.sum()))),
    )
    mine = tmp_path / "mine.yaml"
    done = called(*photographed(unit, tmp_path / "images"), "-o", mine)
    refused(done, "thickness: is not determined within 2.1 to 4.32 mm by these presses: press until")
    assert not mine.exists()


@pytest.mark.slow
def test_lights_no_better_on_unseen_presses_stay(
    unit: LitSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The colours of these pictures are a polynomial's, which no LED gives."""
    monkeypatch.setattr(dent_tables, "solved", formula)
    file, folder = photographed(unit, tmp_path / "images")
    asked = calibration.Asked(limits=FitLimits(0.0, 0.0, bare=True, steps=1))
    made = calibration.unit(str(file), folder, asked)
    assert made.lights is not None
    changed = {key[0] for key in made.changes if key[-1] == "radiance"}
    assert changed == ({"leds"} if made.lit else set())
    assert any("the file's lights are kept" in line for line in made.lines()) is not made.lit
