"""The labels of a finger as columns, one row for each row of an episode: what all copies with touch hold."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.touch.episode import Array, EpisodeLog, Touch

# components and units of the columns that have several, or a unit
COMPONENTS = {
    "force": [f"{axis}_n" for axis in "xyz"],
    "wrench": [*(f"{axis}_n" for axis in "xyz"), *(f"torque_{axis}_n_mm" for axis in "xyz")],
    "correction": ["z_mm"],
    "engine_force": ["n"],
}
Felt = Mapping[int, tuple[EpisodeLog, Sequence[Touch]]]  # episodes and their fingers by the index of the episode
LEFT_OUT_NOTE = "no touch was computed for this episode"


def columns(touch: Touch) -> dict[str, Array]:
    """Labels (n, k) of the n rows by name: float32 or bool. Without the picture, the object's name and the note."""
    numbers = {
        "force": touch.force,
        "wrench": np.hstack([touch.force, touch.torque]),
        "expected_error": touch.error,
        "correction": touch.correction,
        "engine_force": touch.engine,
    }
    if touch.markers is not None:
        numbers["markers"] = touch.markers
    n = len(touch.touched)
    found = {name: np.asarray(values, np.float32).reshape(n, -1) for name, values in numbers.items()}
    marks = {"contact": touch.contact, "slip": touch.moved, "lifted": touch.lifted}
    return found | {name: np.asarray(values, bool).reshape(n, 1) for name, values in marks.items()}


def by_episode(episodes: Sequence[EpisodeLog], touches: Sequence[Sequence[Touch]]) -> Felt:
    """Episodes and their touch. Raises UserError: none, or episodes whose fingers, pictures, markers or rows differ."""
    if not episodes:
        raise UserError("no episode has touch: there is nothing to write")
    pairs = list(zip(episodes, touches, strict=True))
    for episode, felt in pairs:
        first = {touch.finger: _kind(touch) for touch in touches[0]}
        if (own := {touch.finger: _kind(touch) for touch in felt}) != first:
            raise UserError(f"{episode.name}: its fingers' pictures or markers are {own}, those before have {first}")
        if wrong := [touch.finger for touch in felt if len(touch.touched) != len(episode)]:
            raise UserError(f"{episode.name}: has {len(episode)} rows, the touch of {wrong[0]} has another number")
    return {episode.index: (episode, felt) for episode, felt in pairs}


def title(episode: EpisodeLog) -> str:
    """The name of an episode, `episode 3` where that is a number."""
    return f"episode {episode.name}" if episode.name.isdecimal() else episode.name or f"episode {episode.index}"


def file_name(episode: EpisodeLog) -> str:
    """The title of an episode as the name of a file."""
    return re.sub(r"[^\w.-]+", "-", title(episode)).strip("-.") or f"episode-{episode.index}"


def file_of(episode: EpisodeLog, out: Path, suffix: str) -> Path:
    """The file of one episode: `out` itself if it has a suffix, otherwise one in that folder."""
    return out if out.suffix else out / f"{file_name(episode)}{suffix}"


def _kind(touch: Touch) -> tuple[tuple[int, ...], int]:
    """Size of the picture, and number of markers."""
    return touch.image(0).shape, 0 if touch.markers is None else touch.markers.shape[1]


def left_out(like: Touch, rows: int) -> Touch:
    """The touch of an episode for which none was computed: nan, black pictures, and a note that says so."""
    unknown, no, picture = np.full((rows, 3), np.nan), np.zeros(rows, bool), np.zeros_like(like.image(0))
    return Touch(
        finger=like.finger,
        touched=[""] * rows,
        force=unknown,
        torque=unknown,
        markers=None if like.markers is None else np.full((rows, *like.markers.shape[1:]), np.nan),
        error=unknown[:, 0],
        correction=unknown[:, 0],
        engine=unknown[:, 0],
        moved=no,
        lifted=no,
        note=[LEFT_OUT_NOTE] * rows,
        image=lambda _: picture,
    )


def distinct(texts: Iterable[str]) -> list[str]:
    """Every text once, "" first, then in order of appearance."""
    return list(dict.fromkeys(["", *texts]))
