"""A figure of one field of a bundle over its frames: pressure, traction, slip, or stress in a section of the gel."""

import json
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import kept_files, postprocess
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.stored_json import parsed
from tacgen.geometry import mesh_file, mesh_import, surface_nets
from tacgen.geometry.surface_nets import Triangles
from tacgen.outputs import DRAWN_MAPS
from tacgen.recipe import assets
from tacgen.recipe.indenters import Indenter, analytic
from tacgen.report import bundle_figure
from tacgen.report.layers import datasets_of
from tacgen.report.plane_cut import crossed, cut, outline
from tacgen.report.sheet import Page
from tacgen.sensor.validation_messages import suggest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = np.ndarray
MAX_FIELD_COLUMNS, FIELD_PANEL_IN, FIELD_GAP_IN = 4, 1.85, 0.1  # panels side by side, and inches
MIN_FIELD_WIDTH_IN = 4.4  # of all panels together, so that the heading has room [inch]
SECTION_HEIGHT_RATIO = 0.42  # height of a section over its width
SECTION_WIDTH_RATIO = 3.4  # width of a section over the gel's thickness
MIN_STRESS_SCALE_MPA = 1e-6  # [MPa] of the brightest colour: rounding of a gel that nothing touches stays dark
SECTION_SHIFT_MM = 1e-6  # [mm] shift of the section, so that it does not pass through nodes of a symmetric mesh
CONTACT_STATE_STYLES = {
    postprocess.FREE: ("free", "#f2f2f2"),
    postprocess.EDGE: ("edge", "#f0e442"),
    postprocess.STICK: ("stick", "#0072b2"),
    postprocess.SLIP: ("slip", "#d55e00"),
}
# a component of stress: its name, function of the tensor (n, 6), colour map, and whether it is signed
Section = tuple[str, Callable[[Array], Array], str, bool]
STRESS_SECTIONS: tuple[Section, ...] = (
    ("σ_zz", lambda s: s[:, 2], "RdBu_r", True),
    ("σ_xz", lambda s: s[:, 4], "PuOr_r", True),
    ("von Mises", postprocess.von_mises, "magma", False),
)


def figure(bundle: Bundle, field: str) -> "Figure":
    """One of DRAWN_FIELDS in up to four frames of a bundle, evenly spread over its trajectory, side by side; one colour
    bar per row.

    Raises:
        UserError: unknown field, or a bundle without the field or without frames.
    """
    if field not in DRAWN_FIELDS:
        raise UserError(f"{field}: unknown field{suggest(field, DRAWN_FIELDS)}; there are: {', '.join(DRAWN_FIELDS)}")
    needed, output, rows, draw, note = DRAWN_FIELDS[field]
    if missing := [path for path in needed if path not in bundle]:
        raise UserError(f"{bundle.path}: has no {missing[0]}: the recipe's outputs need {output}")
    if not bundle.frames:
        raise UserError(f"{bundle.path}: has no frames to show")
    shown, image = bundle_figure.evenly(bundle.frames, MAX_FIELD_COLUMNS), bundle_figure.image_size(bundle)
    wide = max(FIELD_PANEL_IN, MIN_FIELD_WIDTH_IN / len(shown) - FIELD_GAP_IN)
    tall = wide * (SECTION_HEIGHT_RATIO if rows > 1 else image[0] / image[1])
    right = 0.9 + len(shown) * (wide + FIELD_GAP_IN)
    sheet = Page(right + 1.0, 0.85 + rows * (tall + FIELD_GAP_IN) + 0.9)
    tops = [0.85 + r * (tall + FIELD_GAP_IN) for r in range(rows)]
    grid = [sheet.row(len(shown), 0.9, y, wide, tall, FIELD_GAP_IN) for y in tops]
    for y, (drawn, label, ticks) in zip(tops, draw(bundle, grid, shown, image), strict=False):
        bar = sheet.colour_bar(drawn, label, x=right + 0.03, y=y + 0.05, h=tall - 0.1)
        if ticks:
            bar.set_yticks(list(ticks), list(ticks.values()))
    for panel, k in zip(grid[0], shown, strict=True):
        panel.set_title(f"frame {k} {bundle.segments[k]}", fontsize=8, pad=4)
    if rows == 1:
        bundle_figure.label_x(grid[0], bundle_figure.scale_of(bundle).unit)
    wrapped = textwrap.fill(note, int(14 * sheet.width))  # letters of this size an inch
    above = 0.28 if draw is _camera else 0.1  # a line of `draw_camera`
    sheet.figure.text(0.5, above / sheet.height, wrapped, ha="center", va="bottom", fontsize=8)
    bundle_figure.heading(sheet, bundle)
    return sheet.figure


