"""About how far a scene's forces will be off because of its mesh, told before it is run."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from tacgen.errors import UserError
from tacgen.geometry.outline import Pad

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.geometry.gel import GelBody
    from tacgen.recipe.row import Row

LOOKED_AT = 12  # frames of a scene whose contact is measured


@dataclass(frozen=True)
class PadOfThickness(Pad):
    """A pad and its thickness at the crown [mm]: what a path over a gel needs of it."""

    thickness: float = 0.0


def note(row: "Row") -> str:
    """A line on the expected error of the force by the mesh, for the frame with the widest contact; "" where it is not
    known: for a force that is prescribed, a grasp, mesh-to-mesh contact and linear tetrahedra, and without contact."""
    recipe = row.recipe
    if row.other is not None or recipe.contact.formulation != "distance" or recipe.mesh == "linear_tet":
        return ""
    from tacgen.mechanics.expected_error import FACTOR, FaceGrid, expected_force_error
    from tacgen.recipe.path import indenter_path

    try:
        gel, shape = _bodies(row)
        path = indenter_path(recipe, shape, gel, row.replayed)
    except UserError:  # its run reports it
        return ""
    if path.forced is not None:
        return ""
    face, edge = FaceGrid.of(gel), recipe.resolved().edge_mm
    some = path.poses[:: -(-len(path.poses) // LOOKED_AT)]
    widths = [width for pose in (*some, path.poses[-1]) if (width := face.width(shape, pose)) > 0]
    if not widths:
        return ""
    sharp = ", and several times that at edges and tips sharper than the mesh" * (shape.smallest_radius < edge)
    error = _rounded(100 * expected_force_error(edge, max(widths)))
    return (
        f"expected error of the force by the mesh: about {error} %, within a factor of {FACTOR} (edges of"
        f" {edge:g} mm, a contact {2 * max(widths):.2g} mm wide); more where the contact is narrower{sharp}"
    )


def _rounded(percent: float) -> str:
    """To one digit, without an exponent."""
    return f"{float(f'{percent:.1g}'):g}"


def _bodies(row: "Row") -> "tuple[GelBody, Shape]":
    """Gel and indenter. A pad under an analytic shape is made without what meshing it would import."""
    from tacgen.recipe import indenters

    gel, shape = row.sensor.gel, indenters.analytic(row.recipe.indenter)
    if shape is None or gel.solid is not None:
        from tacgen.recipe.scene_of_row import gel_of, shape_of

        return gel_of(row.sensor, row.solid_path if gel.solid else None), shape_of(row)
    return cast("GelBody", PadOfThickness(**vars(gel.pad), thickness=gel.thickness_mm)), shape
