"""An overview of a dataset from its bundles: printed by `show`, and the source of the dataset card and the report."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import check, dataset, run_status
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import move_text
from tacgen.bundle.scene_words import shape_text
from tacgen.recipe import assets
from tacgen.report.sensor_sheet import name_and_unit
from tacgen.report.sheet import counted
from tacgen.sensor.yaml_source import text_of

MAX_NAMED_VALUES = 12  # named of a varied quantity that is no number


@dataclass(frozen=True)
class SceneOverview(run_status.SceneStatus):
    """One scene; `bundle` is None if it cannot be read or does not exist yet."""

    bundle: Bundle | None = field(default=None, repr=False)

    @cached_property
    def peak_n(self) -> float | None:
        """Largest force [N]; None without a finite one."""
        if self.bundle is None or "/frames/force" not in self.bundle or not self.bundle.frames:
            return None
        largest = float(np.linalg.norm(self.bundle["/frames/force"], axis=1).max())
        return largest if np.isfinite(largest) else None


@dataclass(frozen=True)
class Overview(run_status.Survey):
    """All scenes of a folder, in order, and properties of the whole dataset."""

    scenes: tuple[SceneOverview, ...]
    bytes: int

    @property
    def bundles(self) -> list[Bundle]:
        """The bundles of scenes that are ok."""
        return [scene.bundle for scene in self.scenes if scene.bundle is not None and scene.state == "ok"]

    @property
    def frames(self) -> int:
        """Number of frames in scenes that are ok."""
        return sum(bundle.frames for bundle in self.bundles)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each stage, over all scenes whose times are known."""
        total: Counter[str] = Counter()
        for scene in self.scenes:
            total.update(scene.seconds)
        return dict(total.most_common())

    @property
    def costs(self) -> list[tuple[str, float, float]]:
        """Stage, seconds, seconds a frame of the scenes whose times are known, and their sums; empty without any."""
        timed = sum(scene.frames for scene in self.scenes if scene.seconds)
        rows = [*self.seconds.items(), ("all", sum(self.seconds.values()))]
        return [(stage, seconds, seconds / timed) for stage, seconds in rows] if timed else []

    def distinct(self, attribute: str) -> list[str]:
        """The different values of an attribute of the bundles, in order of first appearance."""
        return list(dict.fromkeys(str(b.attrs[attribute]) for b in self.bundles if attribute in b.attrs))

    @property
    def indenters(self) -> list[str]:
        """The different indenters: their shapes, or the files of meshes."""
        return list(dict.fromkeys(map(shape_name, self.bundles)))

    @property
    def datasets(self) -> dict[str, str]:
        """Path -> shape; sizes that differ between scenes are `*`."""
        shapes: dict[str, list[tuple[int, ...]]] = {}
        for bundle in self.bundles:
            for path, shape in bundle.shapes.items():
                shapes.setdefault(path, []).append(shape)
        return {path: _common(kinds) for path, kinds in sorted(shapes.items())}

    @property
    def varied(self) -> dict[str, list[Any]]:
        """Varied path -> its value in each planned scene."""
        paths = dict.fromkeys(path for scene in self.scenes for path in scene.values)
        return {path: [scene.values.get(path) for scene in self.scenes] for path in paths}

    @property
    def misfits(self) -> list[tuple[int, str]]:
        """Number of scenes with a map that misses the force by more than MAX_MISFIT, and a line about the worst."""
        each = [{name: v.max(initial=0.0) for name, v in check.misfits(bundle).items()} for bundle in self.bundles]
        out = {
            name: [largest[name] for largest in each if largest.get(name, 0.0) > check.MAX_MISFIT]
            for name in check.MISFIT_ROWS
        }
        return [(len(v), check.MISFIT_ROWS[name].format(f"up to {max(v):.2g}")) for name, v in out.items() if v]

    @property
    def folds(self) -> list[tuple[int, str]]:
        """Number of scenes with frames that are not unique, and a line that counts these; the same of scenes that end
        before such frames."""
        marked = [bundle for bundle in self.bundles if check.UNIQUE_PATH in bundle]
        folded = [int((~bundle[check.UNIQUE_PATH]).sum()) for bundle in marked if not bundle[check.UNIQUE_PATH].all()]
        short = [b for b in self.bundles if b.attrs["status"] == "ok" and b.frames < b.attrs["frames_planned"]]
        ways: tuple[Callable[[Bundle], Sequence[str]], ...] = (
            lambda bundle: [shape_name(bundle)] * bundle.frames,
            lambda bundle: bundle.segments,
        )
        shares = "; ".join(_folded(marked, names) for names in ways)
        of_all = f"in {sum(folded)} of {sum(bundle.frames for bundle in marked)} frames"
        kept = f"{check.FOLDED_NOTE} {of_all} (`/frames/quality/unique`): {shares}"
        ended = f"ended before the gel folds: {sum(b.frames for b in short)} frames are here"
        return [(len(each), text) for each, text in ((folded, kept), (short, ended)) if each]

    @property
    def objects(self) -> dict[str, str]:
        """Shipped objects that were used -> the line on their licence."""
        known = set(assets.list_objects())
        return {name: _licence(name) for name in self.indenters if name in known}


def shape_name(bundle: Bundle) -> str:
    """The indenter's shape, or the file of a mesh."""
    told = bundle.recipe.get("indenter", {})
    return str(told.get("file", told.get("shape", "?")))


