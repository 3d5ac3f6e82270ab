"""Benches: tables, plots and the page that they make, what a scene pays for, and that each of them runs."""

import json
import shutil
from dataclasses import replace
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import numpy as np
import pytest
from helpers import tiny
from helpers.blocks import block
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from threadpoolctl import threadpool_info, threadpool_limits

import benchmarks as bench
from benchmarks import (
    cost_per_output,
    mechanics,
    ordinary,
    photographs,
    pipeline,
    reference_runs,
    results_page,
    stability,
    step_size_error,
    summary,
)
from benchmarks.__main__ import main
from benchmarks.cases import PLAIN
from tacgen.base.errors import UserError
from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.mechanics import solver
from tacgen.optics import camera_response
from tacgen.recipe import scene_of_row

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.usefixtures("own_cache")


def result(seconds: float) -> results_page.Result:
    heads = results_page.columns("method", "s: .2f", "error: +.1%")
    curve = results_page.Series("measured", [1.0, 2.0], [0.1, 0.05], ["a", "b"])
    table = results_page.Table("Runs", heads, [["fine | slow", seconds, -0.0125], ["none", None, None]], "A note.")
    return results_page.Result("What was done.", [table], [results_page.Plot("Error", "s", "error", [curve])])


@pytest.mark.slow
def test_the_page_is_made_of_what_was_found(tmp_path: Path) -> None:
    results_page.write(tmp_path / "results", "mechanics", result(3.14159), 12.3)
    results_page.page(tmp_path / "results", ["mechanics", "stability"], tmp_path / "RESULTS.md", "Results", "Head.")
    page = (tmp_path / "RESULTS.md").read_text()
    assert "| fine \\| slow | 3.14 | -1.2% |" in page
    assert "| none |  |  |" in page
    assert "![mechanics](results/mechanics.png)" in page
    assert "Stability" not in page
    assert (tmp_path / "results" / "mechanics.png").stat().st_size > 5000
    found = json.loads((tmp_path / "results" / "mechanics.json").read_text())
    assert found["tables"][0]["rows"][0][1] == 3.14159  # in full
    assert found["made"]["packages"]["numpy"] == version("numpy")
    assert found["made"]["date"] in page


@pytest.mark.slow
def test_a_part_made_again_leaves_the_others(tmp_path: Path) -> None:
    for name, seconds in (("mechanics", 1.0), ("pay", 2.0), ("mechanics", 3.0)):
        results_page.write(tmp_path / "results", name, result(seconds), 1.0)
        results_page.page(tmp_path / "results", ["mechanics", "pay"], tmp_path / "RESULTS.md", "Results", "Head.")
    page = (tmp_path / "RESULTS.md").read_text()
    assert "| 3.00 |" in page
    assert "| 2.00 |" in page
    assert "| 1.00 |" not in page


def test_pareto_front() -> None:
    assert results_page.front([1, 2, 3, 4, 1], [9, 5, 7, 2, 8]) == [4, 1, 3]


def test_labels_are_not_printed_over_each_other() -> None:
    """As many as there is room for beside one point, the one elsewhere where it was, and all within the axes."""
    sheet = Figure(dpi=110)
    FigureCanvasAgg(sheet)
    axes = sheet.add_subplot()
    place = {"xytext": (4, 3), "textcoords": "offset points", "fontsize": 7}
    texts = [axes.annotate("a label", (0.5, 0.5), **place) for _ in range(12)]
    texts += [axes.annotate(*label, **place) for label in (("outside", (1.0, 1.0)), ("afar", (0.1, 0.1)))]
    (point,) = axes.plot(0.55, 0.5, "o")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    legend = axes.legend([point], ["in the way"], loc=(0.4, 0.55))
    sheet.draw_without_rendering()
    results_page.spread(axes, texts, point.get_xydata())
    left = [text for text in texts if text.axes is not None]
    assert 6 <= len(left) < 14
    boxes = [text.get_window_extent() for text in left]
    assert not any(a.overlaps(b) for a, b in combinations([*boxes, legend.get_window_extent()], 2))
    assert not any(box.contains(*axes.transData.transform((0.55, 0.5))) for box in boxes)
    assert all(axes.get_window_extent().contains(*corner) for box in boxes for corner in (box.min, box.max))
    assert texts[-1].get_position() == (4, 3)


