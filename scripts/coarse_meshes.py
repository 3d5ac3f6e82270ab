"""Measure the error of forces on coarse meshes, from which the bounds of a bundle's note on its mesh come.

    python scripts/coarse_meshes.py [ball cone ...] [--fine 0.25] [--edges 0.4 0.8 1.2 2.0]

Each indenter is pressed into a GelSight Mini (4 mm of gel) and slid by 0.3 mm with friction 0.6. A line has the element
edge over the gel's thickness, the indenter's smallest radius over the edge, the errors of the normal force of the press
and of the tangential one of the slide, against edges of --fine [mm], and the bound that the note states. One indenter
takes half a minute.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from tacgen import pipeline
from tacgen.bundle import bundle
from tacgen.errors import UserError
from tacgen.mechanics import cost_note
from tacgen.recipe import plan
from tacgen.recipe.indenters import analytic

INDENTERS = {
    "ball": ("{shape: sphere, radius_mm: 4}", 1.0),
    "small_ball": ("{shape: sphere, radius_mm: 2}", 0.5),
    "smallest_ball": ("{shape: sphere, radius_mm: 1}", 0.4),
    "box": ("{shape: box, size_x_mm: 6, size_y_mm: 6, fillet_mm: 0.5}", 0.5),
    "sharp_box": ("{shape: box, size_x_mm: 4, size_y_mm: 4, fillet_mm: 0.2}", 0.5),
    "punch": ("{shape: cylinder, radius_mm: 2, fillet_mm: 0.3}", 0.5),
    "cone": ("{shape: cone, half_angle_deg: 45, tip_radius_mm: 0.5}", 0.8),
    "ring": ("{shape: torus, radius_mm: 3, tube_radius_mm: 1}", 0.5),
}
THICKNESS = 4.0  # of a GelSight Mini's gel [mm]
TIPS = ("small_ball", "smallest_ball", "ball", "cone")
RECIPE = """tacgen: 1
name: coarse
sensor: gelsight_mini
indenter: {indenter}
trajectory: [press: {{depth_mm: {depth}, frames: 1}}, slide: {{x_mm: 0.3, frames: 1}}]
contact: {{friction: 0.6}}
outputs: [force]
quality: {{edge_mm: {edge}}}
"""


def measured(indenter: str, depth: float, edge: float, folder: Path) -> tuple[float, float, float]:
    """Normal force of the press and tangential one of the slide [N], and the indenter's smallest radius [mm]."""
    path = folder / f"{edge:g}.yaml"
    path.write_text(RECIPE.format(indenter=indenter, depth=depth, edge=edge))
    row = plan.load(path).rows[0]
    force = bundle.read(pipeline.run_scene(row, folder / path.stem).path)["/frames/force"]
    shape = analytic(row.recipe.indenter)
    assert shape is not None
    return float(-force[0, 2]), float(force[1, 0]), shape.smallest_radius


def errors(name: str, edges: list[float], fine: float, folder: Path) -> dict[float, tuple[float, float, float, float]]:
    """By edge [mm]: errors of the normal and the tangential force, their bound, and the radius over the edge [-]."""
    indenter, depth = INDENTERS[name]
    found: dict[float, tuple[float, float, float, float]] = {}
    normal, tangential, radius = measured(indenter, depth, fine, folder)
    for edge in edges:
        try:
            n, t, _ = measured(indenter, depth, edge, folder)
        except UserError:
            continue  # the indenter is too thin for such a mesh
        sharp = name in TIPS and radius < edge
        bound = (cost_note.TIP_ERROR if sharp else cost_note.COARSE_ERROR) * edge / THICKNESS
        found[edge] = n / normal - 1, t / tangential - 1, bound, radius / edge
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("indenters", nargs="*", help=f"of {', '.join(INDENTERS)}; all if left out")
    parser.add_argument("--fine", type=float, default=0.25, help="edge of the reference [mm]")
    parser.add_argument("--edges", type=float, nargs="+", default=[0.4, 0.8, 1.2, 2.0], help="[mm]")
    given = parser.parse_args()
    for name in given.indenters or INDENTERS:
        with TemporaryDirectory() as folder:
            found = errors(name, given.edges, given.fine, Path(folder))
        for edge, (normal, tangential, bound, radius) in found.items():
            sizes = f"edge/thickness {edge / THICKNESS:.2f}  radius/edge {radius:5.2f}"
            print(f"{name:14} {sizes}  normal {normal:+.1%}  tangential {tangential:+.1%}  bound {bound:.0%}")


if __name__ == "__main__":
    main()
