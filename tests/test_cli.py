"""Commands, through Typer's runner: what is said where, and the exit code. The engine is a stand-in here."""

import csv
import errno
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.command import refused, tacgen_, told

import tacgen.batch
from tacgen.base import array_cache
from tacgen.base.compiled import COMPILED_ENTRY
from tacgen.batch.local import outcome
from tacgen.batch.probe import PlanCost
from tacgen.bundle.resume import SceneResult
from tacgen.recipe import assets, loading, plan, schema
from tacgen.report import dataset_card
from tacgen.report.estimate import Made, cost
from tacgen.sensor.usual_values import unsourced

ROOT = Path(__file__).parent.parent
Batch = Callable[..., list[SceneResult]]


@pytest.fixture
def batch(monkeypatch: pytest.MonkeyPatch) -> Callable[[Batch], None]:
    """Put a function in the place of `batch.run`, whose bundles nobody looks for."""

    def stand_in(run: Batch) -> None:
        monkeypatch.setattr(tacgen.batch, "run", run)
        monkeypatch.setattr(dataset_card, "write", lambda folder, known: folder)

    return stand_in


def raising(error: BaseException) -> Callable[..., Any]:
    def run(*args: Any, **kwargs: Any) -> Any:
        raise error

    return run


def all_ok(plan: Any, folder: Path, *, on_event: Callable[[dict[str, Any]], None], **_: Any) -> list[SceneResult]:
    results = []
    for row in plan.rows:
        for i in range(row.frames):
            on_event({"event": "frame", "scene": row.name, "frame": i + 1, "frames": row.frames})
        results.append(SceneResult(row.name, folder / f"{row.name}.h5", "ok", "", row.frames, {"solve": 1.0}))
        on_event(outcome(results[-1]))
    return results


def test_the_version_is_told():
    assert tacgen_("--version").stdout == f"tacgen {tacgen.__version__}\n"


def test_run_says_progress_on_stderr_and_the_outcome_on_stdout(tmp_path: Path, batch: Any):
    batch(all_ok)
    done = tacgen_("run", "quickstart", "-o", tmp_path / "a" / "b")
    assert done.exit_code == 0, done.stderr
    assert done.stdout == f"{tmp_path}/a/b: 1 scene kept, 0 rejected\n"
    assert "scene-00000: frame 3 of 15 (about " in done.stderr
    assert "scene-00000: ok" in done.stderr


def test_run_prints_events_as_json(tmp_path: Path, batch: Any):
    batch(all_ok)
    done = tacgen_("run", "quickstart", "-o", tmp_path, "--json")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert [event["event"] for event in events] == ["frame"] * 15 + ["scene", "end"]
    assert events[2] == {"event": "frame", "scene": "scene-00000", "frame": 3, "frames": 15}
    assert events[-2]["path"] == str(tmp_path / "scene-00000.h5")
    assert events[-1] == {"event": "end", "folder": str(tmp_path), "ok": 1, "rejected": 0, "failed": 0}


def test_rejected_and_failed_scenes_are_exit_code_1(tmp_path: Path, batch: Any):
    def run(plan: Any, folder: Path, **_: Any) -> list[SceneResult]:
        return [
            SceneResult("scene-00000", folder / "x.h5", "rejected", "frame 7 of 15: the solver stalled", 15),
            SceneResult("scene-00001", folder / "y.h5", "failed", "its worker was killed by SIGSEGV", 15),
        ]

    batch(run)
    done = tacgen_("run", "quickstart", "-o", tmp_path)
    assert done.exit_code == 1
    assert done.stdout.splitlines() == [
        "scene-00000: rejected: frame 7 of 15: the solver stalled",
        "scene-00001: failed: its worker was killed by SIGSEGV",
        f"{tmp_path}: 0 scenes kept, 1 rejected, 1 failed",
    ]


