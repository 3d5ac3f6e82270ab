"""Calibration by photographs: a unit that is known is found again; what cannot be used is told in one line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.photographed import (
    CIRCLE_COLUMNS,
    FINE,
    PRESSES,
    calibrate,
    grey,
    photographed,
    refused,
    save,
    table,
    written,
)
from helpers.tiny import PLAIN, cloudy, sensor
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.calibrate import optics, photos, solved_presses
from tacgen.calibrate.photometric_model import LED_PARAMETERS, FitLimits, PhotometricModel
from tacgen.calibrate.render_comparison import Likeness
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.scattering import gain as response_of
from tacgen.recipe import assets, loading
from tacgen.render import images
from tacgen.render.mitsuba_variants import SCALAR_VARIANT
from tacgen.sensor.model import Sensor


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(sensor(camera=FINE, markers=None), tmp_path_factory.mktemp("sensor") / "nominal.yaml")


@pytest.fixture
def no_normals(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that do not look at the error of normals, whose rendered dents take most of the time."""

    class Alike:
        def __init__(self, sensor: Sensor) -> None: ...

        def likeness(self, presses: Any, faces: Any, untouched: Any) -> Likeness:
            one = np.ones(3)
            return Likeness(one, one, one, 1.0, 1.0, 1.0, np.ones(len(presses)))

    monkeypatch.setattr("tacgen.calibrate.photometric_fit.Comparison", Alike)


@pytest.mark.slow
@pytest.mark.usefixtures("no_normals")
def test_powers_colours_and_stray_light_of_a_known_unit_are_found(nominal: Path, tmp_path: Path) -> None:
    true = ([11.0, 0.5, 0.0], [0.0, 7.0, 1.0], [0.3, 0.0, 9.9])
    leds = [{**led, "radiance": light} for led, light in zip(PLAIN["leds"], true, strict=True)]
    unit = sensor(leds=leds, camera={**FINE, "ambient": [0.01, 0.02, 0.03]}, markers=None)
    folder, mine = photographed(unit, tmp_path / "unit"), tmp_path / "mine.yaml"
    still = "--tolerance-mm", 0, "--tolerance-deg", 0
    done = calibrate("optics", "--sensor", nominal, "--images", folder, *still, "--anyway", "-o", mine)
    assert done.exit_code == 0, done.output
    assert "presses not seen by the fit: " in done.stdout
    made, _ = loading.read_sensor(mine)
    for led, light in zip(made.leds, true, strict=True):
        assert led.radiance == pytest.approx(light, rel=0.03, abs=0.1)
        by = "fitted to an untouched picture and 4 presses of one unit (unit) by tacgen calibrate optics"
        assert led.source.startswith(f"{by}; on unseen presses ")
    # vignetted like the lights, stray light differs from theirs on the presses' slopes alone: known to about a count
    assert made.camera.ambient == pytest.approx((0.01, 0.02, 0.03), abs=0.005)
    assert mine.read_text().startswith("# a unit of ours\n")
    assert made.leds[0].center_mm == tuple(PLAIN["leds"][0]["center_mm"])


@pytest.mark.usefixtures("no_normals")
def test_powers_are_found_by_contacts_that_cover_the_picture(nominal: Path, tmp_path: Path) -> None:
    """Balls three times as wide as the picture: no rim shows."""
    true = (1.4, 0.8, 1.2)
    leds = [{**led, "power": power} for led, power in zip(PLAIN["leds"], true, strict=True)]
    wide = ((12.0, (40, 32), 60.0), (12.0, (25, 40), 60.0), (15.0, (52, 20), 65.0), (15.0, (40, 50), 65.0))
    folder = photographed(sensor(leds=leds, camera=FINE, markers=None), tmp_path / "unit", wide)
    found = optics.optics(str(nominal), folder, FitLimits(0, 0))
    powers = [sum(a.light) / sum(b.light) for a, b in zip(found.fitted.sensor.leds, found.sensor.leds, strict=True)]
    assert powers == pytest.approx(true, rel=0.03)
    assert found.fitted.unseen.counts[1].mean() < 0.3 * found.fitted.unseen.counts[0].mean()


