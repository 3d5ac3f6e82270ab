"""Scenes that do not touch the gel: told before they are run, and not kept as `ok` unless a recipe says `may_miss`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tacgen.recipe.model import Recipe
    from tacgen.recipe.row import Row

NO_CONTACT_MESSAGE = "touches the gel in no frame"
MISSED_MESSAGE = NO_CONTACT_MESSAGE + ": closest approach {:.3g} mm"
KEEP_HINT = "check its start or poses, and their unit; may_miss: true keeps such scenes"


def verdict(recipe: "Recipe", gap: float) -> tuple[bool, str]:
    """Whether a scene without force is ok, whose indenter came as close as `gap` [mm], and a line that says so."""
    quality = recipe.resolved()
    if gap < -quality.dhat_mm:
        finer = f"ask for a finer mesh, as in quality: {{edge_mm: {quality.edge_mm / 2:.2g}}}"
        return False, f"the indenter is {-gap:.3g} mm inside the gel without force, between contact points: {finer}"
    text = f"the indenter {MISSED_MESSAGE.format(gap)}"
    return recipe.may_miss, text if recipe.may_miss else f"{text}; {KEEP_HINT}"


def note(gaps: Sequence[tuple["Row", float]]) -> str:
    """A line about those scenes that stay farther from the gel than contact reaches [mm], or ""."""
    missed = [(row, gap) for row, gap in gaps if gap >= row.recipe.resolved().dhat_mm]
    if not missed:
        return ""
    row, gap = missed[0]
    more = f"; nor do {len(missed) - 1} more of the first {len(gaps)} scenes" if len(missed) > 1 else ""
    rejected = "" if row.recipe.may_miss else f": a run rejects it; {KEEP_HINT}"
    return f"{row.name} {MISSED_MESSAGE.format(gap)}{more}{rejected}"
