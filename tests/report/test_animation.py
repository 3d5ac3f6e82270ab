"""Films of bundles: every frame is there, and shows itself."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.command import refused, told
from helpers.synthetic import write
from PIL import Image

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import read
from tacgen.report import animation


def frames(film: Path) -> list[np.ndarray]:
    with Image.open(film) as image:
        found = []
        for k in range(image.n_frames):
            image.seek(k)
            found.append(np.asarray(image.convert("RGB"), int))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count", "still"), [("webp", 12, 2), ("webp", 4, 0), ("gif", 3, 0)])
def test_every_frame_is_another(tmp_path: Path, kind: str, count: int, still: int) -> None:
    film = tmp_path / "out" / f"film.{kind}"
    told("show", write(tmp_path / "x.h5", frames=count), "--animate", film)
    seen = frames(film)
    assert len(seen) == count
    top = seen[0].shape[0] // 2  # above are the panels, below the force and its cursor
    changed = [(np.abs(a - b).max(axis=-1) > 60) for a, b in pairwise(seen)]
    assert all(part[top:].any() for part in changed)
    assert sum(part[:top].any() for part in changed) >= count - 1 - still  # two frames hold still


def test_a_panel_shows_its_own_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cursor stands at the frame whose axes are drawn last."""
    from matplotlib.figure import Figure

    seen = []

    class Listening:
        def saving(self, sheet: Figure, *_: object) -> "Listening":
            self.sheet = sheet
            return self

        def __enter__(self) -> None: ...

        def __exit__(self, *_: object) -> None: ...

        def grab_frame(self) -> None:
            panels = [a for a in self.sheet.axes if a.get_images() and a.get_visible()]
            seen.append([float(np.asarray(a.get_images()[0].get_array()).sum()) for a in panels])

    path = write(tmp_path / "x.h5", outputs=frozenset({"traction"}))
    bundle = read(path)
    animation.film(bundle, Listening(), tmp_path / "film")
    wanted = bundle["/frames/pressure"].sum(axis=(1, 2))
    assert [panels[1] for panels in seen[1:]] == pytest.approx(wanted[1:], rel=1e-5)  # above that of frame 0
    assert [len(panels) for panels in seen] == [2] + 11 * [4]


def test_what_cannot_be_made_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "x.h5")
    with pytest.raises(UserError, match=r"^\.avi: unknown kind of film, use one of \.webp, \.gif, \.mp4"):
        animation.write(read(path), tmp_path / "film.avi")
    with pytest.raises(UserError, match="has no frames"):
        animation.write(read(write(tmp_path / "y.h5", stop=0)), tmp_path / "film.gif")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(UserError, match=r"^\.mp4: needs ffmpeg on the PATH"):
        animation.write(read(path), tmp_path / "film.mp4")
    said = refused("show", path, "--animate", "x.gif", "--field", "slip")
    assert said == "--animate: draws a film of its own; leave out --out and --field\n"


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")
def test_mp4_where_ffmpeg_is(tmp_path: Path) -> None:
    animation.write(read(write(tmp_path / "x.h5")), tmp_path / "film.mp4")
    assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"
