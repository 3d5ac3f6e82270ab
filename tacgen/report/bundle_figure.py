"""A picture of a bundle over its frames, and a few lines of text about it."""

import json
from collections.abc import Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import dataset
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.caption import caption, indenter_text
from tacgen.bundle.force_error import force_error
from tacgen.bundle.scene_words import finger_text
from tacgen.outputs import DRAWN_MAPS
from tacgen.report.frame_curves import draw_forces, draw_lift
from tacgen.report.layers import has_arrows, limits, map_of
from tacgen.report.sheet import Page, round_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_FIGURE_COLUMNS = 5  # more would make the text unreadable on a page
# Inches: a panel, the gap between panels, margins of the page, and the heights of the plots over frames
PANEL_IN, GAP_IN, LEFT_IN, RIGHT_IN, TOP_IN, BELOW_IN = 1.4, 0.07, 0.9, 0.85, 0.85, 0.7
ABOVE_FORCES_IN, FORCES_IN, LIFT_IN = 0.75, 1.4, 0.9
# a panel, the gap between panels, the colour bar and the margin above, where those of a frame are side by side [inch]
WIDE_PANEL_IN, WIDE_GAP_IN, BAR_IN, WIDE_TOP_IN = 2.1, 0.7, 0.6, 0.55


def only(path: Path) -> Bundle:
    """The bundle at a path, or the only one of a folder. UserError if the folder holds several."""
    bundles = dataset.scenes(path)
    if len(bundles) > 1:
        raise UserError(
            f"{path}: holds {len(bundles)} bundles; draw one, such as {bundles[0].path}, or all: tacgen report {path}"
        )
    return bundles[0]


def save(drawn: "Figure", out: Path) -> None:
    """Write a figure. UserError if the suffix of `out` is not an image format, OSError if it cannot be written."""
    kinds = drawn.canvas.get_supported_filetypes()
    if out.suffix.lstrip(".").lower() not in kinds:
        known = ", ".join(f".{kind}" for kind in sorted(kinds))
        raise UserError(f"{out.suffix or 'no suffix'}: unknown kind of picture, use one of {known}")
    drawn.savefig(out, dpi=150)


def figure(bundle: Bundle) -> "Figure":
    """Up to five frames of a bundle, evenly spread over its trajectory, its force curve, and the lift of a grasp.

    Rows whose dataset is not in the bundle are left out; those of a single frame stand side by side. Image axes: x
    right, y down, in mm of the untouched face.
    """
    rows = rows_of(bundle)
    if rows and bundle.frames == 1:
        return side_by_side(bundle, rows).page.figure
    shown = evenly(bundle.frames, MAX_FIGURE_COLUMNS) if rows else np.zeros(0, int)
    image, window = image_size(bundle), window_of(bundle)
    tall = PANEL_IN * image[0] / image[1]
    wide = max(len(shown) * (PANEL_IN + GAP_IN), 5.0)
    top = (TOP_IN if rows else 0.2) + len(rows) * (tall + GAP_IN) + ABOVE_FORCES_IN
    lift = LIFT_IN + BELOW_IN if "/frames/grasp/object" in bundle and bundle.frames else 0.0
    sheet = Page(LEFT_IN + wide + RIGHT_IN, top + FORCES_IN + BELOW_IN + lift)
    for r, draw in enumerate(rows):
        y = TOP_IN + r * (tall + GAP_IN)
        panels = sheet.row(len(shown), LEFT_IN, y, PANEL_IN, tall, GAP_IN)
        colours = draw(bundle, panels, shown, image, window)
        if colours is not None:
            sheet.colour_bar(*colours, x=LEFT_IN + len(shown) * (PANEL_IN + GAP_IN) + 0.03, y=y + 0.04, h=tall - 0.08)
        if r == 0:
            for panel, k in zip(panels, shown, strict=True):
                panel.set_title(f"frame {k}\n{bundle.segments[k]}", fontsize=8, pad=4)
    if rows:
        label_x(panels, scale_of(bundle).unit)
    draw_forces(sheet.axes(LEFT_IN, top, wide - GAP_IN, FORCES_IN), bundle, shown)
    if lift:
        draw_lift(sheet.axes(LEFT_IN, top + FORCES_IN + BELOW_IN, wide - GAP_IN, LIFT_IN), bundle)
    heading(sheet, bundle)
    return sheet.figure


