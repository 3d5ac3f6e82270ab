"""Touch in a copy of a LeRobot data set: the values, the statistics, and all of the original."""

import io
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import touched
from helpers.needs import needs
from helpers.touched import IMAGE, MARKERS, ROWS, RecordedEpisodes, both, digests, felt, lerobot_folder, recorded
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.touch import into_lerobot
from tacgen.touch.label_columns import LEFT_OUT_NOTE

needs("pyarrow")
from pyarrow import parquet  # noqa: E402

PREFIX = "observation.tactile.left."


@pytest.fixture(params=[True, False], ids=["one file", "two files"])
def source(tmp_path: Path, request: pytest.FixtureRequest) -> RecordedEpisodes:
    return recorded(lerobot_folder(tmp_path / "given", request.param))


def written(source: RecordedEpisodes, out: Path, touches: Any = None, **how: Any) -> tuple[dict[str, Any], list[Any]]:
    """meta/info.json and all rows of the copy."""
    touched.written(into_lerobot, source, touches or both(), out, **how)
    return json.loads((out / "meta/info.json").read_text()), rows_of(out)


def rows_of(folder: Path, kind: str = "data") -> list[dict[str, Any]]:
    """All rows of the tables of a data set."""
    files = sorted((folder / kind).glob("*/*.parquet"))
    return [row for file in files for row in parquet.read_table(file).to_pylist()]


def stats_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "meta/stats.json").read_text())


def test_every_row_has_the_values_of_both_fingers(source: RecordedEpisodes, tmp_path: Path) -> None:
    info, rows = written(source, tmp_path / "out")
    assert len(rows) == 2 * ROWS
    assert info["features"][f"{PREFIX}image"]["shape"] == list(IMAGE)
    assert info["features"][f"{PREFIX}markers"]["shape"] == [2 * MARKERS]
    texts = {name: info["features"][f"{PREFIX}{name}"]["info"]["texts"] for name in ("object", "note")}
    assert texts == {"object": ["", "cube"], "note": ["", "two objects touch at once"]}
    for row in rows:
        for touch in both()[row["episode_index"]]:
            k, prefix = row["frame_index"], f"observation.tactile.{touch.finger}."
            image = np.asarray(Image.open(io.BytesIO(row[f"{prefix}image"]["bytes"])))
            assert np.array_equal(image, touch.image(k))
            assert touch.markers is not None
            numbers = {
                "force": touch.force[k], "wrench": [*touch.force[k], *touch.torque[k]], "markers": touch.markers[k],
                "expected_error": touch.error[k], "correction": touch.correction[k], "engine_force": touch.engine[k],
            }  # fmt: skip
            for name, value in numbers.items():
                wanted = np.float32(value).ravel().squeeze()
                assert np.array_equal(np.float32(row[prefix + name]), wanted, equal_nan=True)
            marks = {"contact": touch.contact[k], "slip": touch.moved[k], "lifted": touch.lifted[k]}
            assert {name: row[prefix + name] for name in marks} == marks
            assert texts["object"][row[f"{prefix}object"]] == touch.touched[k]
            assert texts["note"][row[f"{prefix}note"]] == touch.note[k]
    for name, feature in info["features"].items():
        assert set(rows[0]) == set(info["features"]), name
        if feature["dtype"] not in ("image", "string") and feature["shape"] != [1]:
            assert len(rows[0][name]) == feature["shape"][0]


def test_the_original_is_unchanged_and_all_of_it_is_in_the_copy(source: RecordedEpisodes, tmp_path: Path) -> None:
    before, given = digests(source.path), source.path
    info, rows = written(source, tmp_path / "out")
    assert digests(given) == before
    copied, anew = digests(tmp_path / "out"), ("data/", "meta/info.json", "meta/stats.json", "meta/episodes/")
    assert [name for name in before if not name.startswith(anew) and copied[name] != before[name]] == []
    old = rows_of(given)
    assert [{name: row[name] for name in old[0]} for row in rows] == old
    was = json.loads((given / "meta/info.json").read_text())
    assert info | {"features": None} == was | {"features": None}
    assert {name: info["features"][name] for name in was["features"]} == was["features"]
    for row, other in zip(rows_of(tmp_path / "out", "meta/episodes"), rows_of(given, "meta/episodes"), strict=True):
        assert {name: row[name] for name in other} == other
    assert stats_of(tmp_path / "out")["action"]["std"] == [1.0] * 3


def test_statistics_are_those_of_the_rows_and_colours(source: RecordedEpisodes, tmp_path: Path) -> None:
    written(source, tmp_path / "out")
    stats, episodes = stats_of(tmp_path / "out"), rows_of(tmp_path / "out", "meta/episodes")
    lefts = [felt(index, "left") for index in range(2)]
    force = np.concatenate([touch.force for touch in lefts]).astype(np.float32).astype(float)
    engine = np.concatenate([touch.engine for touch in lefts])
    images = np.stack([touch.image(k) for touch in lefts for k in range(ROWS)]) / 255
    for values, found in (
        (force, stats[f"{PREFIX}force"]),
        (engine[np.isfinite(engine)][:, None], stats[f"{PREFIX}engine_force"]),
        (images.reshape(-1, 3), stats[f"{PREFIX}image"]),
    ):
        for kind in ("min", "max", "mean", "std"):
            wanted = getattr(values, kind)(axis=0)
            assert np.ravel(found[kind]) == pytest.approx(wanted, rel=1e-6, abs=1e-12), kind
    assert np.shape(stats[f"{PREFIX}image"]["mean"]) == (3, 1, 1)
    assert [stats[f"{PREFIX}{name}"]["count"] for name in ("force", "engine_force", "image")] == [[40], [20], [40]]
    assert not {name for name in stats if name.endswith((".contact", ".slip", ".lifted", ".note", ".object"))}
    for index, row in enumerate(episodes):
        assert row[f"stats/{PREFIX}force/mean"] == pytest.approx(force[index * ROWS : (index + 1) * ROWS].mean(0))
        assert np.shape(row[f"stats/{PREFIX}image/q99"]) == (3, 1, 1)


