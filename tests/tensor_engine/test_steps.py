"""What a step of the contact decides, and in how few launches a GPU does it."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

import warp as wp
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.physics.decisions import ContactStatus
from tacgen.physics.runtime import WARP_THREADS
from tacgen.tensor_engine import contact_newton as newton
from tacgen.tensor_engine import dense, reduction, replay
from tacgen.tensor_engine.contact_newton import Iterates, TriedStep
from tacgen.tensor_engine.replay import Replays
from tensor_engine.batches import batch, path, small, solve
from tensor_engine.dense import Dense
from tensor_engine.test_contact import Case

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
R = np.random.default_rng
# operations that launch nothing
VIEWS = {"view", "expand", "slice", "select", "unsqueeze", "squeeze", "transpose", "t", "permute", "_unsafe_view"}
VIEWS |= {"unbind", "alias", "detach", "empty", "empty_like", "new_empty", "split", "diagonal", "expand_as"}
# of work on scenes, with elimination by blocks: where scenes are few that is its time
LAUNCHES = {"contact": 72, "search": 64, "measure": 90, "load": 28}


def tensor(values: Any) -> torch.Tensor:
    return torch.tensor(np.array(values), device=DEVICE)


def same(found: torch.Tensor, wanted: torch.Tensor, relative: float = 1e-12) -> bool:
    """Whether two are equal but for rounding, and infinite at the same places."""
    finite = torch.isfinite(wanted)
    size = torch.where(finite, wanted, 0).abs().max().clamp(min=1e-9) if wanted.numel() else 1.0
    close = (torch.where(finite, found - wanted, 0).abs() <= relative * size).all()
    return found.dtype == wanted.dtype and bool(close & (found[~finite] == wanted[~finite]).all())


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_solutions_on_the_kept_unknowns_are_put_together(dtype: type) -> None:
    r, k, a, e = R(5), 30, 12, 19
    place = np.full((4, k), reduction.PADDING_PLACE)  # the last two are padding
    place[:, 3:13] = np.arange(10)
    lost = np.full((4, e), -1)
    lost[:, :18] = [0, 1, 2, *range(13, 28)]
    place[:, lost[0, :18]] = -1 - np.arange(18)
    kept = np.full((4, a), -1)
    kept[:, :10] = np.arange(3, 13)
    G, X, K = (tensor(r.normal(size=(6, *shape)).astype(dtype)) for shape in ((e, e), (e, a), (a, a)))
    K = K @ K.mT + 4 * torch.eye(a, dtype=K.dtype, device=DEVICE)
    K[:, 10:, :10] = K[:, :10, 10:] = 0.0
    X[4, 2, 3] = torch.inf
    used, slots = (tensor(np.full(6, 18)), tensor(np.full(6, 10))), tensor([3, 0, 5, 4])
    G[:, 18:] = G[:, :, 18:] = X[:, 18:] = X[:, :, 10:] = 0.0
    part = reduction.Reduction(*map(tensor, (kept, lost, place)), G, X, K, slots, used)
    b = tensor(r.normal(size=(4, k)))
    x, good = part.solve(K[slots], b, True)
    assert good.tolist() == [True, True, True, False]
    assert (x[:, 28:] == 0).all()
    assert (x[3] == 0).all()
    for row, slot in enumerate(slots.tolist()[:3]):
        lesser, inner = X[slot, :18, :10].double(), b[row, lost[0, :18]]
        own = torch.linalg.solve(K[slot, :10, :10].double(), b[row, 3:13] - lesser.T @ inner)
        rest = G[slot, :18, :18].double() @ inner - lesser @ own
        assert same(x[row, 3:13], own, 2e-5 if dtype is np.float32 else 1e-12)
        assert same(x[row, lost[0, :18]], rest, 2e-5 if dtype is np.float32 else 1e-12)
    limit, right = reduction.MAX_UNPIVOTED_RESIDUAL, b[..., None].to(G.dtype)
    product = right * (1 + 0.9 * limit)
    product[1, 4] += 2 * limit * right[1].abs().max()
    product[2, 5] = torch.nan
    assert reduction._exact(right, product).tolist() == [True, False, False, True]


@pytest.mark.parametrize("symmetric", [False, True])
def test_fractions_to_try_and_figures_of_steps(symmetric: bool) -> None:
    case, r = Case(), R(6)
    gap = case.many.evaluate(case.X).gap.to(DEVICE)
    parts = {name: getattr(case.many, name).to(DEVICE) for name in ("conn", "N", "areas")}
    contact, (s, m, _) = replace(case.many, **parts | {"conn": parts["conn"].int()}), case.X.shape
    start, gradient, g, p, bent = (tensor(r.normal(size=(s, m, 3))) for _ in range(5))
    p = p * tensor(10.0 ** -np.arange(s))[:, None, None]  # some steps are short enough to be whole
    whole = g * tensor(np.where(np.arange(s) % 2, 0.49, 0.51))[:, None, None]
    exists, reach = tensor(np.arange(s) != 3), tensor(np.linspace(0.1, 0.9, s))
    X, load = case.X.to(DEVICE), tensor(r.normal(size=(s, 3 * m)))
    trial = TriedStep(X, start, load, gradient, g, p, bent, None if symmetric else whole, exists)
    least = newton.MIN_LINE_SEARCH_FRACTION if symmetric else newton.MIN_COUPLED_FRACTION
    fractions, figures = newton.tried(trial, contact, gap, reach, least)
    alone = (
        replace(one.contact, shape=SimpleNamespace(reach=float(far))) for one, far in zip(case.one, reach, strict=True)
    )
    parts = zip(alone, gap.cpu().numpy(), p.cpu().numpy(), strict=True)
    first = tensor([one.max_step(space, step) for one, space, step in parts])
    assert same(fractions[:, 1], first)
    assert (fractions[:, 0] == 0).all()
    assert same(fractions[:, 2:] * 2, fractions[:, 1:-1])
    assert fractions[first == 1][:, -1].max() < 2 * least
    assert 0 < first.min() < first.max() == 1
    dots = (X - start, gradient + load.view_as(X)), (gradient, 2 * p), (p, 2 * bent)
    wanted = torch.stack([(one * other).sum((1, 2)) / 2 for one, other in dots], 1)
    assert same(figures[:, :3], wanted)
    assert same(figures[:, 3], torch.where(exists, (g * p).sum((1, 2)), torch.inf))
    assert torch.equal(figures[:, newton.LONGEST_COLUMN], p.abs().amax((1, 2)))
    full = exists & (first == 1) & tensor(np.arange(s) % 2 == 1)  # not 1, too long, nor 3
    assert figures[:, newton.FULL_STEP_COLUMN].tolist() == (0.0 * full if symmetric else full.double()).tolist()
    assert 2 <= full.sum() < s - 1


def test_the_first_fraction_that_is_low_enough() -> None:
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
        found = newton.downhill(fractions, figures, merits, least)
        assert found.tolist() == [1.0, 0.25, third, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("symmetric", [False, True])
def test_ends_of_steps(symmetric: bool) -> None:
    """Of scenes that move as they like, nowhere, out of the radius, hardly, not at all, and after too many steps."""
    case, m, most = Case(), 5, 10
    s, r = 6, R(7)
    contact = replace(case.many, offset=tensor(np.full(s, 0.01)), dhat=tensor(np.full(s, 0.05)))
    x, radius, xtol = tensor(r.normal(size=(s, m, 3))), tensor(np.full(s, 1.0)), tensor(np.full(s, 1e-3))
    fraction = tensor([0.5, 1.0, 1.0, 1e-12, 0.0, 1.0])
    step = tensor(np.full((s, m, 3), 0.1))
    step[1], step[2, 0, 0], step[3] = 1e-4, -3.0, 0.1
    figures = torch.zeros(s, 6, dtype=x.dtype, device=DEVICE)
    figures[:, newton.LONGEST_COLUMN] = step.abs().amax((1, 2))
    N, gaps = tensor(r.uniform(0.1, 1, (s, 5, 4))), tensor(np.full((s, 5, 4), 0.012))
    N[[1, 5]] = 0.0  # do not touch
    felt = replace(case.many.evaluate(case.X), N=N, gap=gaps)
    length, drift, gap = (tensor(np.full(s, value)) for value in (0.01, 0.5, 0.012))
    counts = tensor([3, 3, 3, 3, 3, most])
    now = Iterates(x, contact, counts, length, drift, gap, counts * 0)
    ahead, drifted = newton.shrunk(now)
    assert ahead.offset.tolist() == [0.012] * s
    assert drifted.tolist() == pytest.approx([0.002] * s)
    for other in (replace(now, length=length + 1.0), replace(now, gap=gap + torch.nan)):  # far, and without contact
        still, away = newton.shrunk(other)
        assert (still.offset.tolist(), away.tolist()) == ([0.01] * s, [0.5] * s)
    assert newton.shrunk(replace(now, gap=-gap))[0].offset.tolist() == [-0.012] * s
    drifted = tensor(np.full(s, 5e-4))
    there = x + fraction[:, None, None] * step
    found = newton.ended(now, ahead, drifted, x, there, fraction, figures, felt, xtol, radius, most, symmetric)
    stuck = ContactStatus.unstable if symmetric else ContactStatus.searching
    ends = ContactStatus.running, ContactStatus.converged, ContactStatus.unstable, ContactStatus.stopped
    assert found.status.tolist() == [*ends, stuck, ContactStatus.circling]
    assert found.steps.tolist() == [4, 4, 4, 4, 4 if symmetric else 3, most]
    assert torch.equal(found.x[[0, 1, 3]], there[[0, 1, 3]])
    assert torch.equal(found.x[4:], x[4:])  # the last has no more steps
    assert same(found.x[2], x[2] + step[2] / 3)  # to the radius
    assert found.length.tolist() == pytest.approx([0.1, 1e-4, 0.01, 0.1, 0.01, 0.01])
    assert found.gap.tolist() == pytest.approx([0.012, np.nan, 0.012, 0.012, 0.012, np.nan], nan_ok=True)
    kept = [5e-4] * 4 + [5e-4 if symmetric else 0.5, 5e-4]
    assert found.drift.tolist() == pytest.approx(kept)
    assert found.contact.offset.tolist() == [0.012] * 4 + [0.012 if symmetric else 0.01, 0.012]


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


@pytest.mark.skipif(DEVICE == "cuda", reason="small batches are on the CPU")
def test_a_scene_solved_by_kernels_in_few_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one that takes parts of coupled steps and of a symmetric one."""
    scenes, launches, counts, keys = [small(SphereSdf(1.5), path((0.2, 0.1, -0.35)), friction=0.5)], Launches(), {}, []
    (wanted,) = solve(batch(scenes), scenes)
    for owner, name in (*((Dense, each) for each in ("factor", "schur", "forward", "expand")),
                        (wp, "launch")):  # fmt: skip
        launches.as_one(owner, name, monkeypatch)
    noting, called, launched = replay._noting, Replays._called, dense.launch

    def eliminated(*args: Any) -> None:
        launched(*args)
        launches.count["launch"] -= args[-2] % WARP_THREADS != 0  # rows that a GPU eliminates with those before

    monkeypatch.setattr(dense, "launch", eliminated)

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
        assert 0 < counts[work] <= most, (work, counts)