def evenly(frames: int, most: int) -> np.ndarray:
    """Numbers of at most so many frames, evenly spread, with the first and the last one."""
    return np.unique(np.linspace(0, frames - 1, most).round().astype(int))


class SideBySide(NamedTuple):
    """A sheet whose panels are side by side above the force curve: for each kind of panel a stack, one a frame."""

    page: Page
    stacks: list[list["Axes"]]
    forces: "Axes"


def side_by_side(bundle: Bundle, rows: Sequence[Any]) -> SideBySide:
    """Draw the panels of all frames once, one above the other, and the force curve below."""
    image, window, frames = image_size(bundle), window_of(bundle), np.arange(bundle.frames)
    tall = WIDE_PANEL_IN * image[0] / image[1]
    bars = [BAR_IN * (draw is not draw_camera) for draw in rows]  # beside each panel
    least = max(len(rows), 2) * (WIDE_PANEL_IN + WIDE_GAP_IN) - WIDE_GAP_IN + max(sum(bars), BAR_IN)
    sheet = Page(LEFT_IN + least + 0.2, (WIDE_TOP_IN + tall if rows else 0.2) + ABOVE_FORCES_IN + FORCES_IN + BELOW_IN)
    stacks = []
    for c, draw in enumerate(rows):
        x = LEFT_IN + c * (WIDE_PANEL_IN + WIDE_GAP_IN) + sum(bars[:c])
        panels = [sheet.axes(x, WIDE_TOP_IN, WIDE_PANEL_IN, tall) for _ in frames]
        colours = draw(bundle, panels, frames, image, window)
        if colours is not None:
            sheet.colour_bar(*colours, x=x + WIDE_PANEL_IN + 0.03, y=WIDE_TOP_IN, h=tall)
        label_x(panels[:1], scale_of(bundle).unit)  # the lowest panel, always visible: its ticks serve all
        stacks.append(panels)
    top = sheet.height - BELOW_IN - FORCES_IN
    forces = sheet.axes(LEFT_IN, top, sheet.width - LEFT_IN - RIGHT_IN, FORCES_IN)
    draw_forces(forces, bundle, frames[:0])
    heading(sheet, bundle)
    return SideBySide(sheet, stacks, forces)


def rows_of(bundle: Bundle, most: int | None = None) -> list[Any]:
    """Functions that draw what the bundle has of FIGURE_ROWS, or of so many first ones."""
    return [draw for wanted, draw in FIGURE_ROWS[:most] if any(path in bundle for path in wanted) and bundle.frames]


