"""Touch in robomimic's HDF5, in Rerun and as a film."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.needs import needs
from helpers.touched import IMAGE, ROWS, both, demonstrations, digests, felt, recorded, written
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.touch import copies, film, into_rerun, into_robomimic
from tacgen.touch.label_columns import file_name


def test_demonstrations_get_touch_and_keep_all_else(tmp_path: Path) -> None:
    source = recorded(demonstrations(tmp_path / "given.hdf5"), "robomimic")
    before = digests(tmp_path)
    written(into_robomimic, source, both(), tmp_path / "out.hdf5")
    assert digests(tmp_path)["given.hdf5"] == before["given.hdf5"]
    with h5py.File(tmp_path / "out.hdf5") as file, h5py.File(source.path) as given:
        for index in range(2):
            obs = file[f"data/demo_{index}/obs"]
            for finger in ("left", "right"):
                touch, prefix = felt(index, finger), f"tactile_{finger}_"
                assert np.array_equal(obs[f"{prefix}image"], [touch.image(k) for k in range(ROWS)])
                assert np.array_equal(obs[f"{prefix}force"], touch.force.astype(np.float32))
                assert np.array_equal(obs[f"{prefix}slip"][:, 0], touch.moved)
                assert obs[f"{prefix}note"].asstr()[:].tolist() == touch.note
                assert obs[f"{prefix}object"].asstr()[:].tolist() == touch.touched
        later = np.minimum(np.arange(ROWS) + 1, ROWS - 1)
        nexts = file["data/demo_0/next_obs"]
        assert np.array_equal(nexts["tactile_left_wrench"], file["data/demo_0/obs/tactile_left_wrench"][:][later])
        assert "next_obs" not in file["data/demo_1"]

        def same(name: str, item: Any) -> None:
            assert dict(file[name].attrs) == dict(item.attrs)
            if isinstance(item, h5py.Dataset):
                assert np.array_equal(file[name][()], item[()])

        given.visititems(same)


def test_demonstrations_that_do_not_fit_are_one_line(tmp_path: Path) -> None:
    source, out = recorded(demonstrations(tmp_path / "given.hdf5"), "robomimic"), tmp_path / "out.hdf5"
    with h5py.File(source.path, "r+") as file:
        file["data/demo_1/obs/longer"] = np.zeros(ROWS + 1)
        file["data/demo_2"] = h5py.ExternalLink("other.h5", "/data/demo_2")
    with pytest.raises(UserError, match="demo_1: obs/longer has 21 rows, touch has 20"):
        written(into_robomimic, source, both(), out)
    for name in ("demo_9", "demo_2"):
        other = replace(source, held=(replace(source.held[0], name=name),))
        with pytest.raises(UserError, match=f"has no demonstration {name}$"):
            written(into_robomimic, other, both(1), out)
    assert [path.name for path in tmp_path.iterdir()] == ["given.hdf5"]
    written(into_robomimic, source, both(1), out)
    with pytest.raises(UserError, match="--overwrite replaces it"):
        written(into_robomimic, source, both(1), out)
    with pytest.raises(UserError, match="has /data/demo_0/obs/tactile_left_image already"):
        written(into_robomimic, replace(source, path=out), both(1), tmp_path / "twice.hdf5")
    (tmp_path / "text.hdf5").write_text("not HDF5")
    with pytest.raises(UserError, match="not an HDF5 file"):
        written(into_robomimic, replace(source, path=tmp_path / "text.hdf5"), both(), out, overwrite=True)


def test_rerun_shows_object_gripper_pictures_and_forces(tmp_path: Path) -> None:
    chunk = needs("rerun.chunk")
    source = recorded(tmp_path / "given")
    (made, _) = written(into_rerun, source, both(), tmp_path / "out")
    assert made == tmp_path / "out/demo_0.rrd"
    found: dict[str, dict[str, list[Any]]] = {}
    for part in chunk.RrdReader(str(made)).stream().to_chunks():
        for name, values in part.to_record_batch().to_pydict().items():
            found.setdefault(part.entity_path, {}).setdefault(name, []).extend(values)
    touch, order = felt(0, "left"), np.argsort(found["/force/left"]["frame"])
    forces = np.array(found["/force/left"]["Scalars:scalars"])[order]
    assert forces[:, 0] == pytest.approx(-touch.force[:, 2])
    assert forces[:, 1] == pytest.approx(np.hypot(*touch.force[:, :2].T))
    assert sorted(k for k in found["/touch/right"]["frame"] if k is not None) == list(range(ROWS))
    heights = [t[0][2] for t in found["/world/cube"]["Transform3D:translation"] if t]
    assert heights == pytest.approx(100 + np.arange(ROWS))
    corners = np.array(found["/world/cube/surface"]["Mesh3D:vertex_positions"][0])
    assert np.ptp(corners, axis=0)[:2] == pytest.approx([10, 8], abs=0.05)
    assert "/world/finger_left" in found
    assert [text[0] for text in found["/note/left"]["TextLog:text"] if text] == [touch.note[7], "as asked"]
    with pytest.raises(UserError, match="--overwrite replaces it"):
        written(into_rerun, source, both(), tmp_path / "out")


def test_a_film_shows_both_fingers_in_every_row(tmp_path: Path) -> None:
    source = recorded(tmp_path / "given")
    (made,) = written(film, source, both(1), tmp_path / "film.webp")
    with Image.open(made) as image:
        assert getattr(image, "n_frames", 1) == ROWS
        image.seek(3)
        still = np.asarray(image.convert("RGB"), int)
        image.seek(10)
        pressed = np.asarray(image.convert("RGB"), int)
    height, width = still.shape[:2]
    for side in (np.s_[80 : width // 2 - 60], np.s_[width // 2 + 60 : -80]):
        part = np.s_[height // 4 : height // 2, side]
        assert np.median(still[part]) == pytest.approx(7, abs=3)  # the untouched sensor
        assert pressed[part].std() > 30
    assert IMAGE[0] / IMAGE[1] == pytest.approx(0.75)
    with pytest.raises(UserError, match=r"^\.avi: unknown kind of film"):
        written(film, source, both(1), tmp_path / "film.avi")


def test_the_name_of_the_output_says_what_is_written(tmp_path: Path) -> None:
    source = recorded(demonstrations(tmp_path / "given.hdf5"), "robomimic")
    for name in ("out.hdf5", "out.gif"):
        copies.write(source, source.held[:1], both(1), tmp_path / name, overwrite=False)
    assert (tmp_path / "out.hdf5").read_bytes()[:4] == b"\x89HDF"
    with Image.open(tmp_path / "out.gif") as image:
        assert (image.format, getattr(image, "n_frames", 1)) == ("GIF", ROWS)
    for name in ("out.hdf5", "out.gif"):
        with pytest.raises(UserError, match="is there already; --overwrite replaces it"):
            copies.refuse(source, 1, tmp_path / name, overwrite=False)
        copies.refuse(source, 1, tmp_path / name, overwrite=True)
    with pytest.raises(UserError, match=r"two\.rrd: holds one episode, these are 2: choose one by --episodes"):
        copies.refuse(source, 2, tmp_path / "two.rrd", overwrite=True)
    with pytest.raises(UserError, match="the copy must be outside of the data set"):
        copies.refuse(recorded(tmp_path), 2, tmp_path / "in", overwrite=True)
    needs("rerun")
    copies.write(source, source.held[:1], both(1), tmp_path / "out.rrd", overwrite=False)
    copies.write(replace(source, kind="umi"), source.held, both(), tmp_path / "folder", overwrite=False)
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["demo_0.rrd", "demo_1.rrd"]


@pytest.mark.parametrize(
    ("name", "file"),
    [("7", "episode-7"), ("demo_3", "demo_3"), ("data/demo 3", "data-demo-3"), ("../x", "x"), ("", "episode-0")],
)
def test_a_file_is_named_after_its_episode(name: str, file: str, tmp_path: Path) -> None:
    source = recorded(tmp_path / "given")
    assert file_name(replace(source.held[0], name=name)) == file
