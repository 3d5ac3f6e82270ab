"""Results in the place of somebody's files: what is read, foreign or edited stays, and nothing leaves its folder."""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command import tacgen_
from helpers.export_scenes import SENSOR, SHAPE, needs_package_of, real
from helpers.scenes import make_plan
from helpers.small_recipe import BALL
from helpers.synthetic import OUTPUTS, attributes, write

from hostile.attempts import LOG_TABLE
from tacgen import batch, replay
from tacgen.base import atomic_file, output_file, regular_file
from tacgen.base.errors import UserError
from tacgen.bundle.resume import SceneResult
from tacgen.export import EXPORTERS, export
from tacgen.recipe import assets
from tacgen.replay import comparison
from tacgen.replay.comparison import Compared
from tacgen.replay.contact_log import Conventions

KEY = "0" * 64
REPLAYED = f"{BALL}outputs: [force]\nquality: draft\ntrajectory: [{{replay: {{file: x.csv}}}}]\n"


def command(*args: object) -> tuple[int, str]:
    """Exit code and stderr."""
    done = tacgen_(*args)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stderr


def refused(says: str, *args: object) -> None:
    """A line and exit code 2, and no file below the working folder is changed, made or removed."""
    before = content(Path.cwd())
    code, said = command(*args)
    assert (code, len(said.splitlines())) == (2, 1), said
    assert says in said
    assert content(Path.cwd()) == before


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")

    def edit(index: int, arrays: dict[str, Any]) -> None:
        real(index, arrays)
        arrays["/frames/radiance"] = arrays["/frames/rgb"] / 255

    for number in range(2):
        known = {"scene_index": number, "sensor_document": SENSOR, "input_key": KEY}
        write(folder / f"scene-{number:05d}.h5", shape=SHAPE, outputs=OUTPUTS, frames=6, edit=edit, **known)
    return folder


# --- replay


@pytest.mark.parametrize("name", ["forces.csv", "forces.txt", "log-00000.csv"])
def test_a_replay_beside_its_log_keeps_the_log(name: str) -> None:
    Path(name).write_text(LOG_TABLE)
    Path("r.yaml").write_text(REPLAYED)
    refused("is an input", "replay", name, "--recipe", "r.yaml", "-o", ".", "--overwrite")


def test_a_replay_does_not_write_its_bundle_over_its_log() -> None:
    import h5py

    with h5py.File("scene-00000.h5", "w") as file:
        file["time"], file["units"], file["quaternion"] = np.arange(4.0), "mm", "wxyz"
        file["object_position"] = np.array([[0, 0, z] for z in (6, 4.2, 3.8, 3.6)])
        file["object_quaternion"] = np.tile([1.0, 0, 0, 0], (4, 1))
    Path("r.yaml").write_text(REPLAYED)
    refused("has the name of a bundle", "replay", "scene-00000.h5", "--recipe", "r.yaml", "-o", ".", "--overwrite")


def prepared(**options: Any) -> replay.Prepared:
    return replay.prepare([Path("log.csv")], "r.yaml", Path("out"), Conventions(), replay.Choice(), **options)


def found(made: replay.Prepared, force: float) -> list[Compared]:
    (log,) = made.logs
    ours = np.full((len(log), 3), force)
    return [Compared(log, "scene-00000", "", ours, ours, None, log.force)]