def summary(path: Path) -> str:
    """A summary of a bundle in a few lines of text. UserError if `path` is not a complete bundle."""
    bundle = read(path)
    attrs = bundle.attrs
    status = attrs["status"] + (f" ({attrs['reason']})" if attrs["reason"] else "")
    runs = [f"{kind} {len(list(group))}" for kind, group in groupby(bundle.segments) if kind]
    lines = [
        f"{path}: {bundle.recipe.get('name', '')}, {finger_text(attrs)}, {indenter_text(bundle)}",
        f"about     {caption(bundle)}",
        f"status    {status}",
        f"frames    {bundle.frames} of {attrs['frames_planned']}" + (f": {', '.join(runs)}" if runs else ""),
        f"size      {path.stat().st_size / 1e6:.2f} MB, written by tacgen {attrs['tacgen_version']}",
    ]
    if "mesh" in attrs:
        lines.append(f"mesh      {_mesh(json.loads(attrs['mesh']))}")
    if "/frames/force" in bundle and bundle.frames:
        force = bundle["/frames/force"]
        k = int(np.linalg.norm(force, axis=1).argmax())
        text = ", ".join(f"{n} {v:.3f}" for n, v in zip(("Fx", "Fy", "Fz"), force[k], strict=True))
        lines.append(f"force     largest in frame {k}: {text} N on the gel")
        if (error := force_error(bundle)) and error.text(k):
            lines[-1] += f", {error.text(k)} ({error.kind})"
    if "/frames/pressure" in bundle and bundle.frames:
        peaks = bundle["/frames/pressure"].max(axis=(1, 2))
        lines.append(f"pressure  largest in frame {int(peaks.argmax())}: {peaks.max():.4f} MPa")
    lines += [f"note      {note}" for note in json.loads(attrs.get("notes", "[]"))]
    width = max(map(len, bundle.shapes), default=0) + 2
    lines += [f"{path:<{width}}{' x '.join(map(str, shape))}" for path, shape in bundle.shapes.items()]
    return "\n".join(lines)


def _mesh(quality: dict[str, Any]) -> str:
    """`5431 nodes, 3388 cells, smallest angle 20 deg, scaled Jacobian 0.22, volume -0.03 %`"""
    words = [f"{quality['nodes']} nodes", f"{quality['cells']} cells"]
    if "smallest_dihedral_deg" in quality:
        words.append(f"smallest angle {quality['smallest_dihedral_deg']:.0f} deg")
    words.append(f"scaled Jacobian {quality['smallest_scaled_jacobian']:.2f}")
    if "bonded_share" in quality:
        words.append(f"{quality['bonded_share']:.0%} of its footprint bonded")
    return ", ".join([*words, f"volume {100 * quality['volume_error']:+.2f} %"])


def heading(sheet: Page, bundle: Bundle) -> None:
    """The bundle's name, indenter and sensor at the top of a sheet, and in red why it was rejected."""
    text = f"{bundle.recipe.get('name', bundle.path.stem)}: {indenter_text(bundle)}, on {finger_text(bundle.attrs)}"
    plain: dict[str, Any] = {"ha": "center", "va": "top", "parse_math": False}  # names may hold $
    sheet.figure.text(0.5, 1 - 0.12 / sheet.height, text, fontsize=11, **plain)
    if bundle.attrs["status"] != "ok":
        text = f"{bundle.attrs['status']}: {bundle.attrs['reason']}"
        sheet.figure.text(0.5, 1 - 0.34 / sheet.height, text, fontsize=8, color="#b00000", **plain)


def image_size(bundle: Bundle) -> tuple[int, int]:
    """(H, W) [px] of the images; without images, of the camera or else of the maps."""
    if "sensor_document" in bundle.attrs and "/frames/rgb" not in bundle:
        return bundle.sensor.camera.height_px, bundle.sensor.camera.width_px
    shapes = [bundle.shapes[p] for p in ("/frames/rgb", "/frames/pressure", "/frames/height") if p in bundle]
    return (shapes[0][1], shapes[0][2]) if shapes else (240, 320)


class Scale(NamedTuple):
    """Scale of the image on the untouched face: its centre (x, y) and the size of a pixel, both in `unit`."""

    centre: tuple[float, float]
    per_px: tuple[float, float]  # across, down
    unit: str

    def box(self, height: int, width: int) -> tuple[float, float, float, float]:
        """Left, upper, right and lower edge of an image of so many pixels."""
        (x, y), (wide, tall) = self.centre, (width / 2 * self.per_px[0], height / 2 * self.per_px[1])
        return x - wide, y - tall, x + wide, y + tall

    def ticks(self, low: float, high: float, length: int, axis: int) -> tuple[list[float], list[str]]:
        """Positions [px] and labels of ticks at round numbers between two pixels of axis 0 (x) or 1 of `length` px."""
        size = self.per_px[axis]
        zero = length / 2 - self.centre[axis] / size
        low, high = sorted(((low - zero) * size, (high - zero) * size))
        values = round_ticks(low, high, 7)
        return [v / size + zero for v in values], [f"{v:g}".replace("-", "\N{MINUS SIGN}") for v in values]


