"""An HTML page to view a bundle frame by frame, or two side by side: camera, maps, and the gel in 3D with its stress.

It needs no other file and no network, and its content security policy forbids both. viewer.js draws; this module
provides the data: images as WebP, maps as grey PNG (0: nan, 1 to 255: the layer's scale), the gel as little-endian
arrays.
"""

import base64
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import scene_text
from tacgen.bundle.check import UNIQUE_PATH
from tacgen.bundle.force_error import force_error
from tacgen.bundle.image_file import encoded
from tacgen.fem.elements import triangles
from tacgen.outputs import DRAWN_MAPS
from tacgen.report import html_page
from tacgen.report.bundle_figure import evenly, image_size, magnification, only, scale_of
from tacgen.report.field_figure import DRAWN_FIELDS, SECTION_WIDTH_RATIO, STRESS_SECTIONS, indenter_surface, section
from tacgen.report.layers import datasets_of, has_arrows, limits, map_of
from tacgen.report.plane_cut import boundary

if TYPE_CHECKING:
    from tacgen.geometry.surface_nets import Triangles

Array = np.ndarray
LAYER_DATASETS = {
    "camera": ("/frames/rgb",),
    "markers": ("/reference/markers", "/frames/marker_flow"),  # arrows on the camera images
    **{name: datasets_of(layer) for name, layer in DRAWN_MAPS.items()},
    "stress": ("/mesh/points", "/frames/pose", *DRAWN_FIELDS["stress"][0]),
}
# most frames of a page, evenly spread over a longer scene; a frame with all layers takes about 0.2 MB
MAX_VIEWER_FRAMES = 60
LARGEST_FORCE_LABEL = "largest force"
ARROWS_ACROSS = 24  # arrows across a map
VIEWER_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def write(paths: Sequence[Path], out: Path) -> None:
    """Write the signed page of one or two bundles, each given by its file or by a folder with only one.

    Raises:
        UserError: not a complete bundle, or one without frames.
        OSError: `out` cannot be written.
    """
    bundles = [only(path) for path in paths]
    for bundle in bundles:
        if not bundle.frames:
            raise UserError(f"{bundle.path}: has no frames to show")
    output_file.add(out, output_file.signed(page(bundles)))


def page(bundles: Sequence[Bundle], *, in_3d: bool = True) -> str:
    """The whole page of one or two bundles with frames, with or without the gel in 3D."""
    title = escape(" | ".join(_name(bundle) for bundle in bundles))
    return html_page.page(title, block(bundles, in_3d=in_3d), VIEWER_POLICY)


def block(bundles: Sequence[Bundle], *, in_3d: bool = True) -> str:
    """The viewer as part of a page: its data and its script.

    Two bundles share the scales of colours and arrows. Raises UserError: a mesh that cannot be drawn.
    """
    wanted = {name: needs for name, needs in LAYER_DATASETS.items() if in_3d or name != "stress"}
    names = [name for name, needs in wanted.items() if any(_all_in(bundle, needs) for bundle in bundles)]
    scales = {name: _scale(name, bundles) for name in names if name in DRAWN_MAPS}
    solids = [_solid(bundle) if in_3d and _all_in(bundle, LAYER_DATASETS["stress"]) else None for bundle in bundles]
    parts = []
    for i, (label, _, colours, signed) in enumerate(STRESS_SECTIONS if any(solids) else ()):
        top = max(float(np.quantile(np.abs(solid.all_values(i)), 0.999)) for solid in solids if solid) or 1e-3
        parts.append({"low": -top if signed else 0.0, "high": top, "label": f"{label} [MPa]", "colours": colours})
    tables = {scale["colours"] for scale in (*scales.values(), *parts)}
    times = min((magnification(bundle) for bundle in bundles if _all_in(bundle, LAYER_DATASETS["markers"])), default=1)
    data = {
        "layers": names,
        "scales": scales,
        "parts": parts,
        "magnified": times,
        "colours": {name: _base64(_table(name)) for name in sorted(tables)},
        "bundles": [
            _about(bundle) | {"layers": _layers(bundle, scales, times), "solid": solid and solid.packed(parts)}
            for bundle, solid in zip(bundles, solids, strict=True)
        ],
    }
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")  # so that no text ends the script
    script = html_page.asset("viewer.js")
    return f'<div class=viewer></div><script type="application/json" id=viewed>{text}</script><script>{script}</script>'