def test_what_is_asked_for_reaches_the_engine(tmp_path: Path, batch: Any):
    seen: dict[str, Any] = {}

    def run(plan: Any, folder: Path, **options: Any) -> list[SceneResult]:
        seen.update(options, rows=plan.rows)
        return []

    batch(run)
    sets = ("--set", "start.x_mm=3", "--set", "sensor.camera.exposure=2")
    more = ("--workers", "3", "--shard", "1/4", "--silence-s", "60", "--memory-gb", "2", "--overwrite")
    assert tacgen_("run", "batch", "-o", tmp_path, *sets, *more).exit_code == 0
    assert (seen["workers"], seen["shard"], seen["overwrite"]) == (3, (1, 4), True)
    assert (seen["limits"].silence_s, seen["limits"].memory_gb) == (60.0, 2.0)
    assert [row.index for row in seen["rows"]] == [1, 5]
    assert seen["rows"][0].sensor.camera.exposure == 2.0
    whole = plan.load(assets.recipe_path("batch"), [sets[1], sets[3]]).rows
    assert [row.key for row in seen["rows"]] == [whole[1].key, whole[5].key]


@pytest.fixture
def timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A probe that takes no time."""

    def probe(plan: Any, workers: int, on_event: Any) -> PlanCost:
        found = cost(plan.frames, [Made(6, 3.0, 0.01), Made(6, 5.0, 0.01)])
        assert found is not None
        return PlanCost(found, 0.4)

    monkeypatch.setattr("tacgen.batch.probe.probe", probe)


def test_a_dry_run_writes_nothing_and_says_what_it_would_cost(tmp_path: Path, timed: None):
    said = told("run", "batch", "-o", tmp_path / "out", "--dry-run", "--workers", "4")
    assert "would hold 8 scenes of batch, 48 frames\nabout 32 s of one core (0 s to 88 s), 8 s with 4" in said
    assert not (tmp_path / "out").exists()


def test_a_plan_s_cost(timed: None):
    said = told("plan", "batch", "--estimate", "-j", "1")
    assert said.startswith("8 scenes of batch: about 32 s of one core (0 s to 88 s); 0.08 GB (0.08 to 0.08); ")
    plain = json.loads(told("plan", "batch", "--estimate", "--json", "--workers", "auto"))
    assert plain["seconds"][0] == 32.0
    assert plain["workers"] >= 1
    assert "4 s with 8 workers" in told("plan", "batch", "--estimate", "--workers", "16"), "of eight scenes"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("run", "recpie", "-o", "x"), "no recipe is called 'recpie'"),
        (("run", "no/such.yaml", "-o", "x"), "no/such.yaml: no such recipe file"),
        (("run", "quickstart", "-o", "x", "--set", "sensor=digot"), "--set sensor=digot: sensor: no sensor is called"),
        (("validate", str(ROOT)), "is a folder, not a file"),
        (("run", "quickstart", "-o", "x", "--workers", "0"), "--workers 0: must be a number from 1, or auto"),
        (("list", "shape"), "shape: unknown kind, did you mean shapes?; there are: sensors, recipes, objects, shapes"),
        (("check", "no/such/folder"), "no/such/folder: no such file or folder"),
        (("show", "no.h5"), "no.h5: No such file"),
        (("run", "quickstart", "-o", "x", "--ovrwrite"), "No such option"),
        (("run", "quickstart", "-o", "x", "--shard", "4/4"), "--shard 4/4: must be I/N with I from 0 to N - 1"),
        (("run", "quickstart", "-o", "x", "--shard", "0/99999999999999999999"), "must be I/N with I from 0 to N - 1"),
        (("run", "quickstart", "-o", "x", "--shard", f"0/{5000 * '9'}"), "must be I/N with I from 0 to N - 1"),
        (("run", "quickstart", "-o", "x", "--workers", 5000 * "9"), "must be a number from 1, or auto"),
        (("validate", "~nosuchuser/x.yaml"), "~nosuchuser/x.yaml: no such recipe file"),
        (("check", "a\0b"), "an argument holds a NUL character"),
        (("run", "quickstart", "-o", "a\0b"), "an argument holds a NUL character"),
        (("status", "no/such"), "no/such: no such folder"),
        (("status", "recipes"), "recipes: holds no plan.json"),
    ],
)
def test_a_mistake_is_exit_code_2_and_lines_on_stderr(args: tuple[str, ...], says: str):
    done = tacgen_(*args)
    assert done.exit_code == 2, done.output
    assert says in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("out", ["file", "file/below", "/proc/nowhere/out"])
def test_an_output_folder_that_cannot_be_written_is_one_line(tmp_path: Path, batch: Any, out: str):
    batch(raising(AssertionError("found out only after solving")))
    (tmp_path / "file").write_text("")
    (line,) = refused("run", "quickstart", "-o", tmp_path / out).splitlines()
    assert "cannot be written: " in line


def test_a_disk_that_fills_up_on_the_way_is_one_line(tmp_path: Path, batch: Any):
    batch(raising(OSError(errno.ENOSPC, "No space left on device")))
    said = refused("run", "quickstart", "-o", tmp_path)
    assert said == f"{tmp_path}: cannot be written: No space left on device\n"


def in_compiled_code(cause: BaseException) -> SystemError:
    """What Numba makes of an error in Python code that it calls."""
    error = SystemError("returned a result with an exception set")
    error.__cause__ = cause
    return error


INTERRUPTS = [KeyboardInterrupt(), in_compiled_code(KeyboardInterrupt())]


@pytest.mark.parametrize("stop", INTERRUPTS)
def test_an_interrupt_is_exit_code_130(tmp_path: Path, batch: Any, stop: BaseException):
    batch(raising(stop))
    done = tacgen_("run", "quickstart", "-o", tmp_path)
    assert done.exit_code == 130
    assert done.stderr.splitlines()[-1].startswith("interrupted; ")


@pytest.mark.parametrize("stop", [*INTERRUPTS, in_compiled_code(MemoryError())])
def test_without_threads_memory_is_out(
    tmp_path: Path, batch: Any, stop: BaseException, monkeypatch: pytest.MonkeyPatch
):
    """OpenBLAS raises the signal of Ctrl-C when it cannot start its threads."""
    monkeypatch.setattr("threading.Thread.start", raising(RuntimeError("can't start new thread")))
    batch(raising(stop))
    assert refused("run", "quickstart", "-o", tmp_path).splitlines()[-1].startswith("out of memory")


@pytest.mark.parametrize(
    ("scarce", "says"),
    [
        (OSError(errno.EMFILE, "Too many open files", "x.h5"), "x.h5: Too many open files"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (MemoryError(), "out of memory"),
        (ImportError("x.so: failed to map segment from shared object"), "out of memory"),
    ],
)
def test_what_the_machine_lacks_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scarce: Any, says: str):
    monkeypatch.setattr("tacgen.bundle.check.check", raising(scarce))
    (line,) = refused("check", tmp_path).splitlines()
    assert line.startswith(says)


@pytest.mark.parametrize("bug", [ZeroDivisionError("bug"), OSError(errno.EBADF, "bug"), SystemError("bug")])
def test_a_bug_keeps_its_traceback(tmp_path: Path, batch: Any, bug: Exception):
    batch(raising(bug))
    assert tacgen_("run", "quickstart", "-o", tmp_path).exception is bug


def test_validate_tells_recipes_and_sensors_apart(tmp_path: Path):
    assert "a valid recipe, batch: 8 scenes, sensor gelsight_mini" in told("validate", "batch")
    all_of_them = "a valid recipe, sensor_pairs: 6 scenes, sensors gelsight_mini, digit, ninedtact\n"
    assert all_of_them in told("validate", "sensor_pairs")
    assert "1 scene, sensors gelsight_mini, digit\n" in told("validate", "grasp")
    sensor = assets.sensor_path("gelsight_mini")
    assert told("validate", sensor) == f"{sensor}: a valid sensor, gelsight_mini\n"
    assert "is a sensor file, not a recipe" in refused("plan", sensor)
    bad, text = tmp_path / "s.yaml", sensor.read_text()
    bad.write_text(text.replace("poissons_ratio: 0.49", "poissons_ratio: 0.5"))
    assert "gel.layers[0].poissons_ratio: must be less than 0.5 (got 0.5)" in refused("validate", bad)
    bad.write_text(text.replace("tacgen_sensor: 1", ""))
    assert refused("validate", bad).startswith(f"{bad}:1:1: tacgen_sensor: is missing\n")
    bad.write_text("tacgen: 1\nname: x\n")
    assert "trajectory (a list), outputs" in refused("validate", bad)


def test_compilation_is_said_once(batch: Callable[[Batch], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    load = plan.load

    def compiling(*args: Any) -> plan.Plan:
        array_cache.tell(COMPILED_ENTRY)
        array_cache.tell(COMPILED_ENTRY)
        return load(*args)

    def run(plan: Any, folder: Path, *, on_event: Callable[[dict[str, Any]], None], **more: Any) -> list[SceneResult]:
        on_event({"event": "compiling", "scene": plan.rows[0].name})
        return all_ok(plan, folder, on_event=on_event, **more)

    monkeypatch.setattr(plan, "load", compiling)
    batch(run)
    for _ in range(2):  # commands in one process do not share it
        assert tacgen_("run", "quickstart", "-o", tmp_path).stderr.count("compiling") == 1
    assert tacgen_("validate", "quickstart").stderr.count("compiling") == 1


def test_plan_prints_text_csv_and_json(monkeypatch: pytest.MonkeyPatch):
    assert told("plan", "batch").splitlines()[0].split()[:3] == ["scene", "frames", "seed"]
    table = list(csv.DictReader(told("plan", "batch", "--csv").splitlines()))
    rows = plan.load(assets.recipe_path("batch")).rows
    assert [float(line["start.x_mm"]) for line in table] == [row.values["start.x_mm"] for row in rows]
    found = json.loads(told("plan", "batch", "--json"))
    assert [(scene["key"], scene["values"]) for scene in found["scenes"]] == [(row.key, row.values) for row in rows]
    monkeypatch.setenv("COLUMNS", "80")
    many = told("plan", "domain_randomised").splitlines()
    assert max(map(len, many)) <= 80
    heads = [line.split() for line in many if line.split()[:1] == ["scene"]]
    assert [head[1] for head in heads[:2]] == ["frames", "start.x_mm"]  # as much of the path as is unique
    assert sum(len(head) - 1 for head in heads) == 2 + len(plan.load(assets.recipe_path("domain_randomised")).paths)
    assert "cylinder radius_mm=3 fillet_mm=0.5" in "\n".join(many)
    long = told("plan", "batch", "--set", "vary.samples=50").splitlines()
    assert long[-1] == "... 30 more (--csv prints all)"  # two blocks of 20 rows


def test_init_writes_a_sensor_that_validates_and_renders_where_it_is_lit(tmp_path: Path) -> None:
    path = tmp_path / "new" / "mine.yaml"
    assert tacgen_("init", "--sensor", path).exit_code == 0
    text = path.read_text()
    assert text.startswith("# yaml-language-server: $schema=tacgen-sensor.schema.json\n")
    assert f"#   tacgen validate {path}\n" in text
    assert "leds" in json.loads((path.parent / "tacgen-sensor.schema.json").read_text())["properties"]
    done = tacgen_("validate", path)
    assert (done.exit_code, done.stderr) == (0, "")
    lit = re.sub(r"^# (?=plate:|coating:|walls:|leds:|  - )", "", text, flags=re.M)
    assert lit.count("#") == text.count("#") - 7
    path.write_text(lit)
    assert loading.read_sensor(path)[0].lit


def test_missing_sources_give_one_warning(tmp_path: Path) -> None:
    """Of a sensor file alone and of a recipe's; those that ship say where theirs are from."""
    for name in assets.list_sensors():
        assert unsourced(loading.read_sensor(assets.sensor_path(name))[0]) == []
    bare = re.sub(r"\n *source: .*", "", Path(schema.__file__).with_name("starter_sensor.yaml").read_text(), count=2)
    (tmp_path / "mine.yaml").write_text(bare)
    text = f"warning: {tmp_path}/mine.yaml: gel.layers[0], gel: no source; say where the numbers come from"
    assert tacgen_("validate", tmp_path / "mine.yaml").stderr.startswith(text)
    (tmp_path / "r.yaml").write_text(
        f"extends: {assets.recipe_path('batch')}\nsensor: mine.yaml\noutputs: [force]\n"
        "vary: {grid: {sensor: {choice: [mine.yaml, digit]}}}\n"
    )
    done = tacgen_("validate", tmp_path / "r.yaml")
    assert (done.exit_code, done.stderr.count("warning")) == (0, 1), done.stderr
    assert done.stderr.startswith(text)


