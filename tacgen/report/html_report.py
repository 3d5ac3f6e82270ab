"""A self-contained HTML page about a dataset: coverage, forces, scenes with filters, seconds by stage."""

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import combinations
from pathlib import Path

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.report import dataset_summary, html_page, scene_pages, svg_plots, viewer
from tacgen.report.dataset_summary import Overview, SceneOverview, shape_name
from tacgen.report.html_page import table
from tacgen.report.scene_pages import movement
from tacgen.report.sensor_sheet import name_and_unit
from tacgen.report.sheet import counted
from tacgen.sensor.yaml_source import shortest_ends

MAX_REPORT_PICTURES = 48
MAX_SCATTER_PLOTS = 15  # scatter plots of two varied numbers
MAX_MOVEMENT_ROWS = 8  # rows of force curves
MAX_SHAPE_COLOURS = 8  # shapes with a colour of their own in the curves: c0 to c7 of page.css
STATES = ("ok", "rejected", "failed", "damaged")  # with a colour of page.css


def write(folder: Path, out: Path, target: Path | None = None) -> Path:
    """Write the page, signed, and beside `target`, by default `out`, the pages to which its pictures lead.

    Raises UserError if `folder` holds no scenes.
    """
    seen = dataset_summary.look(folder)
    bundles = [scene.bundle for scene in pictured(seen.scenes) if scene.bundle is not None]
    links = scene_pages.write_pages(bundles, target or out, in_3d=False)
    output_file.add(out, output_file.signed(page(seen, links)))
    return out


def page(seen: Overview, links: Mapping[str, str] | None = None) -> str:
    """The page's HTML; it needs no network. `links`: scene -> the page to which its picture leads."""
    title = escape(f"{seen.name}: {counted(len(seen.scenes), 'scene')}, {seen.frames} frames")
    sections = {
        "Overview": _overview(seen),
        "Coverage": _coverage(seen),
        "Forces": _forces(seen.scenes),
        "Scenes": _scenes(seen, links or {}),
        "A scene frame by frame": _frames(seen.scenes),
        "Seconds": _seconds(seen),
        "Datasets": _datasets(seen.datasets),
    }
    shown = {name: content for name, content in sections.items() if content}
    bar = "".join(f'<a href="#{name.split()[-1]}">{name}</a>' for name in shown)
    body = "".join(f"<h2 id={name.split()[-1]}>{name}</h2>{content}" for name, content in shown.items())
    body = f"<div class=report><div class=toolbar><h1>{title}</h1>{bar}</div><main>{body}</main></div>"
    return html_page.page(title, body) + "\n"


def causes(scenes: Iterable[SceneOverview]) -> dict[tuple[str, str], list[str]]:
    """(state, reason with numbers replaced by #) -> names of scenes, most frequent first."""
    affected: dict[tuple[str, str], list[str]] = {}
    for scene in scenes:
        if scene.state != "ok":
            reason = re.sub(r"-?\d[\d.e+-]*", "#", scene.reason)
            affected.setdefault((scene.state, reason), []).append(scene.name)
    return dict(sorted(affected.items(), key=lambda item: -len(item[1])))


def _overview(seen: Overview) -> str:
    """Counts as tiles, what made the data, and failures by cause."""
    counts = {f"{state} scenes": str(n) for state, n in seen.count().items()}
    counts |= {"frames": str(seen.frames), "size": f"{seen.bytes / 1e6:.1f} MB"}
    tiles = "".join(f"<div class=card><b>{count}</b>{escape(name)}</div>" for name, count in counts.items())
    rows = [("indenter", ", ".join(seen.indenters))]
    for name in ("sensor", "solver", "renderer", "tacgen_version"):
        rows.append((name.replace("_", " "), ", ".join(seen.distinct(name))))
    facts = table((), [row for row in rows if row[1]])
    failed = []
    for (state, reason), names in causes(seen.scenes).items():
        shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        failed.append((len(names), state, reason or "not made yet", shown))
    why = f"<h2>Failures by cause</h2>{table(('scenes', 'state', 'cause', ''), failed)}" if failed else ""
    return f"<div class=tiles>{tiles}</div>{facts}{why}"


def _coverage(seen: Overview) -> str:
    """Histograms of each varied number and of the largest force, and scatter plots of pairs of varied numbers, a point
    for each scene, coloured by its state."""
    numbers = {p: np.array(v, float) for p, v in seen.varied.items() if all(isinstance(x, int | float) for x in v)}
    colours = [scene.state if scene.state in STATES else "other" for scene in seen.scenes]
    names = {path: "{} [{}]".format(*name_and_unit(name)) for path, name in shortest_ends(seen.varied).items()}
    names = {path: name.removesuffix(" []") for path, name in names.items()}
    rows = [(path, dataset_summary.spread(values)) for path, values in seen.varied.items()]
    plots = [svg_plots.histogram(names[path], values) for path, values in numbers.items()]
    if peaks := [scene.peak_n for scene in seen.scenes if scene.peak_n is not None]:
        plots.append(svg_plots.histogram("largest force in a scene [N]", np.array(peaks)))
    pairs = list(combinations(numbers.items(), 2))[:MAX_SCATTER_PLOTS]
    plots += [svg_plots.scatter(names[a], x, names[b], y, colours) for (a, x), (b, y) in pairs]
    key = _key({state: state for state in STATES if state in colours}) if pairs and len(set(colours)) > 1 else ""
    return f"{table(('varied', 'values'), rows) if rows else ''}{key}{_plots(plots)}"


