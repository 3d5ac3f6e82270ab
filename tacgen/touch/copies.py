"""Where touch can go: by what the name of the output says, or into a copy of what the episodes were read from."""

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from tacgen.report.animation import ANIMATION_WRITERS
from tacgen.touch.episode import Episode, Source, Touch

WRITER_OF_SUFFIX = {".rrd": "into_rerun", **dict.fromkeys(ANIMATION_WRITERS, "film")}
WRITER_OF_KIND = {"lerobot": "into_lerobot", "robomimic": "into_robomimic"}


def write(
    source: Source, episodes: Sequence[Episode], touches: Sequence[Sequence[Touch]], out: Path, *, overwrite: bool
) -> list[Path]:
    """Write a film or an .rrd file where `out` ends so; else a copy of the source, or .rrd files of one without a copy.

    Arguments, result and exceptions as of `into_lerobot.write`.
    """
    name = WRITER_OF_SUFFIX.get(out.suffix.lower()) or WRITER_OF_KIND.get(source.kind, "into_rerun")
    written: Callable[..., list[Path]] = import_module(f"tacgen.touch.{name}").write
    return written(source, episodes, touches, out, overwrite=overwrite)