def scale_of(bundle: Bundle) -> Scale:
    """From the sensor's camera, ignoring its tilt; in pixels if the bundle does not hold the sensor."""
    try:
        camera = bundle.sensor.camera
    except UserError:
        height, width = image_size(bundle)
        return Scale((width / 2, height / 2), (1.0, 1.0), "px")
    (x, y), crop = camera.center_mm, camera.crop_mm
    return Scale((x + crop[0], y + crop[1]), camera.pixel_mm, "mm")


Window = tuple[float, float, float, float]


def window_of(bundle: Bundle) -> Window:
    """(x0, x1, y0, y1) as fractions of the image: the region touched in any frame, with a margin."""
    if "/frames/pressure" not in bundle or not bundle.frames:
        return 0.0, 1.0, 0.0, 1.0
    pressure = bundle["/frames/pressure"].max(axis=0)
    touched = np.argwhere(pressure > 0.01 * max(pressure.max(), 1e-9))
    if not len(touched):
        return 0.0, 1.0, 0.0, 1.0
    low, high = touched.min(axis=0) / pressure.shape, (touched.max(axis=0) + 1) / pressure.shape
    side = min(1.0, 1.5 * (high - low).max())
    y0, x0 = np.clip((low + high - side) / 2, 0, 1 - side)
    return x0, x0 + side, y0, y0 + side


def magnification(bundle: Bundle) -> int:
    """Magnification of the markers' motion: the longest arrow is at most 13 % of the image's width."""
    largest = max(float(np.linalg.norm(bundle["/frames/marker_flow"], axis=-1).max()), 1e-6)
    return max((t for t in (1, 2, 3, 5, 10, 20, 50) if t * largest <= 0.13 * image_size(bundle)[1]), default=1)


def draw_camera(
    bundle: Bundle, panels: list["Axes"], shown: np.ndarray, image: tuple[int, int], window: Window
) -> None:
    """Draw the camera's images, the magnified displacement of the markers, and the outline of the maps' window."""
    from matplotlib.patches import Rectangle

    height, width = image
    x0, x1, y0, y1 = window
    notes = []
    flow = bundle["/frames/marker_flow"] if "/reference/markers" in bundle and "/frames/marker_flow" in bundle else None
    if flow is not None:
        start, times = bundle["/reference/markers"], magnification(bundle)
        notes.append(f"arrows on the images: motion of the markers \N{MULTIPLICATION SIGN} {times}")
    dotted = x1 - x0 < 0.99
    notes += ["dotted: what the maps show"] if dotted else []
    panels[0].figure.text(0.5, 0.01, "; ".join(notes), ha="center", fontsize=8)
    for panel, k in zip(panels, shown, strict=True):
        if "/frames/rgb" in bundle:
            panel.imshow(bundle.frame("/frames/rgb", k), extent=(0, width, height, 0), interpolation="antialiased")
        if flow is not None:
            if "/frames/rgb" not in bundle:
                panel.plot(*start.T, "o", color="black", markersize=2)
            _arrows(panel, start, flow[k] * times, width)
        if dotted:
            corner, size = (x0 * width, y0 * height), ((x1 - x0) * width, (y1 - y0) * height)
            panel.add_patch(Rectangle(corner, *size, fill=False, edgecolor="white", linewidth=0.6, linestyle=":"))
        panel.set(facecolor="#707070")
    zoom(bundle, panels, image, (0.0, 1.0, 0.0, 1.0), "camera")


