"""Pages of a data set's scenes: one page a scene, and a list of them with filters and jumps to telling frames."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import scene_text
from tacgen.bundle.force_error import force_error
from tacgen.bundle.image_file import encoded
from tacgen.report import dataset_summary, html_page, viewer
from tacgen.report.dataset_summary import Overview, SceneOverview, shape_name
from tacgen.report.sheet import counted
from tacgen.sensor.yaml_source import shortest_ends

MAX_SCENE_PAGES = 200  # scenes with a page; of more, all that are rejected first, and others evenly spread
PICTURE_WIDTH_PX = 240  # of a scene in a list [px]
PAGE_POLICY = f"{viewer.VIEWER_POLICY}; frame-src file: http: https:"


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


def _page(seen: Overview, scenes: Sequence[SceneOverview], links: Mapping[str, str], left: int) -> str:
    title = escape(f"{seen.name}: {counted(len(seen.scenes), 'scene')}")
    text = f"{counted(left, 'scene')} without frames, or left out: at most {MAX_SCENE_PAGES} have pages"
    more = f"<p class=soft>{text}.</p>" if left else ""
    body = (
        f"<div class=list><div class=toolbar><h1>{title}</h1>{filters(scenes)}</div>"
        f"<nav>{more}{cards(seen, scenes, links)}</nav><iframe name=scene title=scene></iframe></div>"
        f"<script>{html_page.asset('scenes.js')}</script>"
    )
    return html_page.page(title, body, PAGE_POLICY)


def filters(scenes: Sequence[SceneOverview]) -> str:
    """Filters and the order of `cards`, for scenes.js; what all scenes share has none."""
    known = [scene.bundle for scene in scenes if scene.bundle is not None]
    kinds: dict[str, Iterable[str]] = {
        "shape": map(shape_name, known),
        "movement": map(movement, known),
        "state": (scene.state for scene in scenes),
    }
    found = '<label>find <input id=words type=search placeholder="sphere 0.3"></label>'
    for name, values in kinds.items():
        different = dict.fromkeys(values)
        all_and_each = {"": "all"} | {value: value for value in different}
        found += html_page.choice(name, name, all_and_each) if len(different) > 1 else ""
    found += "<label>force at least <input id=least type=number min=0 step=0.1> N</label>"
    order = {"index": "as planned", "peak": "largest force"}
    return f"{found}{html_page.choice('order', 'order', order)}<span class=soft id=count></span>"


def cards(seen: Overview, scenes: Iterable[SceneOverview], links: Mapping[str, str]) -> str:
    """A list of scenes with bundles: picture, name, largest force, what happens in words, links to telling frames."""
    names = shortest_ends(seen.varied)
    return f"<ol class=scenes>{''.join(_card(i, scene, links, names) for i, scene in enumerate(scenes))}</ol>"


def movement(bundle: Bundle) -> str:
    """The kinds of a bundle's movements, in order: `press, slide`."""
    return ", ".join(dict.fromkeys(bundle.segments))


def _card(index: int, scene: SceneOverview, links: Mapping[str, str], names: Mapping[str, str]) -> str:
    bundle = scene.bundle
    assert bundle is not None
    link, marks, error = links.get(name_of(bundle), ""), viewer.marks(bundle), force_error(bundle)
    largest = marks.get(viewer.LARGEST_FORCE_LABEL)
    peak = "" if scene.peak_n is None else f"{scene.peak_n:.3g} N"
    if error and largest is not None:
        peak = f"{peak} {error.text(largest)}"

    def linked(content: str, frame: int) -> str:
        return f'<a target=scene href="{link}#frame={frame}">{content}</a>' if link else content

    told = {path: value for path, value in scene.values.items() if path not in ("indenter", "trajectory")}
    values = ", ".join(dataset_summary.phrase(names[path], value) for path, value in told.items())
    jumps = "".join(linked(f"{escape(what)} ({frame})", frame) for what, frame in marks.items())
    words = f"{scene.name} {scene_text(bundle)} {values} {scene.reason}"
    lines = [
        f"<p><b>{linked(escape(scene.name), 0)}</b><span>{peak}</span></p>",
        f"<p>{escape(scene_text(bundle))}</p>",
        f"<p class=soft>{escape(values)}</p>" if values else "",
        f"<p class=bad>{escape(scene.reason)}</p>" if scene.reason else "",
        f"<p class=jumps>{jumps}</p>" if link else "",
    ]
    facts = {"words": words.lower(), "shape": shape_name(bundle), "movement": movement(bundle), "state": scene.state}
    facts |= {"index": str(index), "peak": f"{scene.peak_n or 0:.6g}"}
    data = " ".join(f'data-{name}="{escape(fact)}"' for name, fact in facts.items())
    return f"<li class=scene {data}>{linked(_picture(bundle), largest or 0)}<div>{''.join(lines)}</div></li>"


def _picture(bundle: Bundle) -> str:
    """The camera image, or else the pressure in grey, at the largest force, as an HTML element."""
    k = viewer.marks(bundle).get(viewer.LARGEST_FORCE_LABEL, bundle.frames - 1)
    if "/frames/rgb" in bundle:
        pixels = bundle.frame("/frames/rgb", k)
    elif "/frames/pressure" in bundle:
        pressure = bundle.frame("/frames/pressure", k)
        pixels = (255 * np.clip(pressure / max(float(pressure.max()), 1e-9), 0, 1)).astype(np.uint8)
    else:
        return ""
    content = base64.b64encode(encoded(pixels, "JPEG", PICTURE_WIDTH_PX, quality=85)).decode()
    return f'<img alt="" src="data:image/jpeg;base64,{content}">'
