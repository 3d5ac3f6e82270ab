"""Steps of a fit are told with the share of the work that is done; parts are made on all cores; Ctrl-C keeps a fit."""

import io
import math
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from helpers.photographed import FINE, PRESSES, calibrate, photographed, written
from helpers.tiny import sensor

from tacgen.base import machine
from tacgen.base.errors import UserError
from tacgen.calibrate import contrast_fit, dent_family, photometric_fit, steps
from tacgen.calibrate.dent_tables import DENT_RADII, Dents
from tacgen.render.images import Renderer
from tacgen.report import progress
from tacgen.report.progress import StepProgress
from tacgen.sensor.model import LitSensor


def test_a_step_is_told_with_the_share_of_the_work_that_is_done() -> None:
    told: list[tuple[str, float]] = []
    with steps.telling(lambda text, share: told.append((text, share))):
        steps.expect(4.0)
        steps.begin("one", 1.0)
        steps.begin("two", 3.0)
        steps.go_on("half")
    steps.begin("nobody listens", 1.0)
    assert told == [("one", 0.0), ("two", 0.25), ("two: half", 0.25)]


@pytest.mark.parametrize("cores", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_parts_are_made_in_order_on_all_cores(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "cores", lambda: cores)
    monkeypatch.setattr(steps, "MAX_WORKERS", 2)
    shares: list[float] = []
    with steps.telling(lambda text, share: shares.append(share)):
        steps.expect(3.0)
        made = steps.on_workers(math.hypot, [(3, 4), (5, 12), (8, 15)], ["a", "b", "c"], 1.0)
        steps.begin("end", 0.0)
    assert made == [5.0, 13.0, 17.0]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.slow
def test_a_part_that_fails_in_a_worker_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "cores", lambda: 2)
    monkeypatch.setattr(steps, "MAX_WORKERS", 2)
    with pytest.raises(UserError, match="second: ValueError"):
        steps.on_workers(math.sqrt, [(4.0,), (-1.0,)], ["first", "second"], 1.0)


def test_steps_are_lines_with_the_time_left_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 10.0, 10.5, 30.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    out = io.StringIO()
    with StepProgress(out) as shown:
        for text, share in (("soon", 0.0), ("a", 0.25), ("too soon after it", 0.3), ("b", 0.75)):
            shown(text, share)
    assert out.getvalue().splitlines() == ["a (about 30 s left)", "b (about 10 s left)"]


def dents(thick: float) -> Dents:
    """Presses whose rim and force depend smoothly on the thickness."""
    depth = 0.4 * thick * np.geomspace(0.02, 1.0, 9)
    rim = 1 - 0.2 * np.sqrt(4 * depth) / (thick + np.sqrt(4 * depth))
    slope = np.where(rim[:, None] > DENT_RADII, DENT_RADII, rim[:, None] * np.exp(-3 * (DENT_RADII - rim[:, None])))
    force = np.sqrt(4 * depth**3) * (1 + 4 * depth / thick**2)
    return Dents(4.0, thick, depth, force, -slope, slope, rim * np.sqrt(4 * depth))


def test_presses_between_solved_thicknesses_are_interpolated_and_their_error_is_told() -> None:
    known = [dents(factor * 3) for factor in dent_family.SOLVED_THICKNESS_FACTORS]
    for factor in (0.63, 1.0, 1.6):
        true, made = dents(factor * 3), dent_family.interpolated(known, factor * 3)
        off = np.abs(made.force_at(true.depth) / true.force - 1).max()
        assert off < max(dent_family.error(known), 1e-4) < 0.05
        assert made.contact == pytest.approx(true.contact, rel=0.01)
        r = np.linspace(0, 2, 50)
        assert made.face(0.5, r)[1] == pytest.approx(true.face(0.5, r)[1], abs=0.04)
    again = dent_family.interpolated(known, known[1].thickness)
    assert again.force == pytest.approx(known[1].force, rel=1e-9)


def test_more_contrast_leaves_the_untouched_picture_as_bright() -> None:
    unit = cast(LitSensor, sensor(camera={**FINE, "noise": None, "ambient": [0.2, 0.2, 0.2]}, markers=None))
    made = contrast_fit.scaled(unit, np.full(3, 1.2))
    before, after = (Renderer(one, 1, 0, markers=False).flat() for one in (unit, made))
    assert after.mean(axis=(0, 1)) == pytest.approx(before.mean(axis=(0, 1)), rel=1e-3)
    assert (after - made.camera.ambient).std() == pytest.approx(1.2 * (before - unit.camera.ambient).std(), rel=1e-3)


@pytest.mark.slow
def test_ctrl_c_writes_the_fit_to_all_photographs_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    unit = sensor(camera=FINE, markers=None)
    path, folder = written(sensor(camera=FINE, markers=None), tmp_path / "unit.yaml"), tmp_path / "photos"
    photographed(unit, folder, PRESSES[:3])
    monkeypatch.setattr(photometric_fit.PhotometricFits, "judged", interrupt)
    out = tmp_path / "mine.yaml"
    done = calibrate("optics", "--sensor", path, "--images", folder, "--tolerance-mm", 0, "-o", out)
    assert done.exit_code == 130, done.output
    assert out.read_text().startswith("# interrupted: not judged by presses that the fit has not seen\n")
    assert "interrupted" in done.stdout