@pytest.mark.parametrize(
    ("ends", "labels"),
    [((9, 19), "10 12 14 16 18"), ((250, 5000), "500 1000 2000 5000"), ((0.01, 90), "0.01 0.1 1 10")],
)
def test_a_logarithmic_axis_has_plain_round_ticks(ends: tuple[float, float], labels: str) -> None:
    axes = Figure().add_subplot(xscale="log", xlim=ends)
    results_page.round_ticks(axes.xaxis)
    axes.figure.draw_without_rendering()
    shown = [tick.get_text() for tick in axes.get_xticklabels() if ends[0] <= tick.get_position()[0] <= ends[1]]
    assert " ".join(shown) == labels
    assert not any(tick.get_text() for tick in axes.get_xticklabels(minor=True))


def test_answers_are_compared_from_the_last_frame_back() -> None:
    """One that went the way in more frames is compared where both have been."""
    force = np.array([[0, 0, -1.0], [0.6, 0, -0.8]])
    field = np.full((2, 3), 2.0)
    made = reference_runs.Answer(force, field, field, field, 1.0, 10, 0.0, 1.0, 5)
    finer = replace(made, force=np.concatenate([[[0, 0, -9.0]], force * [1, 1, 1.1]]), pressure=field * 1.5)
    error = made.error(finer)
    assert error.force == pytest.approx(0.1 / 1.1)  # the first frame; of the second, .08 / 1.065
    assert error.pressure == pytest.approx(1 / 3)
    assert (error.stress, error.markers) == (0, 0)


def test_a_kept_answer_depends_on_the_code_of_scene_solver_and_labels() -> None:
    """Each package has files there: a pattern that matches none would keep answers of an older solver."""
    names = [path.parent.name for path in reference_runs.source_files()]
    assert set(names) == {"benchmarks", *reference_runs.USED}
    assert {Path(solver.__file__).parent.name, "fem"} <= set(names)
    assert Path(solver.__file__) in reference_runs.source_files()


def test_matter_inside_the_indenter_is_seen_between_nodes() -> None:
    side = np.linspace(-1, 1, 3)
    grid = block(side, side, np.linspace(-2, 0, 3))
    pose = np.eye(4)
    pose[:3, 3] = 0.5, 0.5, -0.3  # the lowest point of a small ball under the middle of a cell's face
    problem = SimpleNamespace(mesh=grid, contact=SimpleNamespace(shape=SphereSdf(0.2)))
    state = SimpleNamespace(x=grid.points, pose=pose, offset=0.0)
    assert SphereSdf(0.2).distance(grid.points - pose[:3, 3])[0].min() > 0.3  # no node
    assert stability.overlap(problem, state) == pytest.approx(0.15, abs=0.051)
    state.offset = 0.3
    assert stability.overlap(problem, state) == 0


def test_shorter_frames_come_by_where_the_long_ones_end() -> None:
    made = scene_of_row.build(reference_runs.row_of((*PLAIN, *step_size_error.PATHS["rod twisted by 30 deg at once"])))
    short = step_size_error.finer(made, 4)
    assert (short.poses[3::4] == made.poses).all()
    assert (short.segment[3::4] == made.segment).all()
    steps = np.linalg.norm(np.diff(short.poses[11:], axis=0), axis=(1, 2))  # the twist
    assert len(steps) == 4
    assert steps == pytest.approx(steps.mean())


def test_a_function_runs_in_its_own_process() -> None:
    assert results_page.in_own_process("math:hypot", 3, 4) == 5.0
    with pytest.raises(RuntimeError, match="math domain error"):
        results_page.in_own_process("math:sqrt", -1)
    fine, failed = results_page.in_own_processes("math:sqrt", [(4,), (-1,)])
    assert fine == 2.0
    assert "math domain error" in str(failed)


@pytest.mark.slow
def test_a_bench_that_fails_is_reported_and_the_others_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks import optics, peers

    def fails(level: results_page.Level, say: results_page.Say) -> results_page.Result:
        raise ValueError("no such luck")

    monkeypatch.setattr(optics, "bench", fails)
    monkeypatch.setattr(peers, "bench", lambda level, say: result(1.0))
    said: list[str] = []
    assert bench.run(["optics", "peers"], tmp_path, "smoke", said.append) == ["optics"]
    assert "no such luck" in "\n".join(said)
    assert "## Peers" in (tmp_path / "RESULTS.md").read_text()


