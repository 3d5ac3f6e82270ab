"""A step of the contact by kernels is that by plain operations; without a GPU under Triton's interpreter."""

import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when the kernels are defined
needs("triton")

from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.tensor_engine import condensation, load_step, reduction, replay
from tacgen.tensor_engine import contact_newton as newton
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.contact_newton import Iterates, TriedStep
from tacgen.tensor_engine.replay import Replays
from tensor_engine.batches import batch, path, small, solve
from tensor_engine.compiling import interpreted_and_compiled
from tensor_engine.dense import Dense
from tensor_engine.test_contact import Case

pytestmark = pytest.mark.slow  # the interpreter takes seconds
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
R = np.random.default_rng
alone = pytest.mark.skipif(DEVICE == "cuda", reason="small batches are on the CPU")
# operations that launch nothing
VIEWS = {"view", "expand", "slice", "select", "unsqueeze", "squeeze", "transpose", "t", "permute", "_unsafe_view"}
VIEWS |= {"unbind", "alias", "detach", "empty", "empty_like", "new_empty", "split", "diagonal", "expand_as"}
# of work on scenes, with kernels where there were hundreds: where scenes are few that is its time
LAUNCHES = {"contact": 57, "search": 59, "measure": 64, "load": 23}


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with interpreted_and_compiled(monkeypatch):
        yield


def tensor(values: Any) -> torch.Tensor:
    return torch.tensor(np.array(values), device=DEVICE)


def both(function: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any]:
    """What a function returns by kernels, and by plain operations."""
    found = []
    for by_kernels in (True, False):
        monkeypatch.setattr(devices, "by_kernels", lambda x, now=by_kernels: now)
        found.append(function())
    return found[0], found[1]


def same(found: torch.Tensor, wanted: torch.Tensor, relative: float = 1e-12) -> bool:
    """Whether two are equal but for rounding, and infinite at the same places."""
    finite = torch.isfinite(wanted)
    size = torch.where(finite, wanted, 0).abs().max().clamp(min=1e-9) if wanted.numel() else 1.0
    close = (torch.where(finite, found - wanted, 0).abs() <= relative * size).all()
    return found.dtype == wanted.dtype and bool(close & (found[~finite] == wanted[~finite]).all())


def test_solutions_on_the_kept_unknowns_are_put_together(monkeypatch: pytest.MonkeyPatch) -> None:
    r, k, a, e = R(5), 30, 12, 19
    place = np.full((4, k), reduction.PADDING_PLACE)  # the last two are padding
    place[:, 3:13] = np.arange(10)
    lost = np.full((4, e), -1)
    lost[:, :18] = [0, 1, 2, *range(13, 28)]
    place[:, lost[0, :18]] = -1 - np.arange(18)
    kept = np.full((4, a), -1)
    kept[:, :10] = np.arange(3, 13)
    G, X, K = (tensor(r.normal(size=(6, *shape)).astype(np.float32)) for shape in ((e, e), (e, a), (a, a)))
    K = K @ K.mT + 4 * torch.eye(a, device=DEVICE)
    X[4, 2, 3] = torch.inf
    used = tensor(np.full(6, 18)), tensor(np.full(6, 10))
    G[:, 18:] = G[:, :, 18:] = X[:, 18:] = X[:, :, 10:] = 0.0
    part = reduction.Reduction(*map(tensor, (kept, lost, place)), G, X, K, tensor([3, 0, 5, 4]), used)
    b = tensor(r.normal(size=(4, k)))
    (x, good), (wanted, fine) = both(lambda: part.solve(K[part.slots], b, True), monkeypatch)
    assert same(x, wanted, 1e-6)
    assert good.tolist() == fine.tolist() == [True, True, True, False]
    assert (x[0, :28] != 0).all()
    assert (x[:, 28:] == 0).all()
    right, product = b[..., None].float(), b[..., None].float() * (1 + 0.9 * reduction.MAX_UNPIVOTED_RESIDUAL)
    product[1, 4] += 2 * reduction.MAX_UNPIVOTED_RESIDUAL * right[1].abs().max()
    product[2, 5] = torch.nan
    one, other = both(lambda: reduction._exact(right, product), monkeypatch)
    assert one.tolist() == other.tolist() == [True, False, False, True]


