"""A fit is held against what is plausible before it is written, whichever command makes it."""

import ast
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.photographed import calibrate, refused, save, table, written
from helpers.tiny import sensor

import tacgen
from tacgen.base.errors import UserError
from tacgen.calibrate import dent_tables, force_curves, material, optics, press_localisation, sensor_fit, unit
from tacgen.calibrate.sensor_fit import Evidence, SensorFit
from tacgen.cli.calibrate import calibrations
from tacgen.recipe import loading

from .test_material import fitted
from .test_unit import FINE, formula

YOUNG = ("gel", "layers", 0, "youngs_modulus_mpa")
FITS = {"optics": optics, "material": material, "unit": unit}  # the module whose function of that name makes the fit


class Fit(SensorFit):
    """With a modulus, and what speaks for it."""

    known = Evidence()

    def lines(self) -> Iterator[str]:
        yield "a fit"

    def plain(self) -> dict[str, Any]:
        return {}

    def draw(self, out: Path) -> None: ...

    def evidence(self) -> Evidence:
        return self.known


def fit(folder: Path, modulus: float = 0.3, known: Evidence = Evidence(), **changes: Any) -> Fit:  # noqa: B008
    made = sensor(camera=FINE, markers=None)
    one = Fit(written(made, folder / "file.yaml"), made, {YOUNG: modulus, **changes})
    object.__setattr__(one, "known", known)
    return one


@pytest.mark.parametrize("command", [c.name or c.callback.__name__ for c in calibrations.registered_commands])
def test_every_command_refuses_an_odd_modulus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.setattr(FITS[command], command, lambda *_: fit(tmp_path, 0.0045))
    out, inputs = tmp_path / "mine.yaml", ["--recipe=r", "--data=d"] if command == "material" else ["--images=p"]
    asked = command, "--sensor", "s", *inputs, "-o", out
    done = calibrate(*asked)
    assert (done.exit_code, out.exists()) == (2, False), done.output
    assert done.stderr == (
        f"{out}: not written: gel.layers[0].youngs_modulus_mpa: a Young's modulus of 0.0045 MPa; that of gels is 0.005"
        " to 5, and moduli are in MPa; --anyway writes it\n"
    )
    done = calibrate(*asked, "--anyway")
    assert done.exit_code == 0, done.output
    assert "not plausible: gel.layers[0].youngs_modulus_mpa: " in done.stdout
    assert loading.read_sensor(out)[0].gel.layers[0].youngs_modulus_mpa == 0.0045


def test_sensor_files_are_written_by_that_function_alone() -> None:
    package = Path(tacgen.__file__).parent
    for module in [*package.glob("calibrate/*.py"), *package.glob("cli*.py")]:
        nodes = [node for node in ast.walk(ast.parse(module.read_text())) if isinstance(node, ast.Attribute | ast.Name)]
        names = {node.attr if isinstance(node, ast.Attribute) else node.id for node in nodes}
        assert module.name in ("sensor_fit.py",) or not names & {"write_sensor", "edited"}, module
    with pytest.raises(TypeError):  # a fit says what speaks for it
        type("Unjudged", (SensorFit,), {})(Path(), sensor(), {})


FOUR, FIRST = np.array([0.05, 0.4, 0.7, 1.0]), np.array([1, 0, 0, 0])


@pytest.mark.parametrize(
    ("known", "says"),
    [
        (Evidence(force=(FOUR, FOUR * 1.1, 1.0)), ""),
        (Evidence(force=(FOUR + 0.48 * FIRST, FOUR, 1.0)), "off by 37 % rms, and 0.53 N where 0.05 N was measured"),
        (Evidence(force=(FOUR + 0.2 * FIRST, FOUR, 1.0)), "off by 16 % rms, and 0.25 N where 0.05 N was measured"),
        (Evidence(force=(FOUR + 0.2 * FIRST, FOUR, np.array([4, 1, 1, 1]))), ""),  # while the force changes fast
        (Evidence(force=(np.full(4, 0.54), FOUR, 1.0)), "the fitted forces do not follow the measured ones: "),
        (Evidence(pictures=(0.8, 0.59)), ""),
        (Evidence(pictures=(0.8, 0.61)), "dents explain 80 % of the pictures' change, and light that drifts 61 %: "),
        (Evidence(unseen="the fit is not better"), "the fit is not better"),
    ],
)
def test_a_fit_must_explain_what_it_was_made_from(tmp_path: Path, known: Evidence, says: str) -> None:
    found = fit(tmp_path, known=known)
    assert bool(found.problem()) == bool(says)
    assert says in found.problem()
    if says:
        with pytest.raises(UserError, match=r"not written: .*; --anyway writes it"):
            found.write(tmp_path / "mine.yaml")


