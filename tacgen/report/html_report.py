"""A self-contained HTML page about a dataset: coverage, forces, failures by cause, seconds by stage, images."""

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.force_error import force_error
from tacgen.bundle.image_file import encoded
from tacgen.report import dataset_summary, html_page, scene_pages, viewer
from tacgen.report.dataset_summary import Overview, SceneOverview
from tacgen.report.sheet import counted, round_ticks, short

MAX_REPORT_PICTURES = 48
PICTURE_WIDTH_PX = 160  # [px]
MAX_SCATTER_PLOTS = 15  # scatter plots of two varied numbers
STATE_COLOURS = {"ok": "#0072b2", "rejected": "#e69f00", "failed": "#d55e00", "damaged": "#cc79a7"}
OTHER_COLOUR = "#999999"  # of scenes at work or waiting


def write(folder: Path, out: Path, target: Path | None = None) -> Path:
    """Write the page, signed, and beside `target`, by default `out`, the pages to which its pictures lead.

    Raises UserError if `folder` holds no scenes.
    """
    seen = dataset_summary.look(folder)
    bundles = [scene.bundle for scene in pictured(seen) if scene.bundle is not None]
    links = scene_pages.write_pages(bundles, target or out, in_3d=False)
    output_file.add(out, output_file.signed(page(seen, links)))
    return out


def page(seen: Overview, links: Mapping[str, str] | None = None) -> str:
    """The page's HTML; it needs no network. `links`: scene -> the page to which its picture leads."""
    title = escape(f"{seen.name}: {counted(len(seen.scenes), 'scene')}, {seen.frames} frames")
    sections = [
        ("Scenes", _states(seen)),
        ("Failures by cause", _causes(seen.scenes)),
        ("Coverage", _coverage(seen)),
        ("Largest force in a scene", _forces(seen.scenes)),
        ("Wall-clock seconds by stage", _seconds(seen)),
        ("Pictures", _pictures(seen, links or {})),
        ("A scene frame by frame", _frames(seen.scenes)),
        ("Datasets", _table(("dataset", "shape"), seen.datasets.items())),
    ]
    body = "".join(f"<h2>{name}</h2>{content}" for name, content in sections if content)
    style = html_page.asset("report.css") + html_page.asset("viewer.css")
    return html_page.page(title, style, f"<h1>{title}</h1>{body}") + "\n"


def causes(scenes: Iterable[SceneOverview]) -> dict[tuple[str, str], list[str]]:
    """(state, reason with numbers replaced by #) -> names of scenes, most frequent first."""
    affected: dict[tuple[str, str], list[str]] = {}
    for scene in scenes:
        if scene.state != "ok":
            reason = re.sub(r"-?\d[\d.e+-]*", "#", scene.reason)
            affected.setdefault((scene.state, reason), []).append(scene.name)
    return dict(sorted(affected.items(), key=lambda item: -len(item[1])))


def _states(seen: Overview) -> str:
    rows = [(state, str(n)) for state, n in seen.count().items()]
    rows.append(("size", f"{seen.bytes / 1e6:.1f} MB"))
    rows += [(name, ", ".join(seen.distinct(name))) for name in ("sensor", "tacgen_version", "solver", "renderer")]
    rows.append(("indenter", ", ".join(seen.indenters)))
    return _table(("", ""), [row for row in rows if row[1]])


def _causes(scenes: Sequence[SceneOverview]) -> str:
    rows = []
    for (state, reason), names in causes(scenes).items():
        shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        rows.append((str(len(names)), state, reason or "not made yet", shown))
    return _table(("scenes", "state", "cause", ""), rows) if rows else "<p>None: all scenes are finished.</p>"


