"""A drawing of a sensor: its untouched picture, a plan, and a cut of gel, plate, lamps and camera."""

from collections.abc import Sequence
from itertools import chain
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import image_size, scale_of
from tacgen.report.plane_cut import cut, outline
from tacgen.report.sheet import Page
from tacgen.sensor.model import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = np.ndarray
X, Y, Z = range(3)
PANEL_SIZE_IN, MARGIN_IN, PANEL_SPACE_IN, LABEL_SPACE_IN = 3.6, 0.75, 0.75, 0.7  # square panels, and beside them [inch]
LABEL_LETTERS = 22  # that have room beside the cut
CUT_SHIFT_MM = 1e-6  # [mm] from y = 0, where a symmetric mesh has nodes
GEL_COLOURS = ("#9cc3dc", "#c9b8dd", "#a9d3b5", "#e4c9a0")  # of layers, from the base outward
PLATE_COLOUR, CAMERA_COLOUR, VIEW_COLOUR = "#d9dee3", "#303844", "#666666"
EDGE_COLOUR = "#405060"
ARROW_SHARE = 0.12  # length of a lamp's arrow over the larger side of the gel [-]
OUTLINE_SAG_MM = 0.02  # of the polygon that stands for a round outline [mm]
MIN_LABEL_GAP = 0.045  # between labels of the cut, over the height of its panel [-]


def figure(bundle: Bundle) -> "Figure":
    """The picture, if there is one, the plan and the cut at y = 0 side by side, all in mm of the sensor's frame."""
    sensor, pictured = bundle.sensor, "/reference/rgb" in bundle
    count = 2 + pictured
    sheet = Page(MARGIN_IN + count * (PANEL_SIZE_IN + PANEL_SPACE_IN) + LABEL_SPACE_IN, PANEL_SIZE_IN + 1.9)
    panels = sheet.row(count, MARGIN_IN, 0.95, PANEL_SIZE_IN, PANEL_SIZE_IN, PANEL_SPACE_IN)
    left, top, right, bottom = view = scale_of(bundle).box(*image_size(bundle))
    if pictured:
        panels[0].imshow(bundle["/reference/rgb"], extent=(left, right, bottom, top))
        panels[0].set_title("untouched picture", fontsize=10)
    _plan(panels[-2], bundle, sensor, view)
    _cut(panels[-1], bundle, sensor, (left, right))
    for panel in panels:
        panel.set_aspect("equal", adjustable="box", anchor="N")
        panel.tick_params(labelsize=8)
        panel.set_xlabel("x [mm]", fontsize=9)
        panel.set_ylabel("z [mm]" if panel is panels[-1] else "y [mm]", fontsize=9)
    plain: dict[str, Any] = {"ha": "center", "va": "top", "parse_math": False}
    sheet.figure.text(0.5, 1 - 0.15 / sheet.height, sensor.name, fontsize=13, weight="bold", **plain)
    sheet.figure.text(0.5, 1 - 0.42 / sheet.height, sensor.description, fontsize=9, **plain)
    note = "dashed: what the picture shows; lines of sight without their refraction at the plate"
    sheet.figure.text(0.5, 0.12 / sheet.height, note, fontsize=8, ha="center", va="bottom")
    return sheet.figure


def _plan(panel: "Axes", bundle: Bundle, sensor: Sensor, view: tuple[float, float, float, float]) -> None:
    """Gel, plate, lamps, camera and the part in the picture, seen along -z: y down, as in the picture."""
    from scipy.spatial import ConvexHull

    points, solid = bundle["/mesh/points"][:, :2], sensor.gel.solid is not None
    rim = points[ConvexHull(points).vertices] if solid else sensor.gel.pad.outline(OUTLINE_SAG_MM)
    low, high = rim.min(axis=0), rim.max(axis=0)
    if sensor.plate is not None:
        beyond = 0.0 if sensor.walls is None else sensor.walls.margin_mm
        _box(panel, low - beyond, high + beyond)
    panel.fill(*rim.T, facecolor=_colour(len(sensor.gel.layers) - 1), edgecolor=EDGE_COLOUR, linewidth=0.8)
    left, top, right, bottom = view
    around = [left, right, right, left, left], [top, top, bottom, bottom, top]
    panel.plot(*around, "--", color=VIEW_COLOUR, linewidth=1)
    _lamps(panel, sensor, (X, Y), float(max(high - low)))
    panel.plot(*sensor.camera.center_mm, "+", color=CAMERA_COLOUR, markersize=9)
    panel.annotate("camera", sensor.camera.center_mm, (5, 5), textcoords="offset points", fontsize=8)
    panel.invert_yaxis()
    panel.set_title("plan", fontsize=10)