@pytest.mark.usefixtures("no_normals")
def test_light_that_drifts_between_pictures_is_left_out_and_told(nominal: Path, tmp_path: Path) -> None:
    unit = sensor(camera=FINE, markers=None)
    folders = [photographed(unit, tmp_path / name) for name in ("steady", "warm")]
    for path in folders[1].glob("*.png"):
        if path.name != "background.png":
            warmer = np.asarray(Image.open(path)).astype(int) + np.array([6, 0, 0])
            Image.fromarray(np.clip(warmer, 0, 255).astype(np.uint8)).save(path)
    steady, warm = (optics.optics(str(nominal), folder, FitLimits(0, 0)) for folder in folders)
    assert steady.fitted.drift < 1.0
    assert warm.fitted.drift == pytest.approx(6 / np.sqrt(3), abs=0.5)
    assert f"left out: {warm.fitted.drift:.1f} counts rms" in "\n".join(warm.lines())
    for one, other in zip(warm.fitted.sensor.leds, steady.fitted.sensor.leds, strict=True):
        assert one.light == pytest.approx(other.light, rel=0.02, abs=0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("no_normals")
def test_lights_that_sit_elsewhere_are_found_by_the_presses(nominal: Path, tmp_path: Path) -> None:
    moved = [
        {**PLAIN["leds"][0], "center_mm": [0.3, -4.8, -2.35], "radiance": [10.8, 0, 0]},
        {**PLAIN["leds"][1], "center_mm": [5.8, -0.3, -1.8], "radiance": [0, 8.1, 0]},
        PLAIN["leds"][2],
    ]
    unit = sensor(leds=moved, camera={**FINE, "noise": {"shot": 1e-4, "read": 0.002, "source": "t"}}, markers=None)
    folder = photographed(unit, tmp_path / "unit")
    still, free = (optics.optics(str(nominal), folder, FitLimits(mm, 5.0)).fitted for mm in (0, 0.5))
    assert free.untouched < 0.5 * still.untouched
    assert free.unseen.counts[1].mean() < 0.8 * still.unseen.counts[1].mean()
    assert free.untouched < 1.0
    powers = [sum(led.radiance) for led in free.sensor.leds]
    assert powers == pytest.approx([10.8, 8.1, 9.0], rel=0.08)


def test_of_a_reflection_of_an_led_the_radiance_alone_is_fitted() -> None:
    led = PLAIN["leds"][0]
    unit = sensor(camera=FINE, markers=None, leds=[*PLAIN["leds"], {**led, "name": "back", "size_mm": [1.0, 1.0]}])
    plain = photos.Photos(Path(), np.full((unit.camera.height_px, unit.camera.width_px, 3), 90, np.uint8), ())
    model = PhotometricModel(unit, plain, (), FitLimits())
    free = (model._most > model._least)[: LED_PARAMETERS * len(unit.leds)].reshape(-1, LED_PARAMETERS)
    assert free.all(axis=1).tolist() == [True] * len(PLAIN["leds"]) + [False]
    assert not free[-1].any()


def test_a_background_alone_gives_powers_and_dots_are_left_out(tmp_path: Path) -> None:
    path = written(sensor(camera=FINE), tmp_path / "dotted.yaml")
    unit = sensor(leds=[{**led, "power": 0.8} for led in PLAIN["leds"]], camera=FINE)
    made = images.Renderer(unit, 64, 0, True, SCALAR_VARIANT)
    save(made.develop(made.flat()), tmp_path / "background.png")
    found = optics.optics(str(path), tmp_path)
    assert [sum(led.radiance) for led in found.fitted.sensor.leds] == pytest.approx([7.2] * 3, rel=0.04)
    assert found.fitted.presses is found.fitted.unseen is None
    assert ("leds", 0, "center_mm") not in found.changes
    blind = optics.optics(str(path), tmp_path, FitLimits(bare=True))
    assert blind.fitted.untouched > 4 * found.fitted.untouched
    assert blind.changes["markers",] is None


def test_what_lamps_do_not_explain_of_the_untouched_picture_is_glare(nominal: Path, tmp_path: Path) -> None:
    rising = {key: [[0.0, 0.02, 0.04, 0.06]] * 3 for key in ("red", "green", "blue")}
    unit, mine = sensor(camera={**FINE, "glare": rising}, markers=None), tmp_path / "mine.yaml"
    photo = images.Renderer(unit, 64, 0, False).develop(images.Renderer(unit, 64, 0, False).flat())
    save(photo, tmp_path / "background.png")
    found = optics.optics(str(nominal), tmp_path)
    assert found.fitted.untouched > 3
    found.write(mine, anyway=True)
    renderer = images.Renderer(loading.read_sensor(mine)[0], 64, 0, False)  # type: ignore[arg-type]
    assert np.sqrt(np.mean((renderer.develop(renderer.flat()).astype(float) - photo) ** 2)) < 1
    again = optics.optics(str(mine), tmp_path)  # its lamps need not explain the glare
    before, after = (np.array([led.radiance for led in made.fitted.sensor.leds]) for made in (found, again))
    assert after == pytest.approx(before, rel=0.05, abs=0.05)


@pytest.mark.slow
def test_a_gel_that_scatters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("tacgen.calibrate.scattering_fit.FIT_SPP", 6)
    panel = {**cloudy().leds[0].model_dump(), "size_mm": [6, 10]}
    leds = [{**panel, "name": name, "center_mm": [x, 0, -4.35]} for name, x in (("left", -3), ("right", 3))]
    path = written(cloudy(leds=leds), tmp_path / "cloudy.yaml")
    unit = cloudy(leds=[{**leds[0], "radiance": [2.4, 2, 2]}, {**leds[1], "power": 0.7}])
    made = images.Renderer(unit, 6, 0, False)
    (tmp_path / "unit").mkdir()
    save(made.develop(made.flat()), tmp_path / "unit" / "background.png")
    found = optics.optics(str(path), tmp_path / "unit").fitted
    assert np.array([led.radiance for led in found.sensor.leds]) == pytest.approx(
        np.array([[2.4, 2, 2], [1.4, 1.4, 1.4]]), rel=0.03
    )
    assert found.untouched < 1 < found.before


@pytest.mark.slow
def test_the_response_to_thickness_is_found_by_solved_presses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs of a unit whose press is 4 % deeper than its table says, and whose exposure follows the light."""
    monkeypatch.setattr("tacgen.calibrate.scattering_fit.FIT_SPP", 6)
    monkeypatch.setattr("tacgen.calibrate.scattering_fit.DEPTH_FACTORS", (0.96, 1.0, 1.04))
    response = {"change_mm": (-1.0, 0.0, 0.3), "gain": ((0.6, 0.7, 0.8), (1, 1, 1), (1.3, 1.2, 1.1)), "source": "test"}
    camera = {"width_px": 80, "height_px": 64, "mm_per_px": 0.1, "vignette_mm": None, "auto_exposure": 0.6}
    path = written(cloudy(camera=camera), tmp_path / "cloudy.yaml")
    unit = Sensor.model_validate(cloudy(camera=camera).model_dump() | {"thickness_response": response})
    folder = photographed(unit, tmp_path / "unit", ())
    press = photos.PhotographedPress("press.png", np.zeros(0), 3.0, (42.0, 30.0), None, 0.8)
    made = images.Renderer(unit, 6, 0, False)
    (face,) = solved_presses.solved(unit, press, [0.832], {})
    save(made.develop(made.flat()), folder / "background.png")  # of the same maps as the press
    save(made.develop(made.image(face)), folder / "press.png")
    table(folder, (*CIRCLE_COLUMNS[:-1], "depth_mm"), [("press.png", 3.0, 42, 30, 0.8)])
    found = optics.optics(str(path), folder).fitted
    assert found.deeper == 1.04
    assert found.presses < 1.5
    gain = found.sensor.thickness_response
    reached = np.array([change for change in gain.change_mm if -0.7 < change < 0.1])
    assert response_of(gain, reached) == pytest.approx(response_of(unit.thickness_response, reached), abs=0.05)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda p: (p / "background.png").unlink(), "holds no background.png"),
        (lambda p: save(np.full((64, 64, 3), 90), p / "background.png"), "is 64 x 64, and the camera's"),
        (lambda p: grey(p / "press_0.png", 255, 90, 90), "press_0.png: 100 % of its pixels"),
        (lambda p: grey(p / "press_0.png", 2, 1, 1), "press_0.png: is dark"),
        (lambda p: table(p, CIRCLE_COLUMNS, [("press_0.png", 4, 30, 28, 15)]), "press_0.png: shows no press"),
        (lambda p: (p / "press_1.png").write_text("no"), "press_1.png: is no picture that can be read"),
        (lambda p: (p / "press_1.png").unlink(), "press_1.png: cannot be read: no such file"),
        (lambda p: _swap(p, "ball_radius_mm", "radius"),
         "presses.csv: has no column ball_radius_mm (its header: file,"),
        (lambda p: _swap(p, "contact_radius_px", "c"), "presses.csv: has no column contact_radius_px, depth_mm"),
        (lambda p: _swap(p, "3.0,52", "x,52"), "presses.csv:3: ball_radius_mm: must be a number from 0.1 to 100"),
        (lambda p: _swap(p, "3.0,52", "3.0,152"), "presses.csv:3: (152, 40) lies outside the picture"),
        (lambda p: _swap(p, "40,14.0", "40,"), "presses.csv:3: must hold contact_radius_px, depth_mm or force_n"),
        (lambda p: _swap(p, "40,14.0", "40,31"), "presses.csv:3: contact_radius_px: is 3.1 mm, and the ball"),
        (lambda p: _swap(p, "press_1.png", ""), "presses.csv:3: file: is missing"),
        (lambda p: (p / "presses.csv").write_bytes(b"\xff\xfe\x00"), "presses.csv: is not a text file"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_reported_in_one_line(nominal: Path, tmp_path: Path, spoil: Any, says: str) -> None:
    for name in ("background.png", *(f"press_{k}.png" for k in range(4))):
        grey(tmp_path / name)
    rows = [(f"press_{k}.png", ball, *center, contact) for k, (ball, center, contact) in enumerate(PRESSES)]
    table(tmp_path, CIRCLE_COLUMNS, rows)
    spoil(tmp_path)
    with pytest.raises(UserError) as told:
        optics.optics(str(nominal), tmp_path)
    (line,) = told.value.lines
    assert says in line


def test_a_folder_or_lights_that_are_not_there(nominal: Path, tmp_path: Path) -> None:
    done = calibrate("optics", "--sensor", nominal, "--images", tmp_path / "none")
    assert (done.exit_code, done.stderr) == (2, f"{tmp_path / 'none'}: no such folder\n")
    lights = dict.fromkeys(("leds", "walls", "coating", "plate"))
    written(sensor().model_copy(update=lights), tmp_path / "dark.yaml")
    with pytest.raises(UserError, match="plate: is missing: a fit starts from a file with all its lights"):
        optics.optics(str(tmp_path / "dark.yaml"), tmp_path)


def _swap(folder: Path, old: str, new: str) -> None:
    table = folder / "presses.csv"
    assert old in table.read_text()
    table.write_text(table.read_text().replace(old, new))


@pytest.mark.slow
def test_a_press_of_known_depth_is_solved_also_where_its_contact_is_known():
    sensor, _ = loading.read_sensor(assets.sensor_path("gelsight_mini"))
    press = photos.PhotographedPress("p.png", np.zeros((240, 320, 3), np.uint8), 3.0, (160.0, 120.0), 25.0, None)
    assert isinstance(solved_presses.face(sensor, press, {}), BallDent)
    face = solved_presses.face(sensor, replace(press, depth=0.5), {})
    under = np.array([solved_presses.place(sensor, press.center, 0.5)])
    assert face.at(under)[0, 2] == pytest.approx(-0.5, abs=0.03)


DOME = {"dome": {"radius_x_mm": 40.0, "radius_y_mm": 30.0, "source": "test"}}


@pytest.mark.slow
@pytest.mark.usefixtures("few_dents")
@pytest.mark.parametrize(
    ("gel", "given"), [({}, "depth"), ({}, "contact"), ({}, "both"), ({}, "mixed"), (DOME, "depth"), (DOME, "mixed")]
)
def test_presses_may_give_depth_or_contact_or_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gel: dict[str, Any], given: str
) -> None:
    """Faces by formula stand for solved ones."""
    dim = [{**led, "power": 0.8} for led in PLAIN["leds"]]
    unit, file = (sensor(gel=gel, camera=FINE, markers=None, leds=leds) for leds in (PLAIN["leds"], dim))
    path, folder = written(file, tmp_path / "unit.yaml"), photographed(unit, tmp_path / "unit", PRESSES[:3])
    contacts = {center: contact for _, center, contact in PRESSES}

    def solved(sensor: Any, press: photos.PhotographedPress, aims: Any, folders: Any) -> Any:
        assert aims == [{"depth_mm": 0.5}]
        camera, contact = PinholeCamera.from_sensor(sensor), contacts[press.center]
        return [(BallDent.seen(camera, press.ball, press.center, contact), contact * sensor.camera.mm_per_px)]

    monkeypatch.setattr(solved_presses, "_solved", solved)
    monkeypatch.setattr("tacgen.calibrate.contact_circle.refined", lambda press, untouched, lamps: press)
    rows = []
    for k, (ball, center, contact) in enumerate(PRESSES[:3]):
        deep = given in ("depth", "both") or (given == "mixed" and k == 2)
        wide = given in ("contact", "both") or (given == "mixed" and k < 2)
        rows.append((f"press_{k}.png", ball, *center, contact if wide else "", 0.5 if deep else ""))
    table(folder, (*CIRCLE_COLUMNS, "depth_mm"), rows)
    found = optics.optics(str(path), folder, FitLimits(0, 0))
    report = list(found.lines())
    assert any(line.startswith("presses not seen by the fit: ") for line in report)
    assert any(line.startswith("  after: contrast") for line in report)  # the solver tells circles that are not given
    assert found.fitted.unseen.degrees is not None
    assert found.fitted.unseen.counts[1].max() < 6  # dents by formula are those of a flat face
    json.dumps(found.plain(), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize(("column", "value"), [("depth_mm", 0.4), ("force_n", 0.3)])
def test_a_brighter_dome_is_found_by_presses_of_known_depth_or_force(tmp_path: Path, column: str, value: float) -> None:
    unit = sensor(gel=DOME, camera=FINE, markers=None, leds=[{**led, "power": 1.3} for led in PLAIN["leds"]])
    path = written(sensor(gel=DOME, camera=FINE, markers=None), tmp_path / "file.yaml")
    folder = photographed(unit, tmp_path / "unit", ())
    made, rows = images.Renderer(unit, 16, 0, False, SCALAR_VARIANT), []
    for k, (ball, center, _) in enumerate(PRESSES[:2]):
        known = {"depth": value, "force": None} if column == "depth_mm" else {"depth": None, "force": value}
        press = photos.PhotographedPress("", np.zeros(0), ball, center, None, **known)
        save(made.develop(made.image(solved_presses.face(unit, press, {}))), folder / f"{k}.png")
        rows.append((f"{k}.png", ball, *center, value))
    table(folder, (*CIRCLE_COLUMNS[:-1], column), rows)
    found = optics.optics(str(path), folder, FitLimits(0, 0))
    before, after = found.fitted.unseen.counts
    assert after.max() < 2 < before.min()
    assert not found.problem()
    assert [sum(led.light) for led in found.fitted.sensor.leds] == pytest.approx([11.7] * 3, rel=0.05)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (",,1.99", "press_1.png: depth_mm: must be from 0.015 to 1.8 mm in a gel of 3 mm there (got 1.99)"),
        (",,1e99", "presses.csv:3: depth_mm: must be a number from 0.001 to 1e+06"),
        (",1e-9,", "presses.csv:3: contact_radius_px: must be a number from 3 to 1e+06 (got '1e-9')"),
    ],
)
def test_presses_that_no_gel_bears_are_refused_before_any_is_solved(
    nominal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str, says: str
) -> None:
    monkeypatch.setattr(solved_presses, "solved", lambda *_: pytest.fail("is solved"))
    for name, level in (("background.png", 90), ("press_1.png", 110)):
        picture = np.full((64, 80, 3), 90)
        picture[20:40, 30:60] = level
        save(picture, tmp_path / name)
    head = ",".join((*CIRCLE_COLUMNS, "depth_mm"))
    (tmp_path / "presses.csv").write_text(f"{head}\npress_1.png,4,30,28,,0.5\npress_1.png,3,52,40{change}")
    with pytest.raises(UserError) as told:
        optics.optics(str(nominal), tmp_path)
    (line,) = told.value.lines
    assert says in line


@pytest.mark.parametrize(("option", "value"), [("mm", "inf"), ("mm", "nan"), ("mm", "1e9"), ("deg", "nan")])
def test_tolerances_are_finite(nominal: Path, tmp_path: Path, option: str, value: str) -> None:
    grey(tmp_path / "background.png")
    done = calibrate("optics", "--sensor", nominal, "--images", tmp_path, f"--tolerance-{option}", value)
    refused(done, f"--tolerance-{option}: must be from 0 to")
