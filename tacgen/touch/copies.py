"""Where touch can go: by what the name of the output says, or into a copy of what the episodes were read from."""

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.report import animation
from tacgen.touch import into_lerobot, into_rerun
from tacgen.touch.episode import EpisodeLog, Touch
from tacgen.touch.label_columns import by_episode
from tacgen.touch.recording import Recording

WRITER_OF_SUFFIX = {".rrd": "into_rerun", **dict.fromkeys(animation.ANIMATION_WRITERS, "film")}
WRITER_OF_KIND = {"lerobot": "into_lerobot", "robomimic": "into_robomimic"}


def refuse(source: Recording, episodes: int, out: Path, *, overwrite: bool) -> None:
    """UserError if touch of so many episodes cannot be written to `out`; to be called before long work."""
    name = _writer(source, out)
    if out.suffix.lower() in WRITER_OF_SUFFIX and episodes > 1:
        raise UserError(f"{out}: holds one episode, these are {episodes}: choose one by --episodes, or name a folder")
    if name == "film":
        animation.writer_for(out, 1)
    elif name == "into_rerun":
        into_rerun.refuse()
    if name == "into_lerobot":
        into_lerobot.refuse(source, out, overwrite=overwrite)
    elif name == "into_robomimic" or out.suffix.lower() in WRITER_OF_SUFFIX:
        output_file.refuse(out, [source.path], overwrite=overwrite)


def write(
    source: Recording, episodes: Sequence[EpisodeLog], touches: Sequence[Sequence[Touch]], out: Path, *, overwrite: bool
) -> list[Path]:
    """Write a film or an .rrd file where `out` ends so; else a copy of the source, or .rrd files of one without a copy.

    Args:
        touches: of each episode one for each finger.

    Returns:
        the files.

    Raises:
        UserError: as of `by_episode`, and of the `write` of the module that does it.
    """
    written: Callable[..., list[Path]] = import_module(f"tacgen.touch.{_writer(source, out)}").write
    return written(source, by_episode(episodes, touches), out, overwrite=overwrite)


def _writer(source: Recording, out: Path) -> str:
    """The module that writes."""
    return WRITER_OF_SUFFIX.get(out.suffix.lower()) or WRITER_OF_KIND.get(source.kind, "into_rerun")