Bar = tuple[Any, str, dict[float, str]]
Grid = list[list["Axes"]]


def _map(name: str, bundle: Bundle, grid: Grid, shown: Array, image: tuple[int, int]) -> list[Bar]:
    return [(*bundle_figure.draw_map(bundle, grid[0], shown, image, bundle_figure.window_of(bundle), name), {})]


def _camera(bundle: Bundle, grid: Grid, shown: Array, image: tuple[int, int]) -> list[Bar]:
    bundle_figure.draw_camera(bundle, grid[0], shown, image, (0.0, 1.0, 0.0, 1.0))
    return []


def _slip(bundle: Bundle, grid: Grid, shown: Array, image: tuple[int, int]) -> list[Bar]:
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([CONTACT_STATE_STYLES[state][1] for state in sorted(CONTACT_STATE_STYLES)])
    for panel, k in zip(grid[0], shown, strict=True):
        drawn = panel.imshow(
            postprocess.contact_state(bundle, int(k)), cmap=colours, vmin=-0.5, vmax=3.5,
            extent=(0, image[1], image[0], 0), interpolation="nearest",
        )  # fmt: skip
    bundle_figure.zoom(bundle, grid[0], image, bundle_figure.window_of(bundle), "contact")
    return [(drawn, "", {float(state): name for state, (name, _) in CONTACT_STATE_STYLES.items()})]


def draw_stress(
    bundle: Bundle, grid: Grid, shown: Array, image: tuple[int, int], sections: tuple[Section, ...] = STRESS_SECTIONS
) -> list[Bar]:
    """Draw vertical sections of the deformed gel through the indenter, with the indenter's outline: a row for each of
    `sections`."""
    from matplotlib.collections import LineCollection

    points, cells, layer = bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"]
    half = SECTION_WIDTH_RATIO / 2 * float(np.ptp(points[:, 2]))
    cuts = [section(bundle, int(k), points, cells, layer) for k in shown]
    if missed := [int(k) for k, (corners, _, _) in zip(shown, cuts, strict=True) if not len(corners)]:
        raise UserError(f"{bundle.path}: has no section to draw: in frame {missed[0]} the indenter is beside the gel")
    indenter = indenter_surface(bundle, 2 * half)
    bars: list[Bar] = []
    for row, (name, what, colours, signed) in zip(grid, sections, strict=True):
        values = [what(stress.reshape(-1, 6)) for _, stress, _ in cuts]
        top = max(MIN_STRESS_SCALE_MPA, *(float(np.quantile(np.abs(v), 0.999)) for v in values))
        for panel, (corners, _, rim), value, k in zip(row, cuts, values, shown, strict=True):
            x, z = corners.reshape(-1, 2).T
            own = np.arange(len(x)).reshape(-1, 3)
            drawn = panel.tripcolor(x, z, value, triangles=own, shading="gouraud", cmap=colours)
            drawn.set_clim(-top if signed else 0.0, top)
            panel.add_collection(LineCollection(list(rim), colors="black", linewidths=0.6))
            pose = bundle.frame("/frames/pose", int(k))
            middle = float(pose[0, 3])
            if indenter is not None:
                vertices = indenter.vertices @ pose[:3, :3].T + pose[:3, 3]
                edge = crossed(vertices, indenter.triangles, float(pose[1, 3]) + SECTION_SHIFT_MM)
                panel.add_collection(LineCollection(list(edge), colors="#606060", linewidths=1.2))
            low = points[:, 2].min() - 0.1
            panel.set(xlim=(middle - half, middle + half), ylim=(low, low + 2 * half * SECTION_HEIGHT_RATIO))
            panel.set(facecolor="white", aspect="equal")
        bundle_figure.frame_axes(row, "z [mm]")
        symbol, _, index = name.partition("_")
        bars.append((drawn, (f"${symbol}_{{{index}}}$" if index else name) + " [MPa]", {}))
    bundle_figure.label_x(grid[-1], "mm")
    return bars