def test_a_fitted_file_that_validate_refuses_is_not_plausible(tmp_path: Path) -> None:
    found = Fit(*(getattr(fit(tmp_path), k) for k in ("path", "sensor")), {("leds", 0, "center_mm"): [0, -4.9, 3.0]})
    assert found.problem().startswith("leds[0]")


@pytest.mark.parametrize("force", [[1.0, 0.9, 0.8, 0.05], [0.1, 0.9, 0.05, 1.1]])
def test_forces_of_no_press_are_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: list[float]
) -> None:
    monkeypatch.setattr(force_curves, "solved", lambda row, depths: depths**1.5)
    mine, rows = tmp_path / "mine.yaml", [f"{d},{f}" for d, f in zip((0.2, 0.4, 0.6, 0.8), force, strict=True)]
    done = fitted(tmp_path, "\n".join(["depth_mm,force_n", *rows]), "--no-zero", "-o", mine)
    refused(done, "not written: the fitted forces do not follow the measured ones: off by ")
    assert not mine.exists()


def drifting(folder: Path, shape: str) -> tuple[Path, Path]:
    """Photographs without a rim: light grows brighter from one to the next, and the gauge drifts meanwhile."""
    file, images = written(sensor(camera=FINE, markers=None), folder / "file.yaml"), folder / "images"
    images.mkdir()
    y, x = np.mgrid[-1:1:80j, -1:1:96j][..., None]
    spot = np.exp(-((x - 0.05) ** 2 + (y + 0.1) ** 2) / 0.18)
    light = {"spot": (1 + 0.4 * x - 0.3 * y) * spot, "all": 1 + 0.5 * x + 0.3 * y**2}
    plain, random = 120 + 30 * x + 0 * np.ones(3), np.random.default_rng(0)
    save(np.floor(plain), images / "background.png")
    rows = []
    for k in range(6):
        seen = plain * (1 + 0.02 * (k + 1) * light[shape] * [1.0, -0.4, 0.7]) + random.normal(0, 1, plain.shape)
        save(seen, images / f"{k}.png")
        rows.append((f"{k}.png", 4, 0.01 + 0.02 * k))
    table(images, ("file", "ball_radius_mm", "force_n"), rows)
    return file, images


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> unit.Asked:
    monkeypatch.setattr(dent_tables, "solved", partial(formula, deepest=3.6))
    monkeypatch.setattr(press_localisation, "COMPARED_PIXELS", 150)
    return unit.Asked(thickness=False, lights=False)


DRIFT = r"dents explain \d+ % of the pictures' change, and light that drifts (9\d|100) %: see"


@pytest.mark.slow
def test_pictures_and_forces_that_drift_in_time_are_no_presses(tmp_path: Path, solved: unit.Asked) -> None:
    file, images = drifting(tmp_path, "spot")
    found, mine = unit.unit(str(file), images, solved), tmp_path / "mine.yaml"
    assert re.search(DRIFT, found.problem())
    with pytest.raises(UserError, match=DRIFT):
        found.write(mine)
    found.write(mine, anyway=True)
    assert mine.read_text().startswith("# Fitted by tacgen calibrate unit to 6 presses")


def test_where_no_rim_shows_depths_beyond_the_solved_ones_are_not_blamed(tmp_path: Path, solved: unit.Asked) -> None:
    file, images = drifting(tmp_path, "all")
    with pytest.raises(UserError, match=rf"^\S+presses.csv: {DRIFT}"):
        unit.unit(str(file), images, solved)


def test_relative_errors_of_small_forces_are_of_a_share_of_the_largest() -> None:
    assert sensor_fit.off(np.array([0.1, 1.1]), np.array([0.0, 1.0])) == pytest.approx([2.0, 0.1])
