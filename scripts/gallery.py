"""Draw the gallery: a sheet of pictures for each sensor and movement, and the page docs/gallery.md.

    python scripts/gallery.py out/gallery --paths out/traced_paths -o docs     # `make gallery` runs the recipes first

Each has a folder of bundles for each sensor, as `tacgen run docs/gallery/gallery.yaml -o out/gallery/digit --set
sensor=digit` writes it, and recipes/traced_paths.yaml. A column of a sheet is one indenter at one frame: camera,
pressure, traction, stress; in the sheet of paths, one sensor: its pictures by both methods and their difference.
"""

import argparse
import inspect
from pathlib import Path
from typing import get_args

import numpy as np
from matplotlib.figure import Figure

from tacgen.bundle import caption
from tacgen.bundle.bundle import Bundle, read
from tacgen.recipe import assets
from tacgen.recipe.loading import read_sensor
from tacgen.recipe.trajectory import Segment
from tacgen.report import bundle_figure, catalogue, field_figure

ACROSS = 6  # indenters in a row
PANEL, GAP, LEFT, TITLE = 1.5, 0.05, 0.55, 0.3  # sizes of a panel, gap, left margin and title [inch]
PATHS_HEIGHT = 2.4  # of a picture in the sheet of paths [inch]
DPI, WEBP = 110, 70  # resolution [pixels an inch]; WebP quality [%]
GREY, CONTRAST = 128, 4  # [counts]: of no difference; how much stronger differences are shown
VON_MISES = field_figure.STRESS_SECTIONS[-1:]
Column = tuple[str, Bundle, int | None]  # indenter, its scene, the frame shown (None: not reached)


def indenter(bundle: Bundle) -> str:
    """`sphere`, or an object's name."""
    chosen = bundle.recipe["indenter"]
    return str(chosen.get("file", chosen["shape"]))


def movements(bundle: Bundle) -> list[str]:
    """press, slide: the trajectory's movements in order."""
    return [kind for step in bundle.recipe["trajectory"] for kind, move in step.items() if move is not None]


def shown(bundle: Bundle, movement: str) -> int | None:
    """The last frame of a movement; of a release, which ends above the gel, the first."""
    frames = [k for k, kind in enumerate(bundle.segments) if kind == movement]
    return frames[0 if movement == "release" else -1] if frames else None


def columns(bundles: list[Bundle], movement: str) -> list[Column]:
    """Each indenter with its first scene that has the movement."""
    found: dict[str, Bundle] = {}
    for bundle in bundles:
        if movement in movements(bundle):
            found.setdefault(indenter(bundle), bundle)
    return [(name, bundle, shown(bundle, movement)) for name, bundle in found.items()]


def sheet(scenes: list[Column]) -> Figure:
    """All indenters of one sensor and movement."""
    image = bundle_figure.image_size(scenes[0][1])
    heights = [PANEL * image[0] / image[1]] * 3 + [PANEL * field_figure.SECTION_HEIGHT_RATIO]
    blocks = [scenes[start : start + ACROSS] for start in range(0, len(scenes), ACROSS)]
    tall = TITLE + sum(heights) + GAP * len(heights)
    size = LEFT + ACROSS * (PANEL + GAP), len(blocks) * tall
    drawn = Figure(figsize=size, layout=None)
    for b, block in enumerate(blocks):
        for c, column in enumerate(block):
            panels, top = [], b * tall + TITLE
            for height in heights:
                x, y = LEFT + c * (PANEL + GAP), size[1] - top - height
                panels.append(drawn.add_axes((x / size[0], y / size[1], PANEL / size[0], height / size[1])))
                top += height + GAP
            draw(panels, column, image)
            for panel, label in zip(panels, ("camera", "pressure", "traction", "von Mises"), strict=True):
                panel.set_xlabel("")
                panel.set_ylabel(label if c == 0 else "", fontsize=8)
                panel.set(xticks=[], yticks=[])
    for note in list(drawn.texts):  # draw_camera's, under each sheet: the page's text has it
        note.remove()
    return drawn


def draw(panels: list, column: Column, image: tuple[int, int]) -> None:
    """The four panels of one indenter, with the value of the brightest colour in each map's corner."""
    name, bundle, k = column
    panels[0].set_title(name, fontsize=9, pad=4)
    if k is None:
        panels[0].text(0.5, 0.5, bundle.attrs["status"], ha="center", transform=panels[0].transAxes)
        return
    frame, window = np.array([k]), bundle_figure.window_of(bundle)
    bundle_figure.draw_camera(bundle, panels[:1], frame, image, window)
    pressure, _ = bundle_figure.draw_map(bundle, panels[1:2], frame, image, window, "pressure")
    traction, _ = bundle_figure.draw_map(bundle, panels[2:3], frame, image, window, "traction")
    [(stress, _, _)] = field_figure.draw_stress(bundle, [panels[3:]], frame, image, VON_MISES)
    for panel, mapped in zip(panels[1:], (pressure, traction, stress), strict=True):
        colour = "black" if mapped is stress else "white"
        style = {"ha": "right", "va": "top" if mapped is stress else "bottom", "fontsize": 7, "color": colour}
        place = (0.97, 0.96 if mapped is stress else 0.03)
        panel.text(*place, f"{mapped.get_clim()[1]:.2g} MPa", transform=panel.transAxes, **style)


