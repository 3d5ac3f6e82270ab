"""Pages of a data set's scenes: one page a scene, and a list of them with filters and jumps to telling frames."""

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import indenter_text, sensor_text
from tacgen.bundle.force_error import force_error
from tacgen.report import dataset_summary, html_page, viewer
from tacgen.report.dataset_summary import Overview, SceneOverview, spread
from tacgen.report.sheet import counted, short

MAX_SCENE_PAGES = 200  # scenes with a page; of more, all that are rejected first, and others evenly spread
PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-src file: http: https:"


def write_pages(bundles: Iterable[Bundle], page: Path, *, in_3d: bool) -> dict[str, str]:
    """Write a page of each bundle with frames into a folder beside `page`, named after it.

    Returns:
        scene -> link from `page` to its page.

    Raises:
        UserError: a file that tacgen did not write has the name of a page.
        OSError: a page cannot be written.
    """
    folder = page.with_name(f"{page.stem}_scenes")
    links = {}
    for bundle in bundles:
        if not bundle.frames:
            continue
        name = name_of(bundle)
        with output_file.written(folder / f"{name}.html", within=page.parent, kind="page") as new:
            output_file.add(new, output_file.signed(viewer.page([bundle], in_3d=in_3d)))
        links[name] = f"{quote(folder.name)}/{quote(name)}.html"
    return links


def name_of(bundle: Bundle) -> str:
    """The name of a bundle's scene, in a shard too."""
    return bundle.path.stem if bundle.group == "/" else bundle.group.strip("/")


def write(folder: Path, out: Path, real_out: Path) -> int:
    """Write the list of a folder's scenes, which has the name `real_out` in the end, and their pages.

    Returns:
        the number of scenes without a page, because there are too many.

    Raises:
        UserError: no scene of the folder has frames.
    """
    seen = dataset_summary.look(folder)
    chosen = _chosen([scene for scene in seen.scenes if scene.bundle is not None and scene.bundle.frames])
    if not chosen:
        raise UserError(f"{folder}: no scene has frames to show")
    links = write_pages([scene.bundle for scene in chosen if scene.bundle], real_out, in_3d=True)
    left = len(seen.scenes) - len(chosen)
    output_file.add(out, output_file.signed(_page(seen, chosen, links, left)))
    return left


def _chosen(scenes: Sequence[SceneOverview]) -> list[SceneOverview]:
    """At most MAX_SCENE_PAGES scenes in their order: the rejected ones, then others evenly spread."""
    odd = [scene for scene in scenes if scene.state != "ok"][:MAX_SCENE_PAGES]
    good = [scene for scene in scenes if scene.state == "ok"]
    count = min(len(good), MAX_SCENE_PAGES - len(odd))
    kept = {id(scene) for scene in [*odd, *(good[i * len(good) // count] for i in range(count))]}
    return [scene for scene in scenes if id(scene) in kept]


def _page(seen: Overview, scenes: Sequence[SceneOverview], links: dict[str, str], left: int) -> str:
    title = escape(f"{seen.name}: {counted(len(seen.scenes), 'scene')}")
    names = short(seen.varied)
    items = "".join(_item(i, scene, links, names) for i, scene in enumerate(scenes))
    states = "".join(f"<option>{state}</option>" for state in dict.fromkeys(scene.state for scene in scenes))
    more = (
        f"<p>{counted(left, 'scene')} without frames, or left out: at most {MAX_SCENE_PAGES} have pages.</p>"
        if left
        else ""
    )
    filters = (
        '<label>words <input id=words type=search placeholder="sphere digit"></label>'
        f'<label>state <select id=state><option value="">all</option>{states}</select></label>'
        "<label>force at least <input id=least type=number min=0 step=0.1 style='width:5em'> N</label>"
        "<label>order <select id=order><option value=plan>of the plan</option>"
        "<option value=force>largest force</option></select></label><p id=count></p>"
    )
    body = f"<nav><h1>{title}</h1>{filters}{more}<ol>{items}</ol></nav><iframe name=scene title=scene></iframe>"
    body += f"<script>{html_page.asset('scenes.js')}</script>"
    return html_page.page(title, html_page.asset("scenes.css"), body, PAGE_POLICY)


def _item(index: int, scene: SceneOverview, links: dict[str, str], names: dict[str, str]) -> str:
    """One scene of the list: its name, what it is, and links to its telling frames."""
    bundle = scene.bundle
    assert bundle is not None
    link, about = links[name_of(bundle)], f"{indenter_text(bundle)}, on {sensor_text(bundle)}"
    values = ", ".join(f"{names[path]} {spread([value])}" for path, value in scene.values.items())
    jumps = "".join(
        f'<a target=scene href="{link}#frame={frame}">{escape(what)} ({frame})</a>'
        for what, frame in viewer.marks(bundle).items()
    )
    error = force_error(bundle)
    peak = "" if scene.peak_n is None else f"{scene.peak_n:.3g} N"
    if error and (largest := viewer.marks(bundle).get(viewer.LARGEST_FORCE_LABEL)) is not None:
        peak = f"{peak} {error.text(largest)}"
    why = f"<div class=why>{escape(scene.reason)}</div>" if scene.reason else ""
    words = f"{scene.name} {about} {values} {scene.reason}".lower()
    data = f'data-index={index} data-state="{scene.state}" data-peak="{scene.peak_n or 0:.6g}"'
    first = f'<a target=scene href="{link}"><b>{escape(scene.name)}</b></a>'
    text = f"{first}{peak}<div>{escape(about)}</div><div>{escape(values)}</div>{why}{jumps}"
    return f'<li class="{scene.state}" {data} data-words="{escape(words)}">{text}</li>'