def test_an_unknown_bench_and_a_locked_folder_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("mine")
    for name, out, says in (
        ("speed", tmp_path, "speed: must be one of "),
        ("peers", tmp_path / "file", "cannot be wri"),
    ):
        assert main([name, "--smoke", "-o", str(out)]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.parametrize(("count", "surest"), [(2, 6), (8, 3)])
def test_a_references_noise_is_not_taken_for_an_error(count: int, surest: float) -> None:
    """Of any number of parts: it is ten times the error here, and a plain mean of squares would be 20 dB off."""
    from benchmarks.image_error import decibel

    camera, rng = tiny.sensor(camera={"vignette_mm": None}).camera, np.random.default_rng(4)
    truth = np.full((32, 40, 3), 0.2)
    parts = [truth + 0.04 * rng.standard_normal(truth.shape) for _ in range(count)]
    expected = -20 * np.log10(float(camera_response.slope(np.array(0.204), camera)) * 0.004)
    found, sure = decibel(1.02 * truth, parts, camera, noisy=False)
    assert sure < surest
    assert abs(found - expected) < 2 * sure
    exact, _ = decibel(1.02 * truth, [truth, truth], camera, noisy=False)
    assert exact == pytest.approx(expected, abs=1e-6)
    plain = float(camera_response.encoded(np.array(0.204), camera) - camera_response.encoded(np.array(0.2), camera))
    assert decibel(1.02 * truth, [truth, truth], camera, noisy=True)[0] == pytest.approx(-20 * np.log10(plain))


def test_chosen_pixels_stand_for_the_picture() -> None:
    from benchmarks.image_error import chosen, decibel

    camera = tiny.sensor().camera  # 40 x 32
    y, x = np.mgrid[:32, :40]
    means = []
    for seed in range(200):
        windows = np.array(chosen(camera, 60, seed))
        assert len(windows) == 63
        means.append([windows[:, 0].mean(), windows[:, 1].mean()])
    assert np.mean(means, axis=0) == pytest.approx([x.mean(), y.mean()], abs=0.05)
    there = np.zeros((32, 40), bool)
    there[windows[:, 1], windows[:, 0]] = True
    assert there.sum() == 63  # each in a cell of its own
    truth = np.where(there[..., None], 0.2, np.nan) * np.ones(3)
    picture = np.where(there, 0.21, 0.9)[..., None] * np.ones(3)
    only = decibel(np.full((32, 40, 3), 0.21), [truth, truth], camera, noisy=False)
    assert decibel(picture, [truth, truth], camera, noisy=False) == only


QUICK = {"peers"}  # the others take several scenes or processes each


def test_a_bench_has_one_thread_though_numpy_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second one would wait, and count as processor seconds."""
    seen: list[int] = []

    def threads(*_: object) -> NoReturn:
        seen.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        raise results_page.Absent("nothing to measure")

    monkeypatch.setattr(bench, "import_module", lambda name: SimpleNamespace(bench=threads))
    with threadpool_limits(2):
        assert bench.run(["peers"], tmp_path, "smoke", print) == []
    assert set(seen) == {1}


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in bench.BENCHES])
def test_each_runs(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = main([name, "--smoke", "-o", str(tmp_path)]), capsys.readouterr()
    assert code == 0, told.err
    assert told.out == f"{tmp_path / 'RESULTS.md'}\n"
    if name == "real" and not photographs.there("gelsight_mini"):
        assert "real: left out, no photographs in" in told.err
        return
    found = json.loads((tmp_path / "results" / f"{name}.json").read_text())
    assert found["tables"]
    assert all(len(row) == len(table["columns"]) for table in found["tables"] for row in table["rows"])
    assert f"## {name.capitalize()}" in (tmp_path / "RESULTS.md").read_text()


def test_a_method_is_as_fast_as_its_coarsest_mesh_from_which_on_all_are_right() -> None:
    from benchmarks.peers import Runs

    meshes, seconds, forces = ["2", "1", ".5", ".2"], [0.1, 0.2, 0.4, 0.8], [1, 1.02, 1.005, 1]
    runs = Runs("by luck right at first", meshes, [1, 2, 3, 4], seconds, forces)
    assert runs.cheapest(1.0) == 0.4
    assert runs.cheapest(1.1) is None


def test_every_line_of_pay_is_a_scene() -> None:
    for outputs, sets in cost_per_output.ASKED.values():
        assert len(cost_per_output.rows_of(outputs, list(sets))) == 1


def test_the_page_is_that_of_the_results(tmp_path: Path) -> None:
    """`make bench` writes it; one that was touched since is told here."""
    shutil.copytree(ROOT / "docs" / "results", tmp_path / "results")
    head = f"{bench.HEAD}\n\n{summary.short(tmp_path / 'results')}"
    results_page.page(tmp_path / "results", bench.PARTS, tmp_path / "RESULTS.md", "Results", head)
    assert (tmp_path / "RESULTS.md").read_text() == (ROOT / "docs" / "RESULTS.md").read_text()
    names = [path.stem for path in (tmp_path / "results").glob("*.json") if not path.stem.startswith("referee")]
    bench._refuse_foreign(names, tmp_path)  # they are known as a bench's own


def test_a_summary_leaves_out_what_is_not_there(tmp_path: Path) -> None:
    row = ["gelsight_mini", "default", 5000, 10.0, 0.5, 0.0042, 0.041, 0.1, 0.02, 0.01]
    heads = results_page.columns("sensor", "quality", *mechanics.WORK, *mechanics.ERRORS, "area: +.1%")
    presets = results_page.Table("Presets on every sensor", heads, [row])
    together = results_page.Table("Together", results_page.columns("scenes: d"), [[3]])
    for name, table in (("mechanics", presets), ("stability", together)):
        results_page.write(tmp_path, name, results_page.Result("", [table]), 1.0)
    told = summary.short(tmp_path)
    assert "| force error of `default` against `reference` | Mini 0.4% | mechanics |" in told
    assert "stability" not in told


def test_figures_of_another_machine_name_it(tmp_path: Path) -> None:
    usual = {"made": {"processor": "Usual", "cores": 2}, "tables": []}
    heads = ["scenes of", "quality", "scenes", "J <= 0", "ok", "compared", *ordinary.STATUSES[1:]]
    together = {"title": "Together", "columns": heads, "rows": [["ordinary", "draft", 3, 0, 0, 0, 0, 0, 0, 0]]}
    other = {"made": {"processor": "Other", "cores": 64}, "tables": [together]}
    for name, found in {"mechanics": usual, "pipeline": usual, "ordinary": other}.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(found))
    assert "| ordinary, on Other, 64 cores |" in summary.short(tmp_path)


def test_the_summary_of_a_frame_names_every_stage(tmp_path: Path) -> None:
    stages = {stage: 10.0 * k for k, stage in enumerate(pipeline.STAGES, 1)}
    one = {"stages": {k: v / 1000 for k, v in stages.items()}, "total": 0.2, "size": 3e6, "memory": 500.0}
    found = {("digit", "draft", what): one for what in ("force, rgb", "everything")}
    results_page.write(tmp_path, "pipeline", results_page.Result("", [pipeline._stages(found)]), 1.0)
    told = summary.short(tmp_path)
    assert "(solve / labels / images / writing) | DIGIT 0.20 (0.02 / 0.03 / 0.04 / 0.05) |" in told
    assert "| GB of a million frames, force, rgb | DIGIT 3000 |" in told


@pytest.mark.slow
def test_a_frame_is_timed_by_stage_and_output_and_weighed_by_dataset() -> None:
    found = results_page.in_own_process(
        "benchmarks.pipeline:made", "gelsight_mini", pipeline.SMOKE, "traction", pipeline.FEW
    )
    assert 0.3 * found["total"] < sum(found["stages"].values()) <= found["total"] * 1.001
    assert set(found["outputs"]) == {"force", "traction", "positions"}
    assert 0.5 * found["stages"]["fields"] < sum(found["outputs"].values()) <= found["stages"]["fields"] * 1.001
    assert max(found["bytes"], key=lambda path: found["bytes"][path]) == "/frames/traction"
    assert sum(found["bytes"].values()) < found["size"]
    assert found["memory"] > 50


def test_a_bench_without_what_it_needs_leaves_what_there_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_REFERENCE", str(tmp_path))
    results_page.write(tmp_path / "results", "real", result(1.0), 1.0)
    said: list[str] = []
    assert bench.run(["real"], tmp_path, "smoke", said.append) == []
    assert said == [f"real: left out, no photographs in {tmp_path} (set TACGEN_REFERENCE)"]
    assert json.loads((tmp_path / "results" / "real.json").read_text())["tables"][0]["rows"][0][1] == 1.0


@pytest.mark.parametrize("sensor", pipeline.DEPTHS)
def test_everything_is_what_a_recipe_can_ask_of_that_sensor(sensor: str) -> None:
    asked = pipeline.row(sensor, "draft", pipeline.EVERYTHING, pipeline.FEW).recipe.outputs
    assert asked >= {"force", "traction", "stress", "flow", "radiance", "rgb"}
    assert ("markers" in asked) == (sensor == "gelsight_mini")


@pytest.mark.parametrize("name", ["RESULTS.md", "results/peers.json", "results/peers.png"])
def test_a_file_that_no_bench_wrote_is_not_replaced(tmp_path: Path, name: str) -> None:
    (place := tmp_path / name).parent.mkdir(exist_ok=True)
    place.write_text("mine")
    with pytest.raises(UserError, match=f"{name}: was not written by python -m benchmarks"):
        bench.run(["peers"], tmp_path, "smoke", print)
    assert place.read_text() == "mine"
