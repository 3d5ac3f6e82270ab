"""A fit is judged by presses that it has not seen, and one that does not help is not written."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.photographed import FINE, PRESSES, calibrate, photographed, refused, save, written
from helpers.tiny import PLAIN, sensor
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.calibrate import cross_validation, optics, photometric_fit, photos, solved_presses
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.render_comparison import Likeness
from tacgen.mechanics import NotConverged
from tacgen.recipe import loading


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, few_dents: None) -> None:
    monkeypatch.setattr("tacgen.calibrate.contact_circle.refined", lambda press, untouched, lamps: press)


def radiances(folder: Path, unit: Any, *options: object) -> Any:
    """Run the command with radiances alone, from the plain sensor, on photographs of a unit."""
    path = written(sensor(camera=FINE, markers=None), folder / "file.yaml")
    images = photographed(unit, folder / "unit", PRESSES[:2])
    return calibrate("optics", "--sensor", path, "--images", images, "--tolerance-mm", 0, *options)


def test_each_of_few_presses_is_left_out_once_and_a_third_of_more_in_turn() -> None:
    assert cross_validation.folds(0) == cross_validation.folds(1) == []
    assert cross_validation.folds(5) == [[1], [2], [3], [4], [5]]
    assert cross_validation.folds(7) == [[1, 4, 7], [2, 5], [3, 6]]


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [([5, 5, 5], [4, 4, 4.5], True), ([5, 5, 5], [6, 6, 6], False), ([5, 5, 5], [5, 5, 5], False),
     ([5, 5, 5], [1, 6, 7.5], False),  # the mean gain lies within its standard error
     ([5, 5, 5], [4.6, 4.6, 4.7], False)],  # sure, and too small for a file that is replaced
)  # fmt: skip
def test_a_gain_counts_beyond_its_error_and_a_tenth(before: list[float], after: list[float], better: bool) -> None:
    assert cross_validation.HeldOutPresses((), (), (), np.array([before, after]), None).better == better


@pytest.mark.parametrize(
    ("counts", "better"),
    [([4, 4, 4], True), ([3, 5, 6], True), ([5, 5, 6], True), ([5, 6, 6], False)],
)  # fmt: skip
def test_better_normals_count_unless_counts_rise_beyond_their_standard_error(counts: list[float], better: bool) -> None:
    none = np.full(3, np.nan)
    before, after = (Likeness(none, none, none, np.mean(n), 0.0, 0.0, np.array(n)) for n in ([5, 5, 6], [4, 3, 3]))
    one = cross_validation.HeldOutPresses((), (), (), np.array([[5, 5, 5], counts]), (before, after))
    assert one.better == better
    assert not replace(one, likeness=(after, before)).better
    hardly = replace(before, each=before.each - 0.08)  # two networks differ by as much
    assert not replace(one, likeness=(before, hardly)).better


@pytest.mark.slow
def test_the_written_fit_is_made_as_those_that_judge_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A judging fit from which no press is left out is the written one."""
    monkeypatch.setattr(photometric_fit, "TOLERANCE_RIDGES", (30.0, 3.0))
    moved = [{**led, "center_mm": np.add(led["center_mm"], [0.2, 0.1, 0.2]).tolist()} for led in PLAIN["leds"]]
    file, unit = sensor(camera=FINE, markers=None), sensor(leds=moved, camera=FINE, markers=None)
    read = photos.read(photographed(unit, tmp_path / "unit", PRESSES[:2]), file.camera)
    faces = [solved_presses.face(file, press, {}) for press in read.presses]
    trial = photometric_fit.PhotometricFits(file, read, faces, FitLimits(0.5, 5.7, bare=True))
    _, (_, (judging,)) = trial.judged([[]])
    assert trial.whole(3.0).sensor == judging


def test_worse_scores_are_told_before_and_after() -> None:
    one = cross_validation.HeldOutPresses((), (), (), np.array([[4.0, 5.0], [6.0, 6.0]]), None)
    assert str(one) == "4.5 before and 6.0 after the fit [counts rms]"


@pytest.mark.slow
def test_a_fit_that_does_not_help_is_not_written_unless_asked(tmp_path: Path) -> None:
    """Photographs of the file's own sensor: no fit can be better."""
    out, exact = tmp_path / "mine.yaml", sensor(camera=FINE, markers=None)
    done = radiances(tmp_path, exact, "-o", out)
    refused(done, f"{out}: not written: the fit is not better on presses that it has not seen: ")
    assert " before and " in done.stderr
    assert not out.exists()
    done = radiances(tmp_path, exact, "-o", out, "--anyway")
    assert (done.exit_code, out.is_file()) == (0, True)


def test_counts_that_rise_refuse_a_fit_without_networks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photometric_fit, "Comparison", lambda _: pytest.fail("a network learns"))
    fits, out = photometric_fit.PhotometricFits, tmp_path / "mine.yaml"
    judged = fits.judged

    def worse(self: Any, groups: list[list[int]]) -> Any:
        counts, made = judged(self, groups)
        return np.vstack([0 * counts[:1] + 2, 0 * counts[1:] + 3]), made

    monkeypatch.setattr(fits, "judged", worse)
    done = radiances(tmp_path, sensor(camera=FINE, markers=None), "-o", out)
    said = "2.0 before and 3.0 after the fit [counts rms]; --anyway writes it"
    refused(done, f"{out}: not written: the fit is not better on presses that it has not seen: {said}")


