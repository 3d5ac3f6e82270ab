"""The dataset card, README.md in a dataset's folder: contents, size, cost, limits and licence."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from tacgen.base import atomic_file, output_file
from tacgen.base.errors import UserError, printable
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.check import NO_CONTACT_NOTE
from tacgen.bundle.dataset import CARD_FILES
from tacgen.report import dataset_summary
from tacgen.report.dataset_summary import Overview

CARD_FILE, SECOND_CARD_FILE = CARD_FILES
MAX_REASON_ROWS = 20  # most rows in the table of missing scenes


def write(folder: Path, known: Iterable[Bundle] = ()) -> Path:
    """Write the card of a folder that has a finished scene, and return its path; `known` bundles of it are not opened
    again.

    It is README.md or, if that was not written by tacgen or was changed since, DATASET_CARD.md.

    Raises:
        UserError: neither is tacgen's.
    """
    content = output_file.signed(text(dataset_summary.look(folder, known)))
    for path in (folder / CARD_FILE, folder / SECOND_CARD_FILE):
        if not os.path.lexists(path) or output_file.is_unchanged_page(path):
            atomic_file.write(path, content)
            return path
    raise UserError(f"{folder}: no card written: {CARD_FILE} and {SECOND_CARD_FILE} are not as tacgen wrote them")


def text(seen: Overview, licence: str = "") -> str:
    """The card in Markdown; `licence` is the identifier of the one under which the data are published."""
    parts = [_what(seen), _varied(seen), _cost(seen), _missing(seen), _contents(seen)]
    parts += [_splits(seen), _limits(seen), _licence(seen, licence), _again(seen)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _what(seen: Overview) -> str:
    states = ", ".join(f"{n} {state}" for state, n in seen.count().items())
    rows = [
        ("Scenes", f"{len(seen.scenes)} ({states})"),
        ("Frames", str(seen.frames)),
        ("Size", f"{seen.bytes / 1e6:.1f} MB"),
        ("Sensor", ", ".join(seen.distinct("sensor"))),
        ("Indenter", ", ".join(seen.indenters)),
        ("Made by", "tacgen " + ", ".join(seen.distinct("tacgen_version"))),
        ("Rendered by", "; ".join(seen.distinct("renderer"))),
    ]
    about = "Synthetic data of a vision-based tactile sensor: finite elements, contact and light transport."
    return f"# {_plain(seen.name)}\n\n{about}\n\n" + _table(("", ""), [row for row in rows if row[1]])


def _varied(seen: Overview) -> str:
    rows = [(f"`{path}`", dataset_summary.spread(values)) for path, values in seen.varied.items()]
    return "## Varied inputs\n\n" + _table(("path", "values"), rows) if rows else ""


def _cost(seen: Overview) -> str:
    rows = [(stage, f"{seconds:.1f}", f"{each:.3f}") for stage, seconds, each in seen.costs]
    return "## Cost in wall-clock seconds\n\n" + _table(("stage", "seconds", "seconds a frame"), rows) if rows else ""


def _missing(seen: Overview) -> str:
    rows = [(scene.name, scene.state, scene.reason) for scene in seen.scenes if scene.state != "ok"]
    if not rows:
        return ""
    left = len(rows) - MAX_REASON_ROWS
    more = f"\n\nand {left} more: `tacgen status` names all" if left > 0 else ""
    return "## Missing scenes\n\n" + _table(("scene", "state", "reason"), rows[:MAX_REASON_ROWS]) + more


def _contents(seen: Overview) -> str:
    rows = [(f"`{path}`", shape) for path, shape in seen.datasets.items() if not path.startswith("/frames/quality/")]
    note = "Units mm, N, MPa, s; sensor frame: x right and y down in the image, z out of the gel."
    return f"## Datasets of a scene\n\n{note}\n\n" + _table(("dataset", "shape"), rows) if rows else ""


def _splits(seen: Overview) -> str:
    if len(seen.bundles) < 2:
        return ""
    return (
        "## Splits\n\nFrames of one scene are similar: split by scenes, not by frames. "
        '`tacgen.torch.TactileDataset(folder, split="train")`, `"val"` and `"test"` hold 80, 10 and 10 % of the '
        "scenes, chosen by their inputs and a seed: the same ones on every machine."
    )


def _limits(seen: Overview) -> str:
    said = (note for bundle in seen.bundles for note in json.loads(bundle.attrs.get("notes", "[]")))
    # each has its own distance
    notes = Counter(NO_CONTACT_NOTE if note.startswith(NO_CONTACT_NOTE) else note for note in said)
    rows = [(str(n), note) for n, note in [*seen.folds, *seen.misfits]]
    rows += [(str(n), note) for note, n in notes.most_common(MAX_REASON_ROWS)]
    about = "Simulated data; `docs/LIMITS.md` of tacgen lists the known errors."
    return f"## Known limits\n\n{about}" + ("\n\n" + _table(("scenes", "note"), rows) if rows else "")


def _licence(seen: Overview, licence: str) -> str:
    chosen = f"This data is published under {_plain(licence)}."
    owner = chosen if licence else "Whoever publishes this data chooses its licence."
    lines = ["## Licence", f"tacgen's authors claim no rights in its output. {owner}"]
    lines += [f"- Object `{name}`: {_plain(about)}" for name, about in seen.objects.items()]
    return "\n\n".join(lines[:2]) + ("\n\n" + "\n".join(lines[2:]) if lines[2:] else "")


def _again(seen: Overview) -> str:
    if not seen.bundles:
        return ""
    return (
        "## Reproducibility\n\nEach bundle holds its recipe, sensor and seed. Equal digests mean equal contents. "
        f"The digest of all scenes in order is `{digest(seen.bundles)}`."
    )


def digest(bundles: Sequence[Bundle]) -> str:
    """SHA-256 over the digests of all scenes in order."""
    return hashlib.sha256("".join(str(bundle.attrs["digest"]) for bundle in bundles).encode()).hexdigest()


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(_plain, line)) + " |" for line in lines)


def _plain(text: str) -> str:
    """Text from a bundle, escaped for a Markdown table and for HTML."""
    return printable(" ".join(text.split())).replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