@pytest.mark.parametrize("name", ["forces.csv", "forces.png", "recipe.yaml"])
def test_results_of_a_replay_are_replaced_until_somebody_edits_them(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacgen.report.force_figure.draw", lambda drawn, out: output_file.add(out, repr(drawn)))
    Path("log.csv").write_text(LOG_TABLE)
    Path("r.yaml").write_text(REPLAYED)
    made = prepared()
    comparison.write(found(made, 1.0), Path("out"))
    first = content(Path("out"))
    comparison.write(found(prepared(), 2.0), Path("out"))  # what was rejected at first is there now
    assert (second := content(Path("out"))) != first
    with Path("out", name).open("ab") as file:
        file.write(b"# a note")
    with pytest.raises(UserError, match=rf"{name}: is there already; --overwrite replaces it"):
        prepared()
    if name in comparison.COMPARISON_FILES:
        with pytest.raises(UserError, match="is there already"):
            comparison.write(found(made, 2.0), Path("out"))
    assert content(Path("out")) == second | {name: second[name] + b"# a note"}
    comparison.write(found(prepared(overwrite=True), 2.0), Path("out"), overwrite=True)
    assert content(Path("out")) == second


# --- init


def theirs(folder: Path, **named: str) -> Path:
    """A recipe of somebody's that replays a table, extends another recipe and has a sensor of its own."""
    for path in ("poses.csv", "sub/poses.csv", "../../poses.csv"):
        (place := folder / path).parent.mkdir(parents=True, exist_ok=True)
        place.write_text(LOG_TABLE)
    (folder / "base.yaml").write_text(
        f"{BALL}outputs: [force]\nsensor: units/mine.yaml\n".replace("\nsensor: gel", "\n#")
    )
    (folder / "units").mkdir(exist_ok=True)
    shutil.copy(assets.sensor_path("gelsight_mini"), folder / "units" / "mine.yaml")
    file = named.get("file", "sub/poses.csv")
    (folder / "r.yaml").write_text(
        f"extends: base.yaml # with a ball\ntrajectory: [{{replay: {{file: {file}}}}}] # one\n"
    )
    return folder / "r.yaml"


def test_init_copies_what_a_recipe_names_in_its_folder() -> None:
    start = theirs(Path("a/b/c"))
    assert command("init", "--from", start, "x/y/mine.yaml") == (0, "")
    made = {"mine.yaml", "base.yaml", "units/mine.yaml", "sub/poses.csv", "tacgen.schema.json"}
    assert content(Path("x/y")).keys() == made
    assert command("validate", "x/y/mine.yaml") == (0, "")
    assert Path("x/y/mine.yaml").read_text().endswith("]  # one\n".replace("  ", " "))


@pytest.mark.parametrize("file", ["../../poses.csv", '"../../poses.csv"', "'sub/../../../poses.csv'", "link/poses.csv"])
def test_init_writes_nothing_out_of_the_new_folder(file: str) -> None:
    start = theirs(Path("a/b/c"), file=file)
    Path("a/b/c/link").symlink_to(Path.cwd() / "a")
    before = content(Path.cwd())
    assert command("init", "--from", start, "x/y/z/mine.yaml") == (0, "")
    assert all(name.startswith("x/y/z/") for name in content(Path.cwd()).keys() - before.keys())
    assert content(Path.cwd()).items() >= before.items()
    assert str(Path.cwd() / "a/poses.csv") in Path("x/y/z/mine.yaml").read_text()
    assert command("validate", "x/y/z/mine.yaml") == (0, "")


def test_init_follows_no_link_out_of_the_new_folder() -> None:
    start = theirs(Path("a/b/c"))
    Path("home").mkdir()
    Path("x").mkdir()
    Path("x/sub").symlink_to(Path.cwd() / "home")
    refused("leads out of x", "init", "--from", start, "x/mine.yaml")
    refused("leads out of x", "init", "--from", start, "x/mine.yaml", "--overwrite")


def test_init_beside_the_original_touches_nothing_of_it() -> None:
    start = theirs(Path("a/b/c"))
    (link := Path("other")).symlink_to(start.parent)
    for place in (start.parent, link):
        for flag in ([], ["--overwrite"]):
            before = content(start.parent)
            assert command("init", "--from", start, place / f"copy{len(before)}.yaml", *flag) == (0, "")
            assert content(start.parent).items() >= before.items()
    for name in ("r.yaml", "base.yaml"):
        refused("is an input", "init", "--from", start, start.parent / name, "--overwrite")


def test_init_does_not_give_two_files_one_name_and_a_schema_of_somebody_s_stays() -> None:
    start = theirs(Path("a/b/c"))
    refused("choose another name", "init", "--from", start, "x/base.yaml")
    Path("x").mkdir()
    Path("x/base.yaml").write_text("mine")
    refused("x/base.yaml: is there already; --overwrite replaces it", "init", "--from", start, "x/mine.yaml")
    Path("tacgen.schema.json").write_text('{"$schema": "http://json-schema.org", "title": "mine"}')
    refused("tacgen.schema.json: is there already", "init", "mine.yaml")


def test_init_waits_for_no_pipe() -> None:
    start = theirs(Path("a/b/c"))
    os.mkfifo("pipe.yaml")
    refused("not a regular file", "init", "--from", "pipe.yaml", "x/mine.yaml")
    start.with_name("base.yaml").unlink()
    os.mkfifo(start.with_name("base.yaml"))
    refused("not a regular file", "init", "--from", start, "x/mine.yaml")


@pytest.mark.parametrize("name", ["two\nlines", "a: b", "123", "\N{GRINNING FACE}\x7f"])
def test_init_writes_files_of_any_name_to_folders_of_any_name(name: str) -> None:
    (start := Path(name, "a", "r.yaml")).parent.mkdir(parents=True)
    Path(name, "base.yaml").write_text("extends: quickstart\n")
    start.write_text("extends: ../base.yaml\n")
    assert command("init", "--from", start, Path("b", name, f"{name}.yaml")) == (0, "")
    assert command("validate", Path("b", name, f"{name}.yaml"))[0] == 0
    assert command("init", "--sensor", "--from", "digit", Path("b", name, f"s{name}.yaml")) == (0, "")
    assert command("validate", Path("b", name, f"s{name}.yaml"))[0] == 0


# --- pages, pictures and exports


def data(scenes: Path) -> Path:
    shutil.copytree(scenes, "data")
    Path("data/journal.jsonl").write_text('{"time": "1", "run": "a"}\n')
    rows = [{"scene": f"scene-0000{k}", "frames": 6, "key": KEY, "values": {}} for k in range(2)]
    Path("data/plan.json").write_text(f'{{"name": "x", "scenes": [\n{json.dumps(rows)[1:]}}}\n')
    Path("data/README.md").write_bytes(output_file.signed("# a card"))
    return Path("data")


@pytest.mark.parametrize("name", ["journal.jsonl", "plan.json", "README.md", "scene-00001.h5"])
def test_a_report_does_not_replace_a_part_of_its_data_set(scenes: Path, name: str) -> None:
    folder = data(scenes)
    for words in (("report", folder), ("view", folder)):
        for flag in ([], ["--overwrite"]):
            refused("belongs to the data set that is read", *words, "-o", folder / name, *flag)


def test_what_a_command_has_read_is_not_replaced(tmp_path: Path) -> None:
    """Of whatever kind it is, under whatever name, whenever it was read."""
    (path := tmp_path / "ball.stl").write_text("x")
    os.link(path, other := tmp_path / "other.png")

    def replaced(early: bool) -> None:
        if early:
            regular_file.read_bytes(path, 10)
        with output_file.written(other, overwrite=True) as new:
            new.write_text("y")
            regular_file.read_bytes(path, 10)

    for early in (True, False):
        with regular_file.noting(), pytest.raises(UserError, match="is an input of this command"):
            replaced(early)
    assert path.read_text() == "x"
    with output_file.written(path, overwrite=True) as new:  # another command may
        new.write_text("y")


def test_what_appears_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    def late() -> None:
        with output_file.written(tmp_path / "a.txt") as new:
            new.write_text("ours")
            (tmp_path / "a.txt").write_text("theirs")

    with pytest.raises(UserError, match="is there already"):
        late()
    assert (tmp_path / "a.txt").read_text() == "theirs"


def test_a_link_in_the_place_of_what_is_being_written_is_not_followed(tmp_path: Path) -> None:
    (mine := tmp_path / "mine").write_text("mine")
    (tmp_path / ".a.tacgen-new.txt").symlink_to(mine)
    output_file.put(tmp_path / "a.txt", b"new")
    assert (mine.read_text(), (tmp_path / "a.txt").read_text()) == ("mine", "new")


def test_two_results_are_two_files() -> None:
    Path("f.csv").write_text("depth_mm,force_n\n0.1,0.1\n0.5,1.0\n")
    words = ["calibrate", "material", "--sensor", "gelsight_mini", "--recipe", "quickstart", "--data", "f.csv"]
    refused("two results", *words, "-o", "a.png", "--plot", "./a.png")


ODD = "run 50% %d a:b [a]{b}*? #c?d $\\bad$ ~ \N{GRINNING FACE} two\nlines"


@pytest.mark.parametrize("kind", EXPORTERS)
def test_exports_go_to_folders_of_any_name(scenes: Path, kind: str) -> None:
    needs_package_of(kind)
    made = export(kind, scenes / "scene-00000.h5", Path("out", ODD))
    assert all(path.is_file() for path in made)
    assert os.listdir("out") == [ODD]


def test_pictures_and_pages_have_any_name(scenes: Path) -> None:
    recipe = attributes()["recipe"] | {"name": ODD.partition("~")[0]}
    write(Path(f"{ODD}.h5"), recipe=recipe, frames=1, outputs=frozenset({"force"}))
    for words in (["view", f"{ODD}.h5", "-o", f"-{ODD}.html"], ["show", f"{ODD}.h5", "-o", f"./{ODD}.png"]):
        assert command(*words) == (0, "")
        assert Path(words[-1]).stat().st_size


# --- runs


def outcome(results: list[SceneResult] | None = None) -> Callable[..., Any]:
    """In the place of an engine: makes nothing."""

    @contextmanager
    def engine(*_: Any) -> Iterator[Callable[..., Any]]:
        yield lambda rows, folder, **options: results or []

    return engine


def test_two_recipes_do_not_share_a_folder_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second says so before it writes anything; another shard of the same plan may join."""
    one, other = make_plan(tmp_path, 6, (0, 3)), make_plan(tmp_path, 7, (1, 3))
    tried: list[str] = []

    @contextmanager
    def engine(*_: Any) -> Iterator[Callable[..., Any]]:
        def make(rows: Any, folder: Path, **options: Any) -> list[SceneResult]:
            before = (folder / "plan-0-of-3.json").read_bytes()
            for second in (make_plan(tmp_path, 6, (1, 3)), other):
                try:
                    batch.run(second, folder, engine="nothing", overwrite=second is other, shard=(1, 3))
                    tried.append("joined")
                except atomic_file.Busy as error:
                    tried.extend(error.lines)
            assert (folder / "plan-0-of-3.json").read_bytes() == before
            return []

        yield make

    monkeypatch.setitem(batch.ENGINES, "outer", engine)
    monkeypatch.setitem(batch.ENGINES, "nothing", outcome())
    batch.run(one, tmp_path / "out", engine="outer", shard=(0, 3))
    busy = "a run of another recipe, or of other values of it, is at work there: choose another folder"
    assert tried == ["joined", f"{tmp_path / 'out'}: {busy}"]
    batch.run(other, tmp_path / "out", engine="nothing", shard=(1, 3))  # the first has ended


def test_of_many_that_start_at_once_one_wins(tmp_path: Path) -> None:
    """Processes of two kinds of work race for a place: those that get it are of one kind."""
    children = []
    ready, go = os.pipe()
    for number in range(8):
        if not (child := os.fork()):
            try:
                os.close(go)
                os.read(ready, 1)
                with atomic_file.shared(tmp_path / "run", f"work {number % 2}", "busy"):
                    with (tmp_path / "won").open("a") as file:
                        file.write(f"{number % 2}\n")
                    time.sleep(0.3)
            finally:
                os._exit(0)
        children.append(child)
    os.close(go)
    for child in children:
        os.waitpid(child, 0)
    os.close(ready)
    assert len(set((tmp_path / "won").read_text().split())) == 1


@pytest.mark.parametrize("name", ["plan.json", "journal.jsonl", "scene-00001.timing.json", "scene-00000-L.timing.json"])
def test_foreign_files_with_names_of_a_run_stay(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(batch.ENGINES, "nothing", outcome())
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text('{"frames": "of my film", "scenes": 3}')
    for overwrite in (False, True):
        with pytest.raises(UserError, match=f"{name}: was not written by tacgen run"):
            batch.run(make_plan(tmp_path, 2), tmp_path / "out", engine="nothing", overwrite=overwrite)
    assert os.listdir(tmp_path / "out") == [name]


# --- messages


def test_no_control_character_of_a_name_reaches_the_terminal(tmp_path: Path) -> None:
    name = "a\x1b[31mred\x07\x9b"
    (tmp_path / name).mkdir()
    (recipe := tmp_path / name / "r.yaml").write_text(f"extends: quickstart\nname: {json.dumps(name)}\nnme: 1\n")
    (odd := tmp_path / name / "odd.yaml").write_text("extends: quickstart\ntrajectory: [{press: {depth_mm: 0.001}}]\n")
    commands: tuple[list[Any], ...] = (
        ["validate", recipe],
        ["validate", odd],
        ["plan", odd],
        ["sensor", "show", recipe],
        ["init", tmp_path / name / "x"],
        ["show", tmp_path / name],
        [name],
        ["validate", odd, f"--{name}"],
        ["check", tmp_path / name / "no.h5"],
        ["run", odd, "-o", tmp_path / name, "--shard", name],
        ["list", name],
    )
    for words in commands:
        done = tacgen_(*words)
        assert not set("\x1b\x07\x9b") & set(done.output), words
        assert done.exception is None or isinstance(done.exception, SystemExit), words
