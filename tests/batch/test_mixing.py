"""A run's folder: files of others stay as they are, and what is read from it is one data set, of one plan."""

from pathlib import Path

import h5py
import pytest
from helpers.scenes import TASK, make_plan

from tacgen import batch, export
from tacgen.base.errors import LeftOut, UserError
from tacgen.bundle import bundle, dataset
from tacgen.bundle.check import check
from tacgen.bundle.run_status import survey
from tacgen.recipe import plan
from tacgen.report import dataset_card, dataset_summary
from tacgen.torch import TactileDataset

pytestmark = pytest.mark.usefixtures("kept_workers")
THEIRS = {
    "plan_b.json": "{}",
    "planning.json": "a",
    "plan-1-of-2.json": '{"milestones": []}',
    "backup.tar.part-01": "b",
    "movie.part-2": "c",
    ".notes.claim": "d",
    "journal-2024.jsonl": "e",
    "README.md": "# My experiment\n",
}


def run(folder: Path, samples: int, sets: tuple[str, ...] = (), **options: object) -> list[str]:
    """Run stand-in scenes of a recipe with changes; the notes that were told."""
    folder.parent.mkdir(exist_ok=True)
    make_plan(folder.parent)  # writes the recipe
    rows = plan.load(folder.parent / "many.yaml", [f"vary.samples={samples}", *sets], options.get("shard") or (0, 1))
    events: list[dict[str, str]] = []
    batch.run(rows, folder, task=TASK, on_event=events.append, **options)
    return [event["note"] for event in events if event["event"] == "note"]


def radii(folder: Path) -> dict[str, float]:
    """Radius of the indenter of each scene that readers deliver."""
    return {scene.path.stem: scene.recipe["indenter"]["radius_mm"] for scene in dataset.scenes(folder)}


def test_a_run_leaves_files_of_others_in_its_folder_as_they_are(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name, text in THEIRS.items():
        (out / name).write_text(text)
    run(out, 2)
    card = dataset_card.write(out)
    run(out, 3, overwrite=True)
    assert {name: (out / name).read_text() for name in THEIRS} == THEIRS
    assert card.name == "DATASET_CARD.md"
    assert dataset_card.write(out) == card
    assert survey(out).count() == {"ok": 3}


def test_a_card_that_somebody_changed_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, 1)
    card = dataset_card.write(out)
    assert card.name == "README.md"
    assert dataset_card.write(out) == card
    changed = card.read_text() + "\nMeasured by us.\n"
    card.write_text(changed)
    assert dataset_card.write(out).name == "DATASET_CARD.md"
    assert card.read_text() == changed
    (out / "DATASET_CARD.md").write_text("mine")
    with pytest.raises(UserError, match="no card written"):
        dataset_card.write(out)


def test_overwriting_removes_what_the_new_plan_does_not_have(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, 4)
    (out / "scene-00003.timing.json").write_text('{"frames": 1, "seconds": {}}')
    (out / "mine.txt").write_text("stays")
    notes = run(out, 2, ("indenter.radius_mm=2.5",), overwrite=True)
    assert notes == ["removed, no longer in the plan: scene-00002, scene-00003"]
    assert radii(out) == {"scene-00000": 2.5, "scene-00001": 2.5}
    assert not (out / "scene-00003.timing.json").exists()
    assert (out / "mine.txt").exists()
    assert check(out) == []


def test_bundles_that_are_not_of_the_plan_are_in_no_reader_and_told_by_all(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, 4, ("indenter.radius_mm=2.5",))
    foreign = (out / "scene-00001.h5").read_bytes()
    for path in out.glob("scene-*"):
        path.unlink()
    run(out, 3)
    (out / "scene-00001.h5").write_bytes(foreign)  # planned, of other inputs
    (out / "scene-00007.h5").write_bytes(foreign)  # not planned
    with pytest.warns(LeftOut, match=r"left out scene-00001.h5, scene-00007.h5: not of the plan there"):
        assert radii(out) == {"scene-00000": 4.0, "scene-00002": 4.0}
    with pytest.warns(LeftOut):
        assert len(TactileDataset(out, ("force",)).scenes) == 2
    with pytest.warns(LeftOut):
        assert len(export.bundles(out)) == 2
    assert [(f.path.name, f.level) for f in check(out)] == [("scene-00001.h5", "stray"), ("scene-00007.h5", "stray")]
    assert survey(out).count() == {"ok": 2, "waiting": 1}
    assert dataset_summary.look(out).frames == 24
    notes = run(out, 3, overwrite=True)
    assert notes == ["left out, not in the plan: scene-00007; readers pass over them"]  # no run here made it
    assert (out / "scene-00007.h5").read_bytes() == foreign


def test_a_shard_removes_only_scenes_of_its_own_numbers(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for i in range(2):
        run(out, 6, shard=(i, 2))
    run(out, 3, ("indenter.radius_mm=2.5",), shard=(0, 2), overwrite=True)
    assert sorted(path.stem for path in out.glob("*.h5")) == [f"scene-{i:05d}" for i in (0, 1, 2, 3, 5)]
    run(out, 3, ("indenter.radius_mm=2.5",), shard=(1, 2), overwrite=True)
    assert radii(out) == {f"scene-{i:05d}": 2.5 for i in range(3)}


def test_several_data_sets_are_merged_only_on_request(tmp_path: Path) -> None:
    for name in ("a", "b"):
        run(tmp_path / "data" / name, 2)
    with pytest.raises(UserError, match=r"data: holds 2 data sets: .*/data/a, .*/data/b: name one of them, or merge"):
        export.bundles(tmp_path / "data")
    with pytest.raises(UserError, match="holds 2 data sets"):
        TactileDataset(tmp_path / "data", ("force",))
    assert len(export.bundles(tmp_path / "data", merge=True)) == 4
    assert len(TactileDataset(tmp_path / "data", ("force",), merge=True).scenes) == 4


def test_bundles_of_another_version_are_named_kept_and_renewed_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, 3)
    made_by(out / "scene-00001.h5", "0.0.7")
    before = {path.name: path.read_bytes() for path in out.glob("*.h5")}
    (note,) = run(out, 3)
    assert note.startswith("kept, made by tacgen 0.0.7, this is ")
    assert note.endswith(": scene-00001; --overwrite makes them again")
    assert {path.name: path.read_bytes() for path in out.glob("*.h5")} == before
    (out / "made.log").unlink()
    assert run(out, 3, overwrite=True) == []
    assert (out / "made.log").read_text() == "scene-00001\n"


def test_other_inputs_are_named(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, 1, ("contact.friction=0.65",))
    with pytest.raises(UserError, match=r"inputs \(contact.friction: 0.65 -> 0.62\); --overwrite replaces it"):
        run(out, 1, ("contact.friction=0.62",))


def made_by(path: Path, version: str) -> None:
    """Have a bundle of another version of tacgen: the same contents, with a digest that is right."""
    found = bundle.read(path)
    datasets = found.verify()
    attrs = {**found.attrs, "tacgen_version": version}
    with h5py.File(path, "r+") as file:
        file.attrs["tacgen_version"] = version
        file.attrs["digest"] = bundle._digest(attrs, datasets)