@pytest.mark.slow
def test_a_fit_that_helps_is_written_with_its_scores_and_drawn(tmp_path: Path) -> None:
    out, figure = tmp_path / "mine.yaml", tmp_path / "unseen.png"
    unit = sensor(leds=[{**led, "power": 1.5} for led in PLAIN["leds"]], camera=FINE, markers=None)
    done = radiances(tmp_path, unit, "-o", out, "--figure", figure)
    assert done.exit_code == 0, done.output
    mine, _ = loading.read_sensor(out)
    assert "; on unseen presses " in mine.leds[0].source
    assert " before and " in mine.leds[0].source
    assert np.asarray(Image.open(figure)).std() > 10
    (sure,) = [line for line in done.stdout.splitlines() if line.startswith("determined by the photographs: ")]
    for led, channel in zip(PLAIN["leds"], ("red", "green", "blue"), strict=True):
        assert f"{led['name']} {channel}" in sure


def test_without_presses_nothing_is_judged(tmp_path: Path) -> None:
    unit, out = sensor(camera=FINE, markers=None), tmp_path / "mine.yaml"
    path, folder = written(unit, tmp_path / "file.yaml"), photographed(unit, tmp_path / "unit", ())
    asked = "optics", "--sensor", path, "--images", folder
    refused(calibrate(*asked, "-o", out), f"{out}: not written: the fit is not judged: it takes two presses")
    refused(calibrate(*asked, "--figure", tmp_path / "f.png"), "the fit is not judged")


def test_what_data_determine_against_a_ridge() -> None:
    slopes = np.zeros((4, 3))
    slopes[0, 0], slopes[1, 1] = 30.0, 3.0  # strongly, as strongly as the ridge, not at all
    assert cross_validation.determined(slopes, 3.0) == pytest.approx([900 / 909, 0.5, 0.0])


def test_a_press_of_known_force_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unit = sensor(camera=FINE, markers=None)
    press = photos.PhotographedPress("p.png", np.zeros((64, 80, 3), np.uint8), 3.0, (40.0, 32.0), None, None, 0.3)
    asked = {}

    def solved_states(row: Any) -> Any:
        asked["press"] = row.recipe.trajectory[0].press
        raise NotConverged("so it is solved")

    monkeypatch.setattr(solved_presses, "solved_states", solved_states)
    with pytest.raises(UserError, match=r"p\.png: cannot be solved"):
        solved_presses.face(unit, press, {})
    assert (asked["press"].force_n, asked["press"].depth_mm) == (0.3, None)


@pytest.mark.slow
def test_a_force_and_the_depth_that_has_it_give_the_same_face() -> None:
    unit = sensor(camera=FINE, markers=None)
    deep = photos.PhotographedPress("p.png", np.zeros((64, 80, 3), np.uint8), 3.0, (40.0, 32.0), None, None, 0.3)
    at = np.array([solved_presses.place(unit, deep.center, 0.0)])
    low = solved_presses.face(unit, deep, {}).at(at)[0, 2]
    (again,) = solved_presses.solved(unit, deep, [-float(low)], {})
    assert again.at(at)[0, 2] == pytest.approx(low, abs=0.02)


def test_a_force_beside_the_gel_is_refused() -> None:
    unit = sensor(camera=FINE, markers=None)
    press = photos.PhotographedPress("p.png", np.zeros(0), 3.0, (-500.0, 32.0), None, None, 0.3)
    with pytest.raises(UserError, match=r"p\.png: force_n: lies beside the gel"):
        solved_presses.check(unit, photos.Photos(Path("unit"), np.zeros(0), (press,)))


def test_the_report_is_json(tmp_path: Path) -> None:
    file, bright = sensor(camera=FINE, markers=None), [{**led, "power": 1.5} for led in PLAIN["leds"]]
    unit = sensor(leds=bright, camera=FINE, markers=None)
    path, folder = written(file, tmp_path / "file.yaml"), photographed(unit, tmp_path / "unit", PRESSES[:2])
    found = optics.optics(str(path), folder, FitLimits(0, 0)).plain()
    assert found["unseen"]["presses"] == ["press_0.png", "press_1.png"]
    assert np.shape(found["unseen"]["counts"]) == np.shape(found["unseen"]["degrees"]) == (2, 2)


def test_glare_in_the_untouched_picture_does_not_spoil_lights_fitted_to_changes(tmp_path: Path) -> None:
    camera = {**FINE, "response": "linear"}
    file = sensor(camera=camera, markers=None)
    unit = sensor(leds=[{**led, "power": 0.7} for led in PLAIN["leds"]], camera=camera, markers=None)
    folder = photographed(unit, tmp_path / "unit", PRESSES[:3])
    glare = np.linspace(80, 0, FINE["width_px"])[None, :, None]  # [counts]
    for picture in folder.glob("*.png"):
        seen = np.asarray(Image.open(picture)) + glare
        save(seen, picture)
    read = photos.read(folder, file.camera)
    faces = [solved_presses.face(file, press, {}) for press in read.presses]
    read = replace(read, presses=tuple(replace(press, contact=None, depth=0.5) for press in read.presses))

    def off(changes: bool) -> float:
        made = photometric_fit.fit_faces(file, read, faces, FitLimits(0, 0), changes=changes)
        return float(np.abs([sum(led.light) / 6.3 - 1 for led in made.sensor.leds]).max())

    assert off(True) < 0.1 < off(False)
