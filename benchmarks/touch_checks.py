"""Touch that is added to recorded episodes, beside what is known of them: weights, commands and the engine's forces.

    python -m benchmarks.touch_checks FOLDER [--episodes 0,1,4] [--match pose,force,grip] [--workers 2] [-o FOLDER]

FOLDER is as `benchmarks.touch_episodes` writes it. Prints a line for each episode and match, over the rows in which the
recorded object is MIN_HEIGHT_MM over its stand and both fingers touch it: force of both fingers against gravity over
the object's weight (median, and the value farthest from 1); largest difference of a normal force from the one asked
for, over it, and the expected error of forces; correction of depth (least, most); median of the engine's normal force
over tacgen's; rows of the episode that are not as asked; seconds of a core, pictures included.
"""

import argparse
import resource
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.touch_episodes import KINDS, PADS
from tacgen import batch
from tacgen.base.errors import UserError
from tacgen.base.terminal import say
from tacgen.touch import intervals, labels, scenes, sources
from tacgen.touch.episode import EpisodeLog, Finger, Thing, Touch

Array = np.ndarray
SENSOR = "gelsight_mini"
FINGERS = tuple(Finger(pad.removesuffix("_pad"), SENSOR, pad) for pad in PADS)
COLUMNS = "ctrl: actions\ngrip: actions[4]\n"  # of robomimic.hdf5: commands, and the force of a finger's motor
MIN_HEIGHT_MM = 2.0  # over its first row, of an object that nothing but fingers holds [mm]
TITLES = (
    *("episode", "object", "match", "held", "weight", "farthest", "off asked", "expected", "mm least", "mm most"),
    *("engine/tacgen", "not as asked", "core s"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, and print the table; returns the exit code."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("folder", type=Path)
    ask.add_argument("--episodes", default="0,1,4", help="numbers: 0, 1 and 4 are of a box, a key and a nut")
    ask.add_argument("--match", default=",".join(scenes.MATCHES))
    ask.add_argument("--workers", type=int, default=2)
    ask.add_argument("-o", "--out", type=Path, help="folder that keeps recipes and bundles")
    told = ask.parse_args(arguments)
    say("  ".join(TITLES))
    why: Counter[str] = Counter()
    try:
        with TemporaryDirectory() as name:
            for number in map(int, told.episodes.split(",")):
                for match in told.match.split(","):
                    folder = (told.out or Path(name)) / f"{number}-{match}"
                    line, notes = checked(told.folder, number, match, folder, told.workers)
                    say("  ".join(text.rjust(len(title)) for text, title in zip(line, TITLES, strict=True)))
                    why.update(f"{number}, {match}: {note}" for note in notes)
    except UserError as error:
        say("\n".join(error.lines), err=True)
        return 2
    say("\n".join(f"episode {text} ({count} rows)" for text, count in why.items()))
    return 0


def checked(recorded: Path, number: int, match: str, folder: Path, workers: int) -> tuple[list[str], list[str]]:
    """The line of an episode, and notes on its rows."""
    before, kind = _core_seconds(), KINDS[number % len(KINDS)].name
    folder.mkdir(parents=True, exist_ok=True)
    columns = folder / "columns.yaml"
    columns.write_text(COLUMNS)
    source = sources.open_source(recorded / "robomimic.hdf5", None, (kind,), columns)
    asked = scenes.TouchChoice(match)
    prepared = scenes.prepare(source, FINGERS, asked, folder, range(number, number + 1), overwrite=True)
    touches = labels.felt(prepared, batch.run(prepared.plan, folder, workers=workers, overwrite=True))[0]
    numbers = compared(prepared.episodes[0], source.things[kind], touches, prepared.contacts[0])
    notes = [note for touch in touches for note in touch.note if note]
    cost = f"{_core_seconds() - before:.0f}"
    return [str(number), kind, match, *numbers, str(len(notes)), cost], notes


def compared(
    episode: EpisodeLog, thing: Thing, touches: Sequence[Touch], at: Sequence[intervals.AtFinger]
) -> list[str]:
    """Cells of the table, from `held` to the engine's forces."""
    down = np.array(episode.gravity)
    heights = -(episode.bodies[thing.body][:, :3, 3] @ down) / np.linalg.norm(down)
    held = (heights > heights[0] + MIN_HEIGHT_MM) & np.all([touch.contact for touch in touches], axis=0)
    if not held.any():
        return ["0", *["-"] * 7]
    assert thing.mass is not None
    borne = np.zeros(len(episode))
    for finger, touch in zip(FINGERS, touches, strict=True):
        turned = episode.bodies[finger.body][:, :3, :3]
        borne += np.einsum("nij,nj,i->n", turned, touch.force, down) / (thing.mass * (down @ down))
    normal, asked, engine = (
        np.array(each)[:, held]
        for each in ([-t.force[:, 2] for t in touches], [t.engine for t in touches], [one.engine for one in at])
    )
    shares, moved = borne[held], np.array([touch.correction for touch in touches])[:, held]
    expected = max(float(touch.error[held].max()) for touch in touches)
    return [
        str(held.sum()), f"{np.median(shares):.4f}", f"{shares[np.abs(shares - 1).argmax()]:.4f}",
        f"{np.abs(normal / asked - 1).max():.4f}", f"{expected:.3f}", f"{moved.min():.3f}", f"{moved.max():.3f}",
        f"{np.median(engine / normal):.3f}",
    ]  # fmt: skip


def _core_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


if __name__ == "__main__":
    sys.exit(main())