def _coverage(seen: Overview) -> str:
    """A histogram of each varied number, and scatter plots of pairs, one point per scene, coloured by its state."""
    numbers = {p: v for p, v in seen.varied.items() if all(isinstance(x, int | float) for x in v)}
    colours = [STATE_COLOURS.get(scene.state, OTHER_COLOUR) for scene in seen.scenes]
    names = short(seen.varied)
    rows = [(path, dataset_summary.spread(values)) for path, values in seen.varied.items()]
    bars = [_histogram(names[path], np.array(values, float)) for path, values in numbers.items()]
    plots = []
    for (a, x), (b, y) in list(combinations(numbers.items(), 2))[:MAX_SCATTER_PLOTS]:
        plots.append(_scatter(names[a], np.array(x, float), names[b], np.array(y, float), colours))
    key = " ".join(f'<span style="color:{colour}">&#9679; {state}</span>' for state, colour in STATE_COLOURS.items())
    shown = _table(("varied", "values"), rows) + f"<p>{key}</p>" + "".join(bars) + f"<div>{''.join(plots)}</div>"
    return shown if rows else ""


def _forces(scenes: Sequence[SceneOverview]) -> str:
    peaks = [scene.peak_n for scene in scenes if scene.peak_n is not None]
    return _histogram("force [N]", np.array(peaks)) if peaks else ""


def _seconds(seen: Overview) -> str:
    rows = []
    for stage, seconds, each in seen.costs:
        width = 300 * seconds / max(seen.costs[-1][1], 1e-9)
        bar = f'<svg width=300 height=12><rect width={width:.1f} height=12 fill="#0072b2"/></svg>'
        rows.append((escape(stage), f"{seconds:.1f} s", f"{each:.3f} s a frame", "" if stage == "all" else bar))
    return _table(("stage", "", "", ""), rows, raw=True) if rows else ""


def pictured(seen: Overview) -> list[SceneOverview]:
    """Scenes with frames, evenly spread over the plan."""
    good = [scene for scene in seen.scenes if scene.bundle is not None and scene.bundle.frames]
    step = max(1.0, len(good) / MAX_REPORT_PICTURES)
    return [good[int(i * step)] for i in range(min(len(good), MAX_REPORT_PICTURES))]


def _pictures(seen: Overview, links: Mapping[str, str]) -> str:
    """Images of scenes, each at the frame of its largest force, and a link to that frame."""
    names = short(seen.varied)
    shown = []
    for scene in pictured(seen):
        assert scene.bundle is not None
        picture = _picture(scene.bundle)
        if picture:
            values = "<br>".join(escape(f"{names[p]} {dataset_summary.spread([v])}") for p, v in scene.values.items())
            force = "" if scene.peak_n is None else f"{scene.peak_n:.3g} N"
            marks, error = viewer.marks(scene.bundle), force_error(scene.bundle)
            if error and viewer.LARGEST_FORCE_LABEL in marks:
                force = f"{force} {error.text(marks[viewer.LARGEST_FORCE_LABEL])}"
            if link := links.get(scene_pages.name_of(scene.bundle)):
                picture = f'<a href="{link}#frame={marks.get(viewer.LARGEST_FORCE_LABEL, 0)}">{picture}</a>'
            shown.append(
                f"<figure>{picture}<b>{escape(scene.name)}</b>{_finger(scene.bundle)} {force}<br>{values}</figure>"
            )
    return "".join(shown)


def _finger(bundle: Bundle) -> str:
    """` left finger` or ` right finger` of a grasp, otherwise nothing."""
    return f" {escape(bundle.attrs['finger'])} finger" if "finger" in bundle.attrs else ""


def _frames(scenes: Sequence[SceneOverview]) -> str:
    """The first scene that is ok, in the viewer, without the 3D view of `tacgen view`."""
    bundle = next((s.bundle for s in scenes if s.state == "ok" and s.bundle is not None and s.bundle.frames), None)
    try:
        return viewer.block([bundle], in_3d=False) if bundle else ""
    except UserError as error:
        return f"<p>{escape(str(error))}</p>"