def test_an_episode_without_touch_has_nan_and_says_so(source: RecordedEpisodes, tmp_path: Path) -> None:
    info, rows = written(source, tmp_path / "out", both(1))
    texts = info["features"][f"{PREFIX}note"]["info"]["texts"]
    assert {texts[row[f"{PREFIX}note"]] for row in rows[ROWS:]} == {LEFT_OUT_NOTE}
    assert all(np.isnan(row[f"{PREFIX}force"]).all() and not row[f"{PREFIX}contact"] for row in rows[ROWS:])
    mean = felt(0, "left").force.mean(0)
    assert stats_of(tmp_path / "out")[f"{PREFIX}force"]["mean"] == pytest.approx(mean, rel=1e-6)


def test_a_picture_is_encoded_once(source: RecordedEpisodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, counted = list[bytes](), list[int]()
    for name, seen in (("encoded", lambda image: made.append(image.tobytes())),
                       ("_image_statistics", lambda them: counted.append(len(them)))):  # fmt: skip
        real = getattr(into_lerobot, name)
        monkeypatch.setattr(into_lerobot, name, lambda x, *a, r=real, s=seen, **k: s(x) or r(x, *a, **k))
    (touches,) = both(1)
    alike = [replace(touch, image=lambda k: touches[0].image(k).copy()) for touch in touches]
    written(source, tmp_path / "out", [alike])
    assert len(made) == len(set(made)) == 12  # ten with contact, the untouched sensor, and black for the other episode
    assert len(counted) == 2


def test_a_full_file_begins_another(source: RecordedEpisodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(into_lerobot, "PARQUET_FILE_BYTES", 1000)
    written(source, tmp_path / "out")
    episodes = rows_of(tmp_path / "out", "meta/episodes")
    assert [row["data/file_index"] for row in episodes] == [0, 1]
    for row in episodes:
        path = tmp_path / f"out/data/chunk-000/file-{row['data/file_index']:03d}.parquet"
        assert set(parquet.read_table(path)["episode_index"].to_pylist()) == {row["episode_index"]}


def test_the_same_input_gives_the_same_bytes_which_alone_are_replaced(source: RecordedEpisodes, tmp_path: Path) -> None:
    out = tmp_path / "out"
    written(source, out)
    first = digests(out)
    with pytest.raises(UserError, match=r"out: is there already; --overwrite replaces it$"):
        written(source, out)
    written(source, out, overwrite=True)
    assert digests(out) == first
    (out / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match=r"mine\.txt is not of the export"):
        written(source, out, overwrite=True)
    for place in (source.path, source.path / "in", source.path.parent):
        with pytest.raises(UserError, match="the copy must be outside of the data set"):
            written(source, place, overwrite=True)
    again = replace(source, path=out)
    with pytest.raises(UserError, match=r"has observation\.tactile\.left\.contact already"):
        written(again, tmp_path / "twice")


def test_what_does_not_fit_is_one_line_and_leaves_nothing(source: RecordedEpisodes, tmp_path: Path) -> None:
    short = [[felt(0, "left", 19)], [felt(1, "left", 19)]]
    with pytest.raises(UserError, match="demo_0: has 20 rows, the touch of left has another number"):
        written(source, tmp_path / "out", short)
    cut = replace(source, held=tuple(replace(e, time=e.time[:19]) for e in source.held))
    with pytest.raises(UserError, match="episode 0 has other rows than the 19 with touch"):
        written(cut, tmp_path / "out", short)
    with pytest.raises(UserError, match="its fingers' pictures or markers are"):
        written(source, tmp_path / "out", [both()[0], both()[1][:1]])
    assert [path.name for path in tmp_path.iterdir()] == ["given"]


KILL = """
import os, signal
from pathlib import Path
from helpers.touched import both, recorded, written
from tacgen.touch import into_lerobot
def killed(*_): os.kill(os.getpid(), signal.SIGKILL)
into_lerobot.{place} = killed
written(into_lerobot, recorded(Path({given!r})), both(), Path({out!r}), overwrite=True)
"""


@pytest.mark.parametrize("place", ["_data", "_episodes", "add"])
def test_a_killed_process_leaves_no_data_set(place: str, tmp_path: Path) -> None:
    source = recorded(lerobot_folder(tmp_path / "given"))
    code = KILL.format(place=place, given=str(source.path), out=str(tmp_path / "out"))
    tests = Path(__file__).parents[1]
    env = os.environ | {"PYTHONPATH": f"{tests}:{tests.parent}"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / ".out.tacgen-new/meta/info.json").exists()
    written(source, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["given", "out"]
