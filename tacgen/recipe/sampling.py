"""The samples of a `vary`: points of the unit cube by its method and seed, the values there, and a grid across them."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tacgen.recipe.model import FEW, Distribution, Vary
from tacgen.recipe.validation_messages import Problem

if TYPE_CHECKING:
    import numpy as np

DRAW = 1  # purpose of these random numbers; plan holds the other
CORRELATED = 0.3  # two varied values in a sample: a model trained on it may take one for the other


def scene_count(vary: Vary) -> int:
    """How many scenes a `vary` gives."""
    crossed = math.prod(len(_points(spread)) for spread in vary.grid.values())
    if vary.method != "grid":
        return crossed * (vary.samples or 0)
    return crossed * math.prod(len(_points(spread)) for spread in vary.over.values())


def draw(vary: Vary, indices: Sequence[int]) -> list[dict[str, Any]]:
    """The varied values of these scenes; each is what the whole plan has there. The grid varies fastest."""
    from numpy import unravel_index

    on_grid = {**vary.over, **vary.grid} if vary.method == "grid" else vary.grid
    columns = [_points(spread) for spread in on_grid.values()]
    points = math.prod(map(len, columns))
    drawn: list[dict[str, Any]] = [{} for _ in indices]
    if vary.method != "grid":
        unit = _unit_points(vary, len(vary.over), [index // points for index in indices])
        drawn = [{p: _value(s, float(u)) for (p, s), u in zip(vary.over.items(), at, strict=True)} for at in unit]
    for index, values in zip(indices, drawn, strict=True):
        places = unravel_index(index % points, [len(column) for column in columns])
        values.update({path: column[int(i)] for path, column, i in zip(on_grid, columns, places, strict=True)})
    return drawn


def _unit_points(vary: Vary, d: int, indices: Sequence[int]) -> "list[np.ndarray]":
    """Points of the unit cube, one a scene."""
    from numpy.random import SeedSequence, default_rng
    from scipy.stats import qmc

    design = vary.design
    if design == "random":
        return [default_rng(SeedSequence((vary.seed, i, DRAW))).random(d) for i in indices]
    rng = default_rng(SeedSequence((vary.seed, 0, DRAW)))
    if design == "lhs":  # a point of a latin hypercube depends on all others: draw them all
        few = (vary.samples or 0) <= FEW  # then by columns that hardly correlate; of more, that takes too long
        points = qmc.LatinHypercube(d, optimization="random-cd" if few else None, rng=rng).random(vary.samples)
        return [points[i] for i in indices]
    engine = qmc.Sobol(d, rng=rng) if design == "sobol" else qmc.Halton(d, rng=rng)
    found: dict[int, np.ndarray] = {}
    for i in sorted(set(indices)):
        if i > engine.num_generated:
            engine.fast_forward(i - engine.num_generated)
        found[i] = engine.random(1)[0]
    return [found[i] for i in indices]


def correlated(vary: Vary) -> list[Problem]:
    """Whether few points of a sequence that is meant to be even are not: two varied values go along with each other."""
    import numpy as np

    n, paths = vary.samples or 0, list(vary.over)
    if vary.design not in ("sobol", "halton") or not 3 <= n <= FEW or len(paths) < 2:
        return []
    r = np.triu(np.corrcoef(np.array(_unit_points(vary, len(paths), range(n))).T), 1)
    i, j = np.unravel_index(np.abs(r).argmax(), r.shape)
    if abs(r[i, j]) < CORRELATED:
        return []
    text = f"{n} points of {vary.design} correlate {paths[i]} and {paths[j]} by {r[i, j]:.2f}"
    return [Problem(("vary", "method"), f"{text}: leave method out, and so few are spread as a Latin hypercube")]


def _value(spread: Distribution, u: float) -> Any:
    """The value of a distribution at u in [0, 1)."""
    if spread.uniform:
        low, high = spread.uniform
        return low + (high - low) * u
    if spread.loguniform:
        low, high = spread.loguniform
        return min(max(low * (high / low) ** u, low), high)
    if spread.integers:
        first, last = spread.integers
        return min(first + int(u * (last - first + 1)), last)
    points = _points(spread)
    return points[min(int(u * len(points)), len(points) - 1)]


def _points(spread: Distribution) -> Sequence[Any]:
    """The values of a choice or linspace."""
    if spread.choice is not None:
        return spread.choice
    first, last, n = spread.linspace or (0.0, 0.0, 0)
    return [first + (last - first) * i / max(n - 1, 1) for i in range(n)]