def _picture(bundle: Bundle) -> str:
    """The camera image, or else the pressure in grey, as an HTML element."""
    k = int(np.linalg.norm(bundle["/frames/force"], axis=1).argmax()) if "/frames/force" in bundle else -1
    if "/frames/rgb" in bundle:
        pixels = bundle.frame("/frames/rgb", k % bundle.frames)
    elif "/frames/pressure" in bundle:
        pressure = bundle.frame("/frames/pressure", k % bundle.frames)
        pixels = (255 * np.clip(pressure / max(float(pressure.max()), 1e-9), 0, 1)).astype(np.uint8)
    else:
        return ""
    content = base64.b64encode(encoded(pixels, "JPEG", PICTURE_WIDTH_PX, quality=85)).decode()
    return f'<img alt="" src="data:image/jpeg;base64,{content}">'


def _histogram(name: str, values: np.ndarray) -> str:
    """A histogram as SVG, labelled with the ends of the range and the largest count."""
    count, edges = np.histogram(values, bins=min(20, max(5, len(values) // 3)))
    width, height = 220, 90
    step = width / len(count)
    bars = "".join(
        f"<rect x={10 + i * step:.1f} y={15 + height * (1 - n / count.max()):.1f} width={step - 1:.1f} "
        f'height={height * n / count.max():.1f} fill="#0072b2"/>'
        for i, n in enumerate(count)
    )
    ends = f"<text x=10 y=120>{edges[0]:.3g}</text><text x=230 y=120 text-anchor=end>{edges[-1]:.3g}</text>"
    name = f"<text x=120 y=135 text-anchor=middle>{_label(name)}</text>"
    top = f"{name}<text x=10 y=11>{counted(int(count.max()), 'scene')}</text>"
    return f"<svg width=240 height=140>{bars}{ends}{top}</svg>"


def _scatter(a: str, x: np.ndarray, b: str, y: np.ndarray, colours: Sequence[str]) -> str:
    """A scatter plot as SVG, with both names and ticks at round numbers."""

    def at(v: np.ndarray, value: Any) -> Any:
        """Pixels of the plot from the least of v."""
        return 180 * (value - v.min()) / max(float(np.ptp(v)), 1e-12)

    points = "".join(
        f'<circle cx={70 + right:.1f} cy={195 - up:.1f} r=2.2 fill="{colour}" fill-opacity=.7 />'
        for right, up, colour in zip(at(x, x), at(y, y), colours, strict=True)
    )
    frame = '<rect x=65 y=10 width=190 height=190 fill="none" stroke="#bbb"/>'
    ticks = "".join(
        f'<path d="M{70 + at(x, v):.1f} 200v4" stroke="#bbb"/>'
        f"<text x={70 + at(x, v):.1f} y=215 text-anchor=middle>{v:g}</text>"
        for v in round_ticks(x.min(), x.max(), 5)
    )
    ticks += "".join(
        f'<path d="M65 {195 - at(y, v):.1f}h-4" stroke="#bbb"/>'
        f"<text x=59 y={199 - at(y, v):.1f} text-anchor=end>{v:g}</text>"
        for v in round_ticks(y.min(), y.max(), 5)
    )
    under = f"<text x=160 y=231 text-anchor=middle>{_label(a)}</text>"
    beside = f'<text transform="translate(11 105) rotate(-90)" text-anchor=middle>{_label(b)}</text>'
    return f"<svg width=270 height=237>{frame}{ticks}{points}{under}{beside}</svg>"


def _label(name: str) -> str:
    """A name, cut at the left if it is long."""
    return escape(name if len(name) <= 32 else "\N{HORIZONTAL ELLIPSIS}" + name[-30:])


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]], *, raw: bool = False) -> str:
    def cells(row: Sequence[Any], tag: str) -> str:
        return "".join(f"<{tag}>{cell if raw else escape(str(cell))}</{tag}>" for cell in row)

    top = f"<tr>{cells(head, 'th')}</tr>" if any(head) else ""
    return f"<table>{top}" + "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows) + "</table>"