@pytest.mark.parametrize("symmetric", [False, True])
def test_fractions_to_try_and_figures_of_steps(symmetric: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    case, r = Case(), R(6)
    gap = case.many.evaluate(case.X).gap.to(DEVICE)
    parts = {name: getattr(case.many, name).to(DEVICE) for name in ("conn", "N", "areas")}
    contact, (s, m, _) = replace(case.many, **parts), case.X.shape
    start, gradient, g, p, bent = (tensor(r.normal(size=(s, m, 3))) for _ in range(5))
    p = p * tensor(10.0 ** -np.arange(s))[:, None, None]  # some steps are short enough to be whole
    whole = g * tensor(np.where(np.arange(s) % 2, 0.49, 0.51))[:, None, None]
    exists, reach = tensor(np.arange(s) != 3), tensor(np.linspace(0.1, 0.9, s))
    trial = TriedStep(case.X.to(DEVICE), start, tensor(r.normal(size=(s, 3 * m))), gradient, g, p, bent,
                  None if symmetric else whole, exists)  # fmt: skip
    least = newton.MIN_LINE_SEARCH_FRACTION if symmetric else newton.MIN_COUPLED_FRACTION
    found, wanted = both(lambda: newton.tried(trial, contact, gap, reach, least), monkeypatch)
    for one, other in zip(found, wanted, strict=True):
        assert same(one, other)
    assert 0 < wanted[0][:, 1].min() < wanted[0][:, 1].max() == 1
    assert wanted[1][:, newton.FULL_STEP_COLUMN].sum() == (0 if symmetric else 2)  # not 1, too long, nor 3


def test_the_first_fraction_that_is_low_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    fractions = tensor([[0.0, 1.0, 0.5, 0.25, 0.125]]).double().repeat(7, 1)
    figures = tensor([[1.0, 2.0, 0.5, -1.0, 0.3, 0.0]]).repeat(7, 1)
    figures[4, 3], figures[5, 3], figures[6, 5] = 0.1, torch.inf, 1.0
    merits = -2 * fractions - 0.25 * fractions**2  # so that the whole energy is the same everywhere
    merits += tensor(np.where(np.arange(7)[:, None] == 3, 1e-3, 0.0))
    merits[0, 1:] -= 0.5
    merits[1, 3:] -= 0.5
    merits[2, 4] -= 0.5
    merits[3, 1:] += 1.0
    merits[4, 1:] -= 0.5
    merits[5, 1:] -= 0.5
    for least, third in ((0.1, 0.125), (0.2, 0.0)):
        found, wanted = both(partial(newton.downhill, fractions, figures, merits, least), monkeypatch)
        assert found.tolist() == wanted.tolist() == [1.0, 0.25, third, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("symmetric", [False, True])
def test_ends_of_steps(symmetric: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    case, r, s, m = Case(), R(7), 64, 30
    some = tensor(np.arange(s) % len(case.X))
    contact = replace(case.many, **{name: getattr(case.many, name).to(DEVICE)[some] for name in ("dhat", "offset")})
    x, start = (tensor(r.normal(size=(s, m, 3))) for _ in range(2))
    start = x + 0.1 * start
    longest = 10.0 ** tensor(r.integers(-12, 0, s)).double()
    step = tensor(r.uniform(-1, 1, (s, m, 3))) * longest[:, None, None]
    fraction = tensor(r.choice([0.0, 1e-8, 0.5, 1.0], s, p=[0.2, 0.1, 0.2, 0.5]))
    figures = torch.stack([longest] * 6, 1)
    N = tensor(r.uniform(0, 1, (s, 5, 4))) * tensor(r.integers(0, 2, s)).double()[:, None, None]
    felt = replace(case.many.evaluate(case.X), N=N, gap=tensor(r.uniform(0, 0.04, (s, 5, 4))))
    numbers = [tensor(r.uniform(-0.01, 0.1, s)) for _ in range(5)]
    now = Iterates(x, contact.shrunk(numbers[0]), tensor(r.integers(0, 12, s)), *numbers[1:4], tensor(np.zeros(s, int)))
    xtol, radius = tensor(r.choice([1e-4, 1e-1], s)), tensor(r.choice([0.25, 9.0], s))

    def after() -> Iterates:
        contact, drift = newton.shrunk(now)
        there = x + fraction[:, None, None] * step
        return newton.ended(now, contact, drift, start, there, fraction, figures, felt, xtol, radius, 10, symmetric)

    found, wanted = both(after, monkeypatch)
    for name in ("x", "steps", "length", "drift", "gap", "status"):
        assert same(getattr(found, name), getattr(wanted, name)), name
    assert same(found.contact.offset, wanted.contact.offset)
    searching = set() if symmetric else {newton.SEARCHING}
    ends = {newton.RUNNING, newton.CONVERGED, newton.STOPPED, newton.UNSTABLE}
    assert set(wanted.status.tolist()) == ends | searching


class Launches(TorchDispatchMode):
    """Counts operations that launch something."""

    def __init__(self) -> None:
        super().__init__()
        self.count: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        name = func.overloadpacket.__name__
        self.count.update([name] if name not in VIEWS else [])
        return func(*args, **(kwargs or {}))

    def as_one(self, owner: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
        """Count a function as one launch."""
        function = getattr(owner, name)

        def one(*args: Any, **kwargs: Any) -> Any:
            self.count[name] += 1
            with _disable_current_modes():
                return function(*args, **kwargs)

        monkeypatch.setattr(owner, name, one)


@alone
def test_a_scene_solved_by_kernels_in_few_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    import triton.runtime.interpreter

    """Of one that takes parts of coupled steps and of a symmetric one."""
    scenes, launches, counts, keys = [small(SphereSdf(1.5), path((0.2, 0.1, -0.35)), friction=0.5)], Launches(), {}, []
    (wanted,) = solve(batch(scenes), scenes)
    monkeypatch.setattr(devices, "by_kernels", lambda x: True)
    for owner, name in (*((Dense, each) for each in ("factor", "schur", "forward", "expand")),
                        (triton.runtime.interpreter.GridExecutor, "__call__")):  # fmt: skip
        launches.as_one(owner, name, monkeypatch)
    noting, called = replay._noting, Replays._called

    @contextmanager
    def counted(roomy: bool) -> Iterator[Any]:
        launches.count.clear()
        with noting(roomy) as notes, launches:
            yield notes
        if keys[-1][0] != "contact" or not keys[-1][-1]:  # symmetric
            counts[keys[-1][0]] = launches.count.total()

    def kept(self: Replays, key: tuple, *others: Any) -> Any:
        keys.append(key)
        return called(self, key, *others)

    monkeypatch.setattr(replay, "_noting", counted)
    monkeypatch.setattr(Replays, "_called", kept)
    b = batch(scenes)
    b.replays = Replays(torch.device("cpu"), on=True)
    (found,) = solve(b, scenes)
    assert found.why is None
    assert np.abs(found.states[0].x - wanted.states[0].x).max() < 1e-9
    for work, most in LAUNCHES.items():
        assert 0 < counts[work] <= most, (work, counts[work])
