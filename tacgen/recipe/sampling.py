"""The samples of `vary`: points of the unit cube by method and seed, their values, and the grid crossed with them."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal

from tacgen.recipe.model import MAX_LHS_SAMPLES, Distribution, Vary
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath, branches, put

if TYPE_CHECKING:
    import numpy as np

SAMPLING_STREAM = 1  # number of this purpose in the seeds of random numbers; the other is in plan.py
MAX_UNWARNED_CORRELATION = 0.3  # correlation of two varied values above which a warning is given [-]


def scene_count(vary: Vary) -> int:
    """The number of scenes of a `vary`."""
    crossed = math.prod(map(_count, vary.grid.values()))
    if vary.method != "grid":
        return crossed * (vary.samples or 0)
    return crossed * math.prod(map(_count, vary.over.values()))


def draw(vary: Vary, indices: Sequence[int]) -> Callable[[int], dict[str, Any]]:
    """The varied values of the k-th of these scenes, the same as in the whole plan. The grid varies fastest."""
    on_grid = {**vary.over, **vary.grid} if vary.method == "grid" else vary.grid
    over = {} if vary.method == "grid" else vary.over
    points = math.prod(map(_count, on_grid.values()))
    sizes = {path: _inner_count(spread) for path, spread in over.items()}
    dimensions = len(over) + sum(sizes.values())
    unit = _unit_points(vary, dimensions, [index // points for index in indices]) if over else None

    def values(k: int) -> dict[str, Any]:
        drawn: list[float] = [] if unit is None else unit[k].tolist()
        within = iter(drawn[len(over) :])  # for the distributions inside choices
        drawn_values = {
            path: _filled(_value(spread, u), islice(within, sizes[path]))
            for (path, spread), u in zip(over.items(), drawn, strict=False)
        }
        rest = indices[k] % points
        place: dict[str, Any] = {}
        for path, spread in reversed(on_grid.items()):
            rest, i = divmod(rest, _count(spread))
            place[path] = _point(spread, i)
        return drawn_values | {path: place[path] for path in on_grid}

    return values


def inner_spreads(value: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, dict[str, Any]]]:
    """The distributions inside a value of a choice, and where: mappings with one key, that of a distribution."""
    if isinstance(value, dict) and len(value) == 1 and value.keys() <= Distribution.model_fields.keys():
        yield path, value
        return
    for step, item in branches(value):
        yield from inner_spreads(item, (*path, step))


def _inner_count(spread: Distribution) -> int:
    """The most distributions inside one value of a choice."""
    return max((sum(1 for _ in inner_spreads(value)) for value in spread.choice or ()), default=0)


def _filled(value: Any, unit: Iterable[float]) -> Any:
    """A value of a choice, with each distribution inside it drawn at a number in [0, 1)."""
    for (path, spread), u in zip(inner_spreads(value), unit, strict=False):
        value = put(value, path, _value(Distribution.model_validate(spread), u))
    return value


def _unit_points(vary: Vary, d: int, indices: Sequence[int]) -> "np.ndarray":
    """Points of the unit cube (n, d), one for each scene."""
    import numpy as np
    from numpy.random import SeedSequence, default_rng

    design = vary.design
    if design == "random":
        return np.array([default_rng(SeedSequence((vary.seed, i, SAMPLING_STREAM))).random(d) for i in indices])
    if design == "lhs":  # each point depends on all others: draw them all
        return _latin_hypercube(vary.seed, vary.samples or 0, d)[list(indices)]
    from scipy.stats import qmc  # half a second to import

    rng = default_rng(SeedSequence((vary.seed, 0, SAMPLING_STREAM)))
    engine = qmc.Sobol(d, rng=rng) if design == "sobol" else qmc.Halton(d, rng=rng)
    return np.asarray(engine.random(1 << max(indices, default=0).bit_length())[list(indices)])


@lru_cache(maxsize=4)
def _latin_hypercube(seed: int, samples: int, d: int) -> "np.ndarray":
    """All points (samples, d). They are kept: optimising them takes a second, and a plan is expanded more than once."""
    import numpy as np
    from numpy.random import SeedSequence, default_rng
    from scipy.stats import qmc

    # so that columns hardly correlate; too slow for many
    optimised: Literal["random-cd"] | None = "random-cd" if samples <= MAX_LHS_SAMPLES else None
    rng = default_rng(SeedSequence((seed, 0, SAMPLING_STREAM)))
    return np.asarray(qmc.LatinHypercube(d, optimization=optimised, rng=rng).random(samples))


def correlated(vary: Vary) -> list[Issue]:
    """A warning if the first few points of a quasi-random sequence correlate two varied values."""
    import numpy as np

    n, paths = vary.samples or 0, list(vary.over)
    if vary.design not in ("sobol", "halton") or not 3 <= n <= MAX_LHS_SAMPLES or len(paths) < 2:
        return []
    dimensions = len(paths) + sum(map(_inner_count, vary.over.values()))
    r = np.triu(np.corrcoef(_unit_points(vary, dimensions, range(n))[:, : len(paths)].T), 1)
    i, j = np.unravel_index(np.abs(r).argmax(), r.shape)
    if abs(r[i, j]) < MAX_UNWARNED_CORRELATION:
        return []
    text = f"{n} points of {vary.design} correlate {paths[i]} and {paths[j]} by {r[i, j]:.2f}"
    return [Issue(("vary", "method"), f"{text}: leave method out, and so few are spread as a Latin hypercube")]


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
    count = _count(spread)
    return _point(spread, min(int(u * count), count - 1))


def _count(spread: Distribution) -> int:
    """How many values a choice or linspace has."""
    return len(spread.choice) if spread.choice is not None else spread.linspace[2] if spread.linspace else 0


def _point(spread: Distribution, i: int) -> Any:
    """The i-th value of a choice or linspace."""
    if spread.choice is not None:
        return spread.choice[i]
    assert spread.linspace is not None
    first, last, n = spread.linspace
    return first + (last - first) * i / max(n - 1, 1)