def section(bundle: Bundle, k: int, points: Array, cells: Array, layer: Array) -> tuple[Array, Array, Array]:
    """Section through the indenter at frame k: triangles (t, 3, 2), stress (t, 3, 6), layer outlines (l, 2, 2)."""
    nodes, layers, stress = postprocess.stress_by_layer(bundle, k)
    now = (points + bundle.frame("/fields/displacement", k))[nodes]
    y = float(bundle.frame("/frames/pose", k)[1, 3]) + SECTION_SHIFT_MM
    pieces = []
    for number in np.unique(layers):
        row, here = np.zeros(len(points), int), np.flatnonzero(layers == number)
        row[nodes[here]] = here
        corners, values = cut(now, row[cells[layer == number]], stress, y)
        pieces.append((corners, values, outline(corners)))
    corners, values, rim = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return corners, values, rim


def indenter_surface(bundle: Bundle, size: float) -> "Triangles | None":
    """The indenter's triangles in its own frame, up to `size` [mm].

    None if the file of a mesh is neither in the bundle nor found, or has changed, or if this version of tacgen does not
    know the shape.
    """
    try:
        indenter: Indenter = parsed(Indenter, json.dumps(bundle.recipe.get("indenter")))  # type: ignore[arg-type]
    except ValueError:
        return None
    if indenter.shape != "mesh":
        return surface_of(indenter, size)
    try:
        path = kept_files.located(bundle).get(("indenter", "file")) or assets.mesh_path(indenter.file)
        return surface_of(indenter, size, path) if assets.sha256(path) == indenter.sha256 else None
    except UserError:
        return None


def surface_of(indenter: Indenter, size: float, path: Path | None = None) -> Triangles:
    """The triangles of an indenter in its own frame, up to `size` [mm]; path: the file of a mesh, if it is elsewhere.

    Raises:
        UserError: the file of a mesh cannot be read.
    """
    if (shape := analytic(indenter)) is not None:
        return surface_nets.of_shape(shape, half=size, height=size, tolerance=0.02)
    assert indenter.shape == "mesh"
    solid = mesh_file.read(path or assets.mesh_path(indenter.file))
    solid = mesh_import.placed(solid, up=indenter.up, scale=indenter.scale, size=indenter.size_mm)
    return Triangles(solid.vertices, solid.triangles)


XY_CAPTION = "x to the right, y down in the image, z out of the gel toward the object"
MAP_CAPTIONS = {
    "height": f"height of the deformed coated face less that of the untouched one; {XY_CAPTION}",
    "flow": f"motion of the coating's points in the image since the untouched one; {XY_CAPTION}",
}
DRAWN_FIELDS: dict[str, tuple[tuple[str, ...], str, int, Any, str]] = {  # datasets, output, rows, function, caption
    "camera": (("/frames/rgb",), "rgb", 1, _camera, f"camera images; {XY_CAPTION}"),
    "markers": (
        ("/reference/markers", "/frames/marker_flow"), "markers", 1, _camera,
        f"motion of the markers since the untouched image, magnified as said below; {XY_CAPTION}",
    ),
    "pressure": (
        ("/frames/pressure",), "traction", 1, partial(_map, "pressure"),
        f"normal to the deformed coated face, per area of it, positive in compression; {XY_CAPTION}",
    ),
    "traction": (
        ("/frames/traction",), "traction", 1, partial(_map, "traction"),
        f"friction on the gel, in the tangent plane of the deformed face, per area of it; {XY_CAPTION}",
    ),
    "slip": (
        ("/frames/pressure", "/frames/contact"), "traction", 1, _slip,
        f"stick: friction holds; slip: it slides; edge: touched in part; {XY_CAPTION}",
    ),
    "stress": (
        ("/fields/cauchy_stress", "/fields/nodal_stress"), "stress", len(STRESS_SECTIONS), draw_stress,
        "Cauchy stress of the deformed gel in the xz plane through the indenter; tension is positive; "
        "x right in the image, z out of the gel",
    ),
}  # fmt: skip
DRAWN_FIELDS |= {  # every other map that the viewer has
    name: (datasets_of(layer), name, 1, partial(_map, name), MAP_CAPTIONS.get(name, f"{layer.label}; {XY_CAPTION}"))
    for name, layer in DRAWN_MAPS.items()
    if name not in DRAWN_FIELDS
}
