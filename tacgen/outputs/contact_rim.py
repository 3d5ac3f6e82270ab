"""The gap beside a contact, between the nodes of a mesh.

At a small distance s from its rim, the gap between smooth bodies is proportional to s^(3/2) (Johnson 1985, Contact
Mechanics, section 5.1). No polynomial between nodes follows that: drawn by one, the rim is scalloped. The gap to the
power 2/3, here the opening, is smooth, and its zero is the rim.
"""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.thin_plate import distances, thin_plate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

RIM_GAP_POWER = 2 / 3  # of the gap, that is linear beside a rim [-]
# edges from the contact up to which the opening alone holds, and beyond which it does not [-]
FULL_OPENING_EDGES, MAX_OPENING_EDGES = 2.0, 3.0
# weight of bending over misfit, lengths in edges: nodal gaps beside the rim are off by a few 0.01 mm
BENDING_WEIGHT = 0.3
MIN_RIM_NODES = 6  # nodes beside the contact, from which the opening is known


def openings(at: "Array", gap: "Array", closed: "NDArray[np.bool_]", edge: float) -> "Array | None":
    """Opening of the gap and its weight at the nodes of a face.

    Beside the contact the opening is a thin-plate spline through gap^RIM_GAP_POWER; it continues below 0 within the
    contact, so that the rim lies between the nodes.

    Args:
        at: nodes at rest, (s, 2) [mm].
        gap: their distance to the indenter, (s,) [mm].
        closed: nodes in contact, (s,).
        edge: edge of the mesh's elements [mm].

    Returns:
        Openings [mm^RIM_GAP_POWER] and weights from 0 to 1, (s, 2); None without a contact, or with no free nodes
        beside it.
    """
    if not closed.any():
        return None
    closed = closed | (gap <= gap[closed].max())  # cells touch with less than half of their points there
    scaled, away = at / edge, distances(at, at[closed], MAX_OPENING_EDGES * edge) / edge
    beside = ~closed & (away < MAX_OPENING_EDGES)
    if beside.sum() < MIN_RIM_NODES:
        return None
    found = np.maximum(gap, 0.0) ** RIM_GAP_POWER
    found[beside], within = thin_plate(scaled[beside], found[beside], scaled[closed], BENDING_WEIGHT)
    found[closed] = np.minimum(within, 0.0)
    share = np.clip((MAX_OPENING_EDGES - away) / (MAX_OPENING_EDGES - FULL_OPENING_EDGES), 0.0, 1.0)
    return np.column_stack([found, share * share * (3 - 2 * share)])


def gaps(opening: "Array") -> "Array":
    """Gap (n,) [mm] of openings (n,); 0 within the contact."""
    opening = np.maximum(opening, 0.0)
    return np.asarray(opening * np.sqrt(opening))  # to the power 1 / RIM_GAP_POWER, in a tenth of the time