def shown(bundle: Bundle) -> Array:
    """The numbers of the frames that the page shows: evenly spread, and those of `marks`."""
    return np.unique([*evenly(bundle.frames, MAX_VIEWER_FRAMES), *marks(bundle).values()])


def marks(bundle: Bundle) -> dict[str, int]:
    """Telling frames of a bundle with frames by what they are: of the largest force, the first after a fold or snap of
    the gel, and the last before the scene was rejected."""
    found: dict[str, int] = {}
    if "/frames/force" in bundle:
        found[LARGEST_FORCE_LABEL] = int(np.linalg.norm(bundle["/frames/force"], axis=1).argmax())
    if UNIQUE_PATH in bundle and not (unique := bundle[UNIQUE_PATH]).all():
        found["first fold or snap"] = int((~unique).argmax())
    if bundle.attrs["status"] != "ok":
        found["last before rejection"] = bundle.frames - 1
    return found


def _name(bundle: Bundle) -> str:
    return f"{bundle.recipe.get('name', '')}, {bundle.path.stem}"


def _all_in(bundle: Bundle, needs: Sequence[str]) -> bool:
    return all(path in bundle for path in needs)


def _scale(name: str, bundles: Sequence[Bundle]) -> dict[str, Any]:
    layer = DRAWN_MAPS[name]
    ends = [limits(map_of(layer, bundle)) for bundle in bundles if _all_in(bundle, datasets_of(layer))]
    low, high = min(low for low, _ in ends), max(high for _, high in ends)
    return {"low": low, "high": high, "label": layer.label, "colours": layer.colours}


def _about(bundle: Bundle) -> dict[str, Any]:
    """Texts, forces and sizes of a bundle."""
    frames, segments = shown(bundle), bundle.segments
    scale = scale_of(bundle)
    error = force_error(bundle)
    return {
        "name": _name(bundle),
        "about": scene_text(bundle),
        "rejected": "" if bundle.attrs["status"] == "ok" else f"{bundle.attrs['status']}: {bundle.attrs['reason']}",
        "frames": frames.tolist(),
        "marks": marks(bundle),
        "segments": [segments[k] for k in frames],
        "force": _numbers(bundle["/frames/force"][frames]) if "/frames/force" in bundle else None,
        "error": error and [error.text(k) for k in frames],
        "errorKind": error.kind if error else "",
        "box": scale.box(*image_size(bundle)),
        "unit": scale.unit,
    }