def test_all_that_a_sensor_file_lacks_is_reported_at_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("tacgen_sensor: 1\nname: mine\ngel: {width_mm: 20}\nleds: [{name: red}]\n")
    said = [line for line in refused("validate", path).splitlines() if line.startswith(str(path))]
    assert [line.removeprefix(f"{path}:") for line in said] == [
        "1:1: camera: is missing (distance_mm, mm_per_px, width_px, height_px)",
        "1:1: plate: is missing, and leds is there (thickness_mm, refractive_index)",
        "1:1: coating: is missing, and leds is there (albedo, specular, roughness)",
        "1:1: walls: is missing, and leds is there (albedo)",
        "3:1: gel: lacks height_mm, layers (a list, each with name, thickness_mm, youngs_modulus_mpa, poissons_ratio)",
        "4:8: leds[0]: lacks center_mm, normal, size_mm, radiance",
    ]


def test_init_writes_a_recipe_that_validates_with_its_schema(tmp_path: Path):
    path = tmp_path / "new" / "mine.yaml"
    told("init", path)
    assert path.read_text().startswith("# yaml-language-server: $schema=tacgen.schema.json\n")
    assert "extends" in json.loads((path.parent / "tacgen.schema.json").read_text())["properties"]
    told("validate", path)


def test_schemas_name_every_shape_and_unit():
    recipe = json.loads(told("schema"))
    assert set(recipe["properties"]["indenter"]["discriminator"]["mapping"]) >= {"sphere", "torus"}
    assert recipe["additionalProperties"] is False
    assert "gel" in json.loads(told("schema", "--sensor"))["properties"]


def test_list_names_what_there_is():
    everything = told("list")
    assert [word for word in ("gelsight_mini", "quickstart", "torus", "objects:") if word not in everything] == []
    assert list(json.loads(told("list", "sensors", "--json"))) == ["sensors"]
    assert "torus" not in told("list", "sensors")
    assert "Head of an M5 bolt" in told("list", "objects")


def test_check_prints_findings_and_exits_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from tacgen.bundle import check

    found = [check.Finding(tmp_path / "a.h5", "error", "frame 3 holds nan")]
    monkeypatch.setattr(check, "check", lambda path: found)
    done = tacgen_("check", tmp_path)
    assert (done.exit_code, done.stdout) == (1, f"{tmp_path}/a.h5: error: frame 3 holds nan\n")
    assert json.loads(tacgen_("check", tmp_path, "--json").stdout)[0]["message"] == "frame 3 holds nan"
    found = [check.Finding(tmp_path / "a.h5", "note", "touches in no frame")]
    said = f"{tmp_path}/a.h5: note: touches in no frame\n{tmp_path}: nothing found wrong\n"
    assert told("check", tmp_path) == said, "a note is not wrong"
    found = []
    assert told("check", tmp_path) == f"{tmp_path}: nothing found wrong\n"