def draw_map(
    bundle: Bundle, panels: list["Axes"], shown: np.ndarray, image: tuple[int, int], window: Window, name: str
) -> tuple[Any, str]:
    """Draw one of DRAWN_MAPS in image pixels, nan in grey, all frames on one scale.

    Vectors are drawn as arrows on a coarse grid over the window. Returns the mappable and the label of a colour bar.
    """
    layer = DRAWN_MAPS[name]
    drawn = map_of(layer, bundle)
    low, high = limits(drawn)
    extent = (0, image[1], image[0], 0)
    for panel, k in zip(panels, shown, strict=True):
        image_of = panel.imshow(
            drawn[k], cmap=layer.colours, vmin=low, vmax=high, extent=extent, interpolation="nearest"
        )
        panel.set(facecolor="#b0b0b0")
    if has_arrows(layer, bundle):
        h, w = drawn.shape[1:]
        step = max(1, round((window[1] - window[0]) * w / 14))
        rows, columns = (np.arange(n) for n in (h, w))
        rows = rows[(rows >= window[2] * h) & (rows < window[3] * h)][step // 2 :: step]
        columns = columns[(columns >= window[0] * w) & (columns < window[1] * w)][step // 2 :: step]
        at = np.stack(np.meshgrid((columns + 0.5) * image[1] / w, (rows + 0.5) * image[0] / h), axis=-1).reshape(-1, 2)
        span = (window[1] - window[0]) * image[1]
        for panel, k in zip(panels, shown, strict=True):
            arrows = bundle.frame(layer.path, int(k))[np.ix_(rows, columns)].reshape(-1, 2)
            _arrows(panel, at, arrows / max(high, 1e-12) * span / 9, span)
    zoom(bundle, panels, image, window, name)
    return image_of, layer.label


def zoom(bundle: Bundle, panels: list["Axes"], image: tuple[int, int], window: Window, label: str) -> None:
    """Limit the axes to the window, in image pixels, with ticks in the unit of the scale."""
    (height, width), (x0, x1, y0, y1), scale = image, window, scale_of(bundle)
    for panel in panels:
        panel.set(xlim=(x0 * width, x1 * width), ylim=(y1 * height, y0 * height))
        panel.set_xticks(*scale.ticks(x0 * width, x1 * width, width, 0))
        panel.set_yticks(*scale.ticks(y0 * height, y1 * height, height, 1))
    frame_axes(panels, f"{label}\ny [{scale.unit}]")


FIGURE_ROWS: tuple[tuple[tuple[str, ...], Any], ...] = (
    (("/frames/rgb", "/frames/marker_flow"), draw_camera),
    *(((DRAWN_MAPS[name].path,), partial(draw_map, name=name)) for name in ("pressure", "traction", "height")),
)


def _arrows(panel: "Axes", at: np.ndarray, arrows: np.ndarray, span: float) -> None:
    """Draw arrows (n, 2) at points (n, 2) in image pixels, without very short ones; `span`: the panel's width [px]."""
    keep = np.linalg.norm(arrows, axis=1) > 0.01 * span
    style: dict[str, Any] = {"color": "white", "edgecolor": "black", "linewidth": 0.3}
    style |= {"width": 0.009, "headwidth": 3, "headlength": 3.5, "minlength": 0}
    panel.quiver(*at[keep].T, *arrows[keep].T, angles="xy", scale_units="xy", scale=1, **style)


def frame_axes(panels: list["Axes"], label: str) -> None:
    """Small tick labels; y ticks on the first panel of a row only."""
    for panel in panels:
        panel.tick_params(labelsize=7, length=2, pad=1.5, labelbottom=False, bottom=False)
        if panel is not panels[0]:
            panel.tick_params(labelleft=False, left=False)
    panels[0].set_ylabel(label, fontsize=8)


def label_x(panels: list["Axes"], unit: str) -> None:
    """The x axis under the lowest row of panels."""
    for panel in panels:
        panel.tick_params(labelbottom=True, bottom=True)
        panel.set_xlabel(f"x [{unit}]", fontsize=8, labelpad=1)