def _forces(scenes: Sequence[SceneOverview]) -> str:
    """Force curves of all pictured scenes: a row for each movement, a colour for each shape."""
    known = [s.bundle for s in pictured(scenes) if s.bundle is not None and s.peak_n is not None]
    if not known:
        return ""
    shapes = list(dict.fromkeys(map(shape_name, known)))
    colours = {shape: f"c{k}" if k < MAX_SHAPE_COLOURS else "other" for k, shape in enumerate(shapes)}
    rows: dict[str, list[Bundle]] = {}
    for bundle in known:
        rows.setdefault(movement(bundle), []).append(bundle)
    every = np.concatenate([bundle["/frames/force"] for bundle in known])
    side, normal = ((float(part.min(initial=0)), float(part.max(initial=0))) for part in (every[:, :2], every[:, 2]))
    shown = ""
    for moves, bundles in list(rows.items())[:MAX_MOVEMENT_ROWS]:
        longest, plots = max(bundles, key=lambda bundle: bundle.frames), []
        for axis, span in enumerate((side, side, normal)):
            series = [(colours[shape_name(bundle)], bundle["/frames/force"][:, axis]) for bundle in bundles]
            plots.append(svg_plots.curves(f"F{'xyz'[axis]} [N]", series, span, longest.segments))
        shown += f"<h3>{escape(moves)}: {counted(len(bundles), 'scene')}</h3>{_plots(plots)}"
    left = f"; {len(rows) - MAX_MOVEMENT_ROWS} more movements are not shown" * (len(rows) > MAX_MOVEMENT_ROWS)
    told = "Force on the gel over the frames of each scene; Fx and Fy have one scale"
    return f"<p class=soft>{told}{left}.</p>{_key(colours)}<div class=forces>{shown}</div>"


def _plots(plots: Sequence[str]) -> str:
    return f"<div class=plots>{''.join(plots)}</div>" if plots else ""


def _key(colours: Mapping[str, str]) -> str:
    """Names with a dot of the colour that stands for them."""
    dots = (f"<span><span class={colour}>&#9679;</span> {escape(name)}</span>" for name, colour in colours.items())
    return f"<div class=key>{''.join(dots)}</div>"


def _seconds(seen: Overview) -> str:
    rows = []
    for stage, seconds, each in seen.costs:
        share = 100 * seconds / max(seen.costs[-1][1], 1e-9)
        bar = "" if stage == "all" else f'<div class=bar style="width:{share:.1f}%"></div>'
        rows.append((stage, f"{seconds:.1f} s", f"{each:.3f} s", bar))
    head = ("stage", "wall-clock", "a frame", "")
    return f"<div class=stages>{table(head, rows, raw=1)}</div>" if rows else ""


def _datasets(shapes: Mapping[str, str]) -> str:
    listed = table(("dataset", "shape"), shapes.items())
    return f"<details><summary>{counted(len(shapes), 'dataset')} a scene</summary>{listed}</details>" if shapes else ""


def pictured(scenes: Sequence[SceneOverview]) -> list[SceneOverview]:
    """Scenes with frames, evenly spread over the plan."""
    good = [scene for scene in scenes if scene.bundle is not None and scene.bundle.frames]
    step = max(1.0, len(good) / MAX_REPORT_PICTURES)
    return [good[int(i * step)] for i in range(min(len(good), MAX_REPORT_PICTURES))]


def _scenes(seen: Overview, links: Mapping[str, str]) -> str:
    """Scenes, each with its image at its largest force, and their filters."""
    shown = pictured(seen.scenes)
    if not shown:
        return ""
    bar = f"<div class=toolbar>{scene_pages.filters(shown)}</div>"
    return f"{bar}{scene_pages.cards(seen, shown, links)}<script>{html_page.asset('scenes.js')}</script>"


def _frames(scenes: Sequence[SceneOverview]) -> str:
    """The first scene that is ok, in the viewer, without the 3D view of `tacgen view`."""
    bundle = next((s.bundle for s in scenes if s.state == "ok" and s.bundle is not None and s.bundle.frames), None)
    try:
        return viewer.block([bundle], in_3d=False) if bundle else ""
    except UserError as error:
        return f"<p>{escape(str(error))}</p>"