def paths_sheet(found: dict[str, list[Bundle]]) -> Figure:
    """A column for each sensor: pictures by `transport` and by `path`, and their difference."""
    pictures = {
        sensor: {b.recipe["render"]["method"]: b.frame("/frames/rgb", b.frames - 1) for b in bundles}  # the last
        for sensor, bundles in found.items()
    }
    wide = [made["path"].shape[1] / made["path"].shape[0] for made in pictures.values()]
    drawn = Figure(figsize=(PATHS_HEIGHT * sum(wide) + 0.5, 3 * PATHS_HEIGHT + 0.4), layout="constrained")
    grid = drawn.subplots(3, len(pictures), squeeze=False, width_ratios=wide)
    for column, (sensor, made) in zip(grid.T, pictures.items(), strict=True):
        off = made["path"].astype(float) - made["transport"]
        shown = made["transport"], made["path"], np.clip(GREY + CONTRAST * off, 0, 255).astype(np.uint8)
        for panel, picture in zip(column, shown, strict=True):
            panel.imshow(picture)
            panel.set(xticks=[], yticks=[])
        column[0].set_title(sensor, fontsize=9)
        column[1].set_xlabel(f"{found[sensor][0].recipe['quality']['spp']} paths a pixel", fontsize=8)
        decibel, bias = 20 * np.log10(255 / np.sqrt(np.mean(off**2))), off.mean()
        column[2].set_xlabel(f"{decibel:.1f} dB with its noise,\nmean {bias:+.2f} counts", fontsize=8)
    for panel, label in zip(grid[:, 0], ("transport", "path", f"difference x {CONTRAST}"), strict=True):
        panel.set_ylabel(label, fontsize=9)
    return drawn


def heading(sensor: str, bundles: list[Bundle]) -> list[str]:
    """The text about a sensor before its sheets."""
    made = read_sensor(assets.sensor_path(sensor))[0]
    wide, high = (made.camera.mm_per_px * n for n in (made.camera.width_px, made.camera.height_px))
    section = field_figure.SECTION_WIDTH_RATIO * np.ptp(bundles[0]["/mesh/points"][:, 2])
    size = f"Camera pictures are {wide:.1f} x {high:.1f} mm, sections {section:.1f} mm wide."
    rejected = [b for b in bundles if b.attrs["status"] != "ok"]
    reasons = [f"- {indenter(b)}, {', '.join(movements(b))}: {b.attrs['reason']}" for b in rejected]
    return [f"## {sensor}", "", f"{made.description}. {size}", "", *reasons, *[""] * bool(rejected)]


def page(found: dict[str, list[Bundle]], paths: bool) -> str:
    """The text of docs/gallery.md, from gallery.md beside this program."""
    sensor, first = next(iter(found.items()))
    objects = catalogue.objects()
    kinds = [kind for kind in Segment.model_fields if columns(first, kind)]
    indenters, moves, sheets = list[str](), list[str](), list[str]()
    for name, bundle, _ in columns(first, kinds[0]):
        indenters.append(f"| {name} | {objects.get(name) or caption.indenter_text(bundle).partition(', ')[2]} |")
    for kind in kinds:
        about = inspect.getdoc(get_args(Segment.model_fields[kind].annotation)[0]).split("\n\n")[0].replace("\n", " ")
        move = next(step[kind] for step in columns(first, kind)[0][1].recipe["trajectory"] if step.get(kind))
        far = ", ".join(f"{key}: {value:g}" for key, value in move.items() if key.endswith(("_mm", "_deg")))
        moves.append(f"| [{kind}](#{sensor}-{kind}) | {about} | {far} |")
    for sensor, bundles in found.items():
        sheets += heading(sensor, bundles)
        for kind in kinds:
            picture = f"![{kind}](gallery/{sensor}-{kind}.webp){{loading=lazy}}"
            sheets += [f"### {sensor}: {kind}", "", picture, ""]
    before, section = Path(__file__).with_suffix(".md").read_text().split("<!-- paths -->\n")
    texts = {"SCENES": [str(sum(map(len, found.values())))], "INDENTERS": indenters, "MOVEMENTS": moves}
    for name, lines in texts.items():
        before = before.replace(f"{{{name}}}", "\n".join(lines))
    return (before + section * paths + "\n" + "\n".join(sheets)).rstrip() + "\n"


def by_sensor(folder: Path) -> dict[str, list[Bundle]]:
    """The bundles in each of a folder's folders."""
    folders = sorted(path for path in folder.iterdir() if path.is_dir())
    return {path.name: [read(file) for file in sorted(path.glob("scene-*.h5"))] for path in folders}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundles", type=Path, help="a folder of bundles for each sensor")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs"))
    parser.add_argument("--paths", type=Path, help="the same of recipes/traced_paths.yaml")
    given = parser.parse_args()
    found = by_sensor(given.bundles)
    (given.out / "gallery").mkdir(parents=True, exist_ok=True)
    for sensor, bundles in found.items():
        for kind in Segment.model_fields:
            if scenes := columns(bundles, kind):
                file = given.out / "gallery" / f"{sensor}-{kind}.webp"
                sheet(scenes).savefig(file, dpi=DPI, pil_kwargs={"quality": WEBP})
                print(file)
    if given.paths:
        file = given.out / "gallery" / "paths.webp"
        paths_sheet(by_sensor(given.paths)).savefig(file, dpi=DPI, pil_kwargs={"quality": WEBP})
        print(file)
    (given.out / "gallery.md").write_text(page(found, given.paths is not None))


if __name__ == "__main__":
    main()
