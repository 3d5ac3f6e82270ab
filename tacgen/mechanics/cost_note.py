"""Notes on a scene that its mesh does not resolve, or that takes long."""

import math
from dataclasses import replace

from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene

MIN_EDGES = 3  # an indenter's smallest radius should be at least so many edges of the mesh
# largest error of a force over edge/thickness [-]: of indenters and, above it, of tips narrower than an edge
COARSE_ERROR, TIP_ERROR = 1.1, 2.2
MANY_UNKNOWNS = 3000  # of contact; from here on a frame takes seconds
LOOKS = 40  # frames at which the area in contact is looked at
COST_S = 1.0  # of a frame with 1000 unknowns of contact [s]; one press of 0.3 mm with 2240 and 4740: 15 and 99 s


def resolution_note(radius: float, edge: float, thickness: float, formulation: str) -> str:
    """A note where the mesh does not resolve the indenter, or ""; scripts/coarse_meshes.py measures what that costs."""
    if radius >= MIN_EDGES * edge:
        return ""
    off, tips = (100 * bound * edge / thickness for bound in (COARSE_ERROR, TIP_ERROR))
    off = max(off, 50.0) if formulation == "ipctk" else off
    limit = f"{MIN_EDGES} edges of the mesh" if radius >= edge else "the mesh's edge"
    of_tips = "" if radius >= edge else f", of tips {max(off, tips):.0f} %"
    return (
        f"the indenter's smallest radius, {radius:g} mm, is below {limit}, {edge:g} mm: forces are up to {off:.0f} %"
        f" off{of_tips}, and more if it is pressed less than a tenth of the gel's thickness"
    )


def cost_note(built: Scene, facets: int) -> str:
    """A note where much of the face is in contact at once, or ""; the contact's unknowns are solved for as one dense
    system. At most LOOKS of the frames are looked at, none if the whole face has too few `facets`."""
    if built.element == "hex" and 3 * facets < MANY_UNKNOWNS:
        return ""

    def area(at: Scene) -> float:
        return len(mesh.touched(at)) * (at.edge / mesh.FACE_STEPS) ** 2

    most = MANY_UNKNOWNS * built.edge**2 / 3
    if area(built) < most:  # of all frames together
        return ""
    some = built.poses[:: math.ceil(len(built.poses) / LOOKS)]
    largest = max(area(replace(built, start=pose, poses=pose[None], forced=None)) for pose in some)
    if largest < most:
        return ""
    unknowns = 3 * largest / built.edge**2
    seconds = COST_S * (unknowns / 1000) ** 2.5
    return (
        f"contact has about {round(unknowns, -2):.0f} unknowns, since {largest:.3g} mm^2 of the face are touched at"
        f" once with edges of {built.edge:g} mm: a frame takes about {round(seconds, -1):.0f} s, several times that if"
        " it is long or the gel folds; a larger quality.edge_mm or a smaller indenter takes less"
    )
