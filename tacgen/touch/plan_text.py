"""Texts before episodes are solved, and after: contacts, their share of rows, and forces beside the engine's."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from tacgen.replay.comparison import MIN_CONTACT_FORCE_N, aligned
from tacgen.touch.episode import EpisodeLog, Touch
from tacgen.touch.scenes import TouchScenes

MAX_LISTED_NOTES = 12  # lines about rows that are not as asked


def summary(prepared: TouchScenes, fps: float) -> dict[str, Any]:
    """Episodes, rows, the share of rows in contact and intervals by object, as JSON values."""
    intervals = list(prepared.scenes.values())
    rows = sum(map(len, prepared.episodes))
    near = [np.logical_or.reduce([[bool(name) for name in at.near] for at in each]) for each in prepared.contacts]
    return {
        "episodes": len(prepared.episodes),
        "rows": rows,
        "seconds": round(rows / fps, 3),
        "in_contact": int(sum(each.sum() for each in near)),
        "scenes": len(intervals),
        "frames": sum(len(one.log) for one in intervals),
        "intervals": dict(sorted(Counter(one.place for one in intervals).items())),
        "refused": [
            f"episode {one.episode}, rows {one.rows[0]} to {one.rows[1]}, {one.place}: {why}"
            for one, why in prepared.refused
        ],
        "left_out": dict(sorted(Counter(note for each in prepared.contacts for at in each for note in at.note if note)
                                .items())),
    }  # fmt: skip


def text(said: dict[str, Any]) -> str:
    """The summary for a terminal."""
    share = 100 * said["in_contact"] / max(1, said["rows"])
    lines = [
        f"{said['episodes']} episodes, {said['rows']} rows ({said['seconds']:g} s): {share:.0f} % of them in contact",
        f"to be solved: {said['scenes']} intervals, {said['frames']} frames; the rest is the untouched sensor",
        *(f"  {name}: {count}" for name, count in said["intervals"].items()),
        *(f"  cannot be solved: {line}" for line in said["refused"][:MAX_LISTED_NOTES]),
        *(f"  left out, {count} rows: {note}" for note, count in said["left_out"].items()),
    ]
    return "\n".join(lines)


def engine_table(episodes: Sequence[EpisodeLog], touches: Sequence[Sequence[Touch]]) -> list[dict[str, Any]]:
    """The engine's normal force beside tacgen's, for each episode, finger and object: largest of each, and the median
    of the engine's over tacgen's where both have one."""
    found = []
    for episode, each in zip(episodes, touches, strict=True):
        for one in each:
            for name in dict.fromkeys(filter(None, one.touched)):
                here = np.array([touched == name for touched in one.touched]) & np.isfinite(one.engine)
                ours, theirs = -one.force[here, 2], one.engine[here]
                both = (np.nan_to_num(ours) > MIN_CONTACT_FORCE_N) & (theirs > MIN_CONTACT_FORCE_N)
                if not here.any():
                    continue
                found.append({
                    "episode": episode.name, "finger": one.finger, "object": name, "rows": int(here.sum()),
                    "engine_n": float(theirs.max()), "tacgen_n": float(np.nan_to_num(ours).max()),
                    "ratio": float(np.median(theirs[both] / ours[both])) if both.any() else None,
                })  # fmt: skip
    return found


def engine_lines(table: Sequence[dict[str, Any]]) -> list[str]:
    """The table for a terminal."""
    if not table:
        return []
    rows = [["episode", "finger", "object", "rows", "engine [N]", "tacgen [N]", "engine / tacgen"]]
    for one in table:
        ratio = "-" if one["ratio"] is None else f"{one['ratio']:.2f}"
        numbers = [f"{one['engine_n']:.3g}", f"{one['tacgen_n']:.3g}", ratio]
        rows.append([one["episode"], one["finger"], one["object"], str(one["rows"]), *numbers])
    head = "largest normal forces, and the median of the engine's over tacgen's where both have one"
    return [head, *aligned(rows)]


def notes(episodes: Sequence[EpisodeLog], touches: Sequence[Sequence[Touch]]) -> list[str]:
    """Why rows are not as asked: a line for each reason, with the number of rows."""
    why: Counter[str] = Counter()
    for episode, each in zip(episodes, touches, strict=True):
        for one in each:
            why.update(f"{episode.name}, {one.finger}: {note}" for note in one.note if note)
    lines = [f"{text} ({count} rows)" for text, count in why.items()]
    more = [f"... and {len(lines) - MAX_LISTED_NOTES} more"] if len(lines) > MAX_LISTED_NOTES else []
    return lines[:MAX_LISTED_NOTES] + more