def _folded(bundles: Sequence[Bundle], names: Callable[[Bundle], Sequence[str]]) -> str:
    """Frames that are not unique, of all, for each of the `names` of frames that has some."""
    every, folded = Counter[str](), Counter[str]()
    for bundle in bundles:
        of_frames = names(bundle)
        every.update(of_frames)
        folded.update(name for name, fine in zip(of_frames, bundle[check.UNIQUE_PATH], strict=False) if not fine)
    return ", ".join(f"{name} {count} of {every[name]}" for name, count in folded.most_common())


def look(folder: Path, known: Iterable[Bundle] = ()) -> Overview:
    """Read a folder of bundles, with or without a plan, or a packed folder; see run_status.opened for `known` ones.

    Raises:
        UserError: nothing to read; a packed folder that is incomplete.
    """
    if dataset.is_packed(folder):
        return of_bundles(dataset.scenes(folder), folder, dataset.read_index(folder).name)
    try:
        name, opened = run_status.opened(folder, known)
    except UserError:
        return of_bundles(dataset.scenes(folder), folder)
    scenes = tuple(SceneOverview(**vars(scene), bundle=bundle) for scene, bundle in opened)
    return Overview(name, folder, scenes, sum(scene.path.stat().st_size for scene in scenes if scene.path.exists()))


def summary(folder: Path) -> str:
    """A summary of a folder in a few lines of text."""
    seen = look(folder)
    states = ", ".join(f"{n} {state}" for state, n in seen.count().items())
    lines = [
        f"{folder}: {seen.name}, {counted(len(seen.scenes), 'scene')}",
        f"scenes    {states}",
        f"frames    {seen.frames}",
        f"size      {seen.bytes / 1e6:.1f} MB, written by tacgen {', '.join(seen.distinct('tacgen_version'))}",
        f"sensor    {', '.join(seen.distinct('sensor'))}; indenter {', '.join(seen.indenters)}",
    ]
    peaks = [scene.peak_n for scene in seen.scenes if scene.peak_n is not None]
    if peaks:
        lines.append(f"force     largest in a scene: {spread(peaks)} N")
    lines += [f"varied    {path}: {spread(values)}" for path, values in seen.varied.items()]
    if seen.seconds:
        stages = ", ".join(f"{stage} {value:.0f}" for stage, value in seen.seconds.items())
        lines.append(f"seconds   {sum(seen.seconds.values()):.0f} wall-clock ({stages})")
    width = max(map(len, seen.datasets), default=0) + 2
    return "\n".join(lines + [f"{path:<{width}}{shape}" for path, shape in seen.datasets.items()])


def spread(values: Sequence[Any]) -> str:
    """Summary of values: `0.3 to 1.2` for numbers, `draft (3), default (5)` for anything else, by frequency."""
    given = [value for value in values if value is not None]
    if given and all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        ends = [f"{end:.4g}" for end in (min(given), max(given))]
        return " to ".join(dict.fromkeys(ends))
    count = Counter(map(_named, given))
    shown = [f"{value} ({n})" if len(given) > 1 else value for value, n in count.most_common(MAX_NAMED_VALUES)]
    more = [f"and {len(count) - MAX_NAMED_VALUES} more"] if len(count) > MAX_NAMED_VALUES else []
    return ("; " if any("," in value for value in count) else ", ").join(shown + more)


def phrase(name: str, value: Any) -> str:
    """A varied value with its name and unit: `friction 0.5`, `x -2.39 mm`."""
    said, unit = name_and_unit(name)
    return f"{said} {spread([value])} {unit}".strip()


def _named(value: Any) -> str:
    """A value as text: an indenter and movements in words, the parts of all else by their names, with units."""
    if isinstance(value, dict):
        return shape_text(value) if "shape" in value else move_text(value) or _joined(starmap(phrase, value.items()))
    if isinstance(value, list):
        return _joined(map(_named, value))
    return value if isinstance(value, str) else f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


def _joined(parts: Iterable[str]) -> str:
    return ", ".join(parts) or "none"


def of_bundles(bundles: Sequence[Bundle], folder: Path, name: str = "") -> Overview:
    """The overview of some bundles below a folder; its name is by default that of their recipe."""
    scenes = []
    for bundle in bundles:
        attrs, named = bundle.attrs, bundle.group[1:] or bundle.path.stem
        values = json.loads(attrs.get("values", "{}"))
        facts = (named, attrs["status"], attrs["reason"], bundle.frames, bundle.path, values)
        scenes.append(SceneOverview(*facts, bundle=bundle))
    size = sum(path.stat().st_size for path in {bundle.path for bundle in bundles})
    return Overview(name or str(bundles[0].recipe.get("name", "")), folder, tuple(scenes), size)


def _common(shapes: list[tuple[int, ...]]) -> str:
    if len({len(shape) for shape in shapes}) > 1:
        return "*"
    return " x ".join(str(sizes[0]) if len(set(sizes)) == 1 else "*" for sizes in zip(*shapes, strict=True))


def _licence(name: str) -> str:
    """The line of an object's README that states its licence."""
    try:
        lines = text_of(assets.object_path(name) / "README.md").splitlines()
    except UserError:
        lines = []
    return next((line.lstrip("-* ") for line in lines if "licen" in line.lower()), "licence not stated")
