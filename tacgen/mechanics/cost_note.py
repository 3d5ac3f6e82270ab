"""A note on a scene that takes long."""

import math
from dataclasses import replace

from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene

MANY_CONTACT_DOFS = 3000  # of contact; from here on a frame takes seconds
MAX_SAMPLED_FRAMES = 40  # frames at which the area in contact is looked at
# of a frame with 1000 unknowns of contact [s]; one press of 0.3 mm with 2240 and 4740: 15 and 99 s
SECONDS_PER_1000_DOFS = 1.0


def cost_note(built: Scene, facets: int) -> str:
    """A note where much of the face is in contact at once, or ""; the contact's unknowns are solved for as one dense
    system. At most MAX_SAMPLED_FRAMES of the frames are looked at, none if the whole face has too few `facets`."""
    if built.element == "hex" and 3 * facets < MANY_CONTACT_DOFS:
        return ""

    def area(at: Scene) -> float:
        return len(mesh.touched(at)) * (at.edge / mesh.FACE_POINTS_PER_EDGE) ** 2

    most = MANY_CONTACT_DOFS * built.edge**2 / 3
    if area(built) < most:  # of all frames together
        return ""
    some = built.poses[:: math.ceil(len(built.poses) / MAX_SAMPLED_FRAMES)]
    largest = max(area(replace(built, start=pose, poses=pose[None], forced=None)) for pose in some)
    if largest < most:
        return ""
    unknowns = 3 * largest / built.edge**2
    seconds = SECONDS_PER_1000_DOFS * (unknowns / 1000) ** 2.5
    return (
        f"contact has about {round(unknowns, -2):.0f} unknowns, since {largest:.3g} mm^2 of the face are touched at"
        f" once with edges of {built.edge:g} mm: a frame takes about {round(seconds, -1):.0f} s, several times that if"
        " it is long or the gel folds; a larger quality.edge_mm or a smaller indenter takes less"
    )