def _cut(panel: "Axes", bundle: Bundle, sensor: Sensor, view: tuple[float, float]) -> None:
    """Layers of the gel, the plate, lamps and the camera in the plane y = 0; lamps beside it are projected into it."""
    points, cells, layer = bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"]
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(max(high[:2] - low[:2]))
    base, words = float(low[Z]), []
    if sensor.plate is not None:
        beyond = 0.0 if sensor.walls is None else sensor.walls.margin_mm
        below = base - sensor.plate.thickness_mm
        _box(panel, (low[X] - beyond, below), (high[X] + beyond, base))
        words.append((f"plate {sensor.plate.thickness_mm:g} mm", (below + base) / 2))
        base = below
    for k, part in enumerate(sensor.gel.layers):
        corners, _ = cut(points, cells[layer == k], points, CUT_SHIFT_MM)
        panel.fill(*chain.from_iterable(triangle.T for triangle in corners), color=_colour(k), linewidth=0.4)
        for side in outline(corners):
            panel.plot(*side.T, color=EDGE_COLOUR, linewidth=0.8)
        if len(corners):
            words.append((f"{part.name} {part.thickness_mm:g} mm", float(corners[..., 1].mean())))
    camera = sensor.camera
    hole = np.array([camera.center_mm[0], base - camera.distance_mm])
    for x in view:
        panel.plot([hole[0], x], [hole[1], 0.0], "--", color=VIEW_COLOUR, linewidth=0.8)
    panel.plot(*hole, "^", color=CAMERA_COLOUR, markersize=9)
    words.append((f"camera {camera.distance_mm:g} mm below", float(hole[1])))
    _lamps(panel, sensor, (X, Z), size)
    panel.autoscale_view()
    last, gap = np.inf, MIN_LABEL_GAP * float(np.ptp(panel.get_ylim()))
    beside: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "va": "center"}
    for text, z in sorted(words, key=lambda word: -word[1]):
        last = min(z, last - gap)
        panel.annotate(fill(text, LABEL_LETTERS), (1.0, last), (4, 0), fontsize=8, annotation_clip=False, **beside)
    panel.set_title("cut at y = 0", fontsize=10)


def _lamps(panel: "Axes", sensor: Sensor, axes: tuple[int, int], size: float) -> None:
    """Lamps as their outlines in a projection, in their colours, with an arrow along their normals."""
    lamps = sensor.leds or ()
    for lamp in lamps:
        normal, up = (np.array(v) / np.linalg.norm(v) for v in (lamp.normal, lamp.up))
        across = np.cross(up, normal) * lamp.size_mm[0] / 2
        up = up * lamp.size_mm[1] / 2
        centre = np.array(lamp.center_mm)
        corners = np.array([centre + i * across + j * up for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])[:, axes]
        light = np.array(lamp.radiance) / max(*lamp.radiance, 1e-12)
        for colour, width in ((EDGE_COLOUR, 3.2), (tuple(light), 2.0)):  # seen from its edge it is a line
            panel.fill(*corners.T, color=colour, linewidth=width, zorder=3)
        end = centre + ARROW_SHARE * size * normal
        style: dict[str, Any] = {"arrowstyle": "->", "color": EDGE_COLOUR, "linewidth": 1.0}
        tip, tail = ((float(point[axes[0]]), float(point[axes[1]])) for point in (end, centre))
        panel.annotate("", tip, tail, arrowprops=style, annotation_clip=False)


def _box(panel: "Axes", low: Sequence[float], high: Sequence[float]) -> None:
    panel.fill([low[0], high[0], high[0], low[0]], [low[1], low[1], high[1], high[1]], PLATE_COLOUR, zorder=0.5)


def _colour(layer: int) -> str:
    return GEL_COLOURS[layer % len(GEL_COLOURS)]
