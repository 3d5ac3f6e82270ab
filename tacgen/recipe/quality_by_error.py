"""The quality that an expected error of the force asks for."""

import numpy as np

from tacgen.base.errors import UserError
from tacgen.mechanics.expected_error import Expected, expected_force_error
from tacgen.mechanics.scene import Scene
from tacgen.recipe.checks import MAX_EDGE_PER_THICKNESS
from tacgen.recipe.model import QUALITIES, QualityNumbers

# element edges [mm] between which one is chosen: finer ones take minutes a frame
MIN_CHOSEN_EDGE_MM, MAX_CHOSEN_EDGE_MM = 0.15, 1.0
TRIED_EDGE_RATIO = 0.97  # ratio of two edges that are tried [-]


def chosen(scene: Scene, error: float) -> QualityNumbers | None:
    """The longest edge with this expected error [-], and the range of contact that belongs to it; None if nothing
    touches.

    Raises:
        UserError: the error of this scene is not known, or asks for edges below MIN_CHOSEN_EDGE_MM.
    """
    expected = Expected.of(scene)
    if expected is None:
        if scene.element == "linear_tet":
            raise UserError("quality.force_error: is not known for linear tetrahedra: give edge_mm")
        return None
    edge = expected.edge_with(
        error, min(MAX_CHOSEN_EDGE_MM, MAX_EDGE_PER_THICKNESS * scene.gel.thickness), TRIED_EDGE_RATIO
    )
    if edge < MIN_CHOSEN_EDGE_MM:
        least = expected_force_error(MIN_CHOSEN_EDGE_MM, expected.contact, expected.radius)
        raise UserError(
            f"quality.force_error: {error:.2g} asks for edges below {MIN_CHOSEN_EDGE_MM:g} mm, where the expected "
            f"error is"
            f" {least:.2g}: ask for a larger one, or for edge_mm"
        )
    return QualityNumbers(edge_mm=float(f"{edge:.3g}"), dhat_mm=float(f"{_range_of(edge):.2g}"))


def _range_of(edge: float) -> float:
    """Range of the barrier [mm] at an element edge [mm]: the presets', between them and beyond by powers."""
    known = sorted((quality.edge_mm, quality.dhat_mm) for quality in QUALITIES.values())
    edges, ranges = np.log(known).T
    part = np.searchsorted(edges[1:-1], np.log(edge))  # of the two powers
    power = (ranges[part + 1] - ranges[part]) / (edges[part + 1] - edges[part])
    return float(np.exp(ranges[part] + power * (np.log(edge) - edges[part])))