def _layers(bundle: Bundle, scales: dict[str, Any], times: int) -> dict[str, Any]:
    """Images and arrows of every layer except the 3D view."""
    maps: dict[str, Any] = {}
    frames, (height, width) = shown(bundle), image_size(bundle)
    if _all_in(bundle, LAYER_DATASETS["camera"]):
        pictures = [_picture(bundle.frame("/frames/rgb", int(k)), "WEBP") for k in frames]
        maps["camera"] = {"kind": "webp", "pictures": pictures}
    if _all_in(bundle, LAYER_DATASETS["markers"]):
        at, by = bundle["/reference/markers"] / (width, height), times * bundle["/frames/marker_flow"][frames] / width
        maps["markers"] = {"arrows": {"at": _numbers(at), "by": _numbers(by)}}
    for name, scale in scales.items():
        layer = DRAWN_MAPS[name]
        if not _all_in(bundle, datasets_of(layer)):
            continue
        drawn = map_of(layer, bundle)[frames]
        maps[name] = {"kind": "png", "pictures": [_picture(grey, "PNG") for grey in _levels(drawn, scale)]}
        if has_arrows(layer, bundle):
            h, w = drawn.shape[1:]
            step = max(1, round(w / ARROWS_ACROSS))
            rows, columns = np.arange(step // 2, h, step), np.arange(step // 2, w, step)
            at = np.stack(np.meshgrid((columns + 0.5) / w, (rows + 0.5) / h), -1).reshape(-1, 2)
            by = bundle[layer.path][frames][:, rows[:, None], columns].reshape(len(frames), -1, 2)
            by = by / scale["high"] * 1.3 / ARROWS_ACROSS
            maps[name]["arrows"] = {"at": _numbers(at), "by": _numbers(by)}
    return maps


class _Solid(NamedTuple):
    """The gel's boundary over the frames, and sections through the indenter, with the values of STRESS_SECTIONS in
    order.
    """

    faces: Array  # (t, 3) numbers of boundary nodes
    rims: Array  # (l, 2), edges of the mesh
    points: Array  # (n, s, 3) [mm]
    values: Array  # (parts, n, s) [MPa]
    cuts: list[tuple[Array, Array, float]]  # a frame: corners (t, 3, 3) [mm], values (parts, 3 t), y [mm]
    indenter: "Triangles | None"
    poses: Array  # (n, 4, 4)

    def all_values(self, part: int) -> Array:
        return np.concatenate([self.values[part].ravel(), *(values[part] for _, values, _ in self.cuts)])

    def packed(self, parts: list[dict[str, Any]]) -> dict[str, Any]:
        """The data for the script: arrays as base64, values as levels of their scales."""

        def levels(values: Array) -> list[str]:
            return [_base64(_levels(v, scale)) for v, scale in zip(values, parts, strict=True)]

        return {
            "faces": _base64(self.faces.astype("<u4")),
            "rims": _base64(self.rims.astype("<u4")),
            "points": [_base64(points.astype("<f4")) for points in self.points],
            "values": [levels(self.values[:, k]) for k in range(len(self.points))],
            "cuts": [
                {"points": _base64(corners.astype("<f4")), "values": levels(values), "y": y}
                for corners, values, y in self.cuts
            ],
            "indenter": self.indenter
            and {
                "points": _base64(self.indenter.vertices.astype("<f4")),
                "faces": _base64(self.indenter.triangles.astype("<u4")),
            },
            "poses": _numbers(self.poses.transpose(0, 2, 1).reshape(-1, 16)),  # column-major
        }


def _solid(bundle: Bundle) -> _Solid:
    points, cells, layer = bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"]
    nodes, facets = np.unique(boundary(cells), return_inverse=True)
    rims = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
    rims = np.unique(np.sort(rims, axis=1), axis=0)
    moved, values, cuts = [], [], []
    for k in (int(frame) for frame in shown(bundle)):
        moved.append((points + bundle.frame("/fields/displacement", k))[nodes])
        stress = bundle.frame("/fields/nodal_stress", k)[nodes]
        values.append([what(stress) for _, what, _, _ in STRESS_SECTIONS])
        flat, within, _ = section(bundle, k, points, cells, layer)
        y = float(bundle.frame("/frames/pose", k)[1, 3])
        corners = np.insert(flat, 1, y, axis=-1)
        cuts.append((corners, np.stack([what(within.reshape(-1, 6)) for _, what, _, _ in STRESS_SECTIONS]), y))
    size = SECTION_WIDTH_RATIO * float(np.ptp(points[:, 2]))
    poses = bundle["/frames/pose"][shown(bundle)]
    return _Solid(
        triangles(facets), rims, np.stack(moved), np.stack(values, 1), cuts, indenter_surface(bundle, size), poses
    )


def _levels(values: Array, scale: dict[str, Any]) -> Array:
    """Values as 1 to 255 over the scale; nan as 0."""
    part = np.clip((values - scale["low"]) / (scale["high"] - scale["low"]), 0, 1)
    return np.where(np.isfinite(values), 1 + np.rint(254 * np.nan_to_num(part)), 0).astype(np.uint8)


def _table(colours: str) -> Array:
    """(255, 3) RGB of a colour map's levels."""
    from matplotlib import colormaps

    return np.asarray(colormaps[colours](np.linspace(0, 1, 255), bytes=True))[:, :3]


def _picture(pixels: Array, kind: str) -> str:
    return base64.b64encode(encoded(pixels, kind, quality=85)).decode()


def _base64(array: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _numbers(values: Array) -> Any:
    """As lists; 0 where not finite, which JSON cannot express."""
    return np.nan_to_num(values.astype(float), posinf=0.0, neginf=0.0).round(5).tolist()
