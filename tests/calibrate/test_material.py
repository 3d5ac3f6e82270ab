"""Material constants from forces: found where they are known, within the bounds that the fit itself states."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.photographed import calibrate, refused
from helpers.small_recipe import HEAD

from tacgen import mechanics
from tacgen.calibrate import force_curves, material_fit
from tacgen.calibrate.force_curves import Curves, Measured
from tacgen.mechanics import mesh
from tacgen.recipe import assets, loading, plan, scene_of_row
from tacgen.recipe.row import Row

MODULUS = "gel.layers[0].youngs_modulus_mpa"
DEEPEST = 1.0  # [mm]


def row(folder: Path, steps: str = "- press: {depth_mm: 1, frames: 1}", sets: tuple[str, ...] = ()) -> Row:
    path = folder / "press.yaml"
    path.write_text(f"{HEAD}  {steps}\n")
    return plan.load(path, sets).rows[0]


def fitted(folder: Path, table: str, *more: object) -> Any:
    """Run the command on a table of forces."""
    row(folder)
    (folder / "ours.csv").write_text(table)
    asked = "--sensor", "gelsight_mini", "--recipe", folder / "press.yaml", "--data", folder / "ours.csv"
    return calibrate("material", *asked, *more)


@pytest.fixture(scope="module")
def curves(tmp_path_factory: pytest.TempPathFactory) -> Curves:
    """Of the GelSight Mini under a ball, solved once."""
    depths = force_curves.depths_for(DEEPEST)
    return Curves(depths, force_curves.solved(row(tmp_path_factory.mktemp("curve")), depths)[None])


def test_a_curve_is_what_is_solved_and_linear_in_the_modulus(curves: Curves, tmp_path: Path) -> None:
    depths = np.array([0.33, 0.61, 0.95])
    stiffer = force_curves.solved(row(tmp_path, sets=(f"sensor.{MODULUS}=0.648",)), depths)
    assert stiffer == pytest.approx(1.5 * curves.force(depths), rel=4e-3)
    assert curves.force(np.array([-0.1, 0.0])) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("part", "even"), [(0.01, 0.005), pytest.param(0.02, 0.0, marks=pytest.mark.slow)])
def test_known_constants_lie_within_the_bounds_of_95_in_100_draws(curves: Curves, part: float, even: float) -> None:
    """Forces 1.3 times as large and first touch .04 mm early, with noise in proportion to the force and without."""
    random, depth, true = np.random.default_rng(5), np.linspace(0.08, DEEPEST, 16), {"modulus": 1.3, "zero": 0.04}
    clean = 1.3 * curves.force(depth + 0.04)
    inside, found, width = [], [], []
    for _ in range(60):
        noise = np.hypot(part * clean, even * clean.max()) * random.normal(size=depth.size)
        fit = material_fit.fit(curves, Measured("draw", depth, clean + noise))
        inside.append([e.low <= true[e.name] <= e.high for e in fit.estimates])
        found.append([fit["modulus"], fit["zero"]])
        width.append([e.high - e.low for e in fit.estimates])
        assert fit.correlation[0, 1] < -0.5
    assert np.mean(inside) == pytest.approx(0.95, abs=0.04)
    assert np.mean(width, 0) == pytest.approx(2 * 2.16 * np.std(found, 0), rel=0.4)  # t of 13 degrees of freedom


def test_a_second_parameter_is_found_or_said_to_be_at_its_end(curves: Curves) -> None:
    depths, values = force_curves.depths_for(DEEPEST), np.linspace(0, 1, 5)
    family = Curves(depths, np.array([curves.force(depths) * (1 + v * depths**2) for v in values]), values)
    depth = np.linspace(0.1, DEEPEST, 12)
    exact = material_fit.fit(
        family, Measured("", depth, 0.8 * curves.force(depth + 0.02) * (1 + 0.6 * (depth + 0.02) ** 2))
    )
    assert [e.value for e in exact.estimates] == pytest.approx([0.8, 0.02, 0.6], abs=4e-3)
    assert exact.worst < 1e-3
    beyond = material_fit.fit(family, Measured("", depth, curves.force(depth) * (1 - 0.2 * depth**2)), zero=False)
    assert [(e.value, e.bound) for e in beyond.estimates][1] == (pytest.approx(0.0, abs=1e-6), True)
    held = material_fit.fit(family, Measured("", depth, family.force(depth, 0.5)), zero=False, value=0.5)
    assert [e.name for e in held.estimates] == ["modulus"]
    assert held["modulus"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_relaxation_of_a_solved_viscoelastic_gel_is_found(curves: Curves, tmp_path: Path) -> None:
    steps = "- press: {depth_mm: 0.8, frames: 6, duration_s: 0.3}\n  - hold: {frames: 10, duration_s: 2}"
    made = row(tmp_path, steps, ("sensor.gel.layers[0].prony=[{g: 0.25, tau_s: 0.5}]",))
    built = scene_of_row.build(made)
    forces = [mechanics.normal_force(s) for s in mechanics.states(built, mechanics.Problem.of(built, mesh.of(built)))]
    depth = np.minimum(np.arange(1, 17) * 0.8 / 6, 0.8)
    found = material_fit.fit(curves, Measured("", depth, np.array(forces), np.cumsum(built.duration)), terms=1)
    assert (found["g1"], found["tau1"]) == (pytest.approx(0.25, rel=0.03), pytest.approx(0.5, rel=0.05))
    assert found["modulus"] == pytest.approx(1.0, abs=0.02)
    assert found.worst < 0.04


def test_the_command_writes_a_sensor_file_with_its_source(curves: Curves, tmp_path: Path) -> None:
    depth = np.linspace(0.1, 0.9, 9)
    lines = [f"{d:.4f},{1.2 * f:.5f}" for d, f in zip(depth, curves.force(depth + 0.05), strict=True)]
    mine, plot = tmp_path / "mine.yaml", tmp_path / "fit.png"
    done = fitted(tmp_path, "\n".join(["depth_mm, force_n", *lines]), "-o", mine, "--plot", plot)
    assert done.exit_code == 0, done.output
    assert "correlation of modulus and zero: -0." in done.stdout
    assert "modulus alone: off by" in done.stdout
    told = re.search(rf"^{re.escape(MODULUS)}: (\S+) MPa \(95 %: (\S+) to (\S+)\)$", done.stdout, re.M)
    assert told, done.stdout
    value, low, high = map(float, told.groups())
    assert low < value < high
    assert "times the file's (95 %: " in done.stdout
    layer, before = (loading.read_sensor(path)[0].gel.layers[0] for path in (mine, assets.sensor_path("gelsight_mini")))
    assert layer.youngs_modulus_mpa == value
    assert layer.youngs_modulus_mpa == pytest.approx(1.2 * before.youngs_modulus_mpa, rel=4e-3)
    assert layer.source.startswith(f"{before.source}; moduli times 1.")
    assert layer.source.endswith("fitted to measured forces of a sphere (ours.csv) by tacgen calibrate material")
    assert mine.read_text().startswith("# GelSight Mini. Frame:")
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("table", "more", "says"),
    [
        ("depth,force_n\n1,2\n", (), "has no column depth_mm (its header: depth,force_n)"),
        ("", ("--data", "nothing.csv"), "nothing.csv: cannot be read: No such file"),
        ("depth_mm,force_n\n1,2\n2,3\n", (), "has 2 rows, and a fit takes 3 at least"),
        ("depth_mm,force_n\n1,2\n2,x\n3,4\n", (), ":3: force_n: must be a number below 1e+06 (got 'x')"),
        ("depth_mm,force_n\n1,-2\n2,-3\n3,-4\n", (), "holds no press"),
        ("depth_mm,force_n,time_s\n1,2,1\n2,3,1\n3,4,2\n", (), ":3: time_s: must rise (got 1 after 1)"),
        ("depth_mm,force_n,time_s\n1,2,-1\n2,3,1\n3,4,2\n", (), ":2: time_s: must be at least 0, first touch"),
        ("depth_mm,force_n\n1,2\n2,3\n3,4\n", ("--prony", "1"), "has no column time_s, without which nothing relaxes"),
        ("depth_mm,force_n\n.5,2\n1,3\n2,4\n", ("--second", "friction=0.5"), "must be PATH=LOW:HIGH, such as"),
        ("depth_mm,force_n\n.5,2\n1,3\n2,4\n", ("--second", "name=0:1"), "name is no number of the recipe or"),
        ("depth_mm,force_n\n.5,2\n1,3\n2,4\n", ("--second", f"sensor.{MODULUS}=1:2"), "is 0.432, which the range must"),
        ("depth_mm,force_n\n0.5,1,2\n1,2\n1.5,3", (), ":2: has 3 cells, and the header 2: is a comma a decimal point?"),
        ("depth_mm,force_n\n0.0005,1\n0.001,3\n0.0015,5\n", (),
         "the largest must be from 0.02 to 2.18 mm in a gel of 4 mm there (got 0.00"),
        ("depth_mm,force_n\n0.5,1\n1,3\n3.9,5\n", (),
         "the largest must be from 0.02 to 2.18 mm in a gel of 4 mm there (got 3.9)"),
        ("depth_mm,force_n\n0.5,1\n1,3\n1.5,1e308\n", (), ":4: force_n: must be a number below 1e+06 (got '1e308')"),
        ("depth_mm,force_n\n0.5,1\n1,3\n1.5,4\n", ("--second", "contact.friction=0:inf"), "must be PATH=LOW:HIGH"),
        ("depth_mm,force_n\n0.5,1\n1,3\n1.5,4\n", ("--second", "contact.friction=nan:1"), "must be PATH=LOW:HIGH"),
    ],
)  # fmt: skip
def test_an_unusable_table_is_told_in_one_line(tmp_path: Path, table: str, more: tuple[str, ...], says: str) -> None:
    refused(fitted(tmp_path, table, *more), says)


def test_more_numbers_than_rows_are_refused(curves: Curves) -> None:
    depth = np.array([0.2, 0.4, 0.6])
    measured = Measured("", depth, curves.force(depth), np.array([1.0, 2.0, 3.0]))
    with pytest.raises(ValueError, match="3 rows are too few to find 4 numbers"):
        material_fit.fit(curves, measured, terms=1)


@pytest.mark.parametrize(
    ("depth", "factor", "more", "says"),
    [
        ([0.5] * 5, 1.0, (), "zero: is not determined: these forces allow its whole range: measure small depths"),
        ([-0.4, -0.2, -0.1, 0.5], 1.0, (), "zero: is not determined"),
        ([0.2, 0.5, 0.8, 1.0], 1e5, (), "forces are as of a modulus 1e+03 times the file's: are they in N"),
        ([0.2, 0.5, 0.8, 0.8, 0.8], 1.0, ("--prony", "1", "--no-zero"), "tau1: is not determined"),
    ],
)
def test_what_forces_leave_open_is_said_and_nothing_written(
    curves: Curves, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, depth: list[float], factor: float,
    more: tuple[str, ...], says: str,
) -> None:  # fmt: skip
    """Depths that are all alike, forces of 0, forces in another unit, and a gel that does not relax."""
    monkeypatch.setattr(force_curves, "solved", lambda row, depths: curves.force(depths))
    force = factor * curves.force(np.array(depth))
    rows = [f"{d},{f:.6f},{k}" for k, (d, f) in enumerate(zip(depth, force, strict=True))]
    refused(fitted(tmp_path, "\n".join(["depth_mm,force_n,time_s", *rows]), *more, "-o", tmp_path / "mine.yaml"), says)
    assert not (tmp_path / "mine.yaml").exists()
