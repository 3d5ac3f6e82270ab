"""The batch engine's linear algebra on the device there is, beside a core's.

    python -m benchmarks.tensor_engine [--draws 0 60] [--batch 1 64 256] [--patterns 1] [--seconds 120]

Prints how many patterns the ordinary scenes of benchmarks/draws.py share, with the unknowns that sharing adds. Then,
for the most common patterns of each sensor, how many a second of these it does with a batch: assemblies, factors with
Schur complements on the patch, the same condensed to each scene's own nodes, substitutions there and back, systems of
contact. Beside it CHOLMOD on one core with the scene's own mesh. The matrix is the gel's tangent at rest; residuals are
those of a solution, and after each of two refinements, over the right-hand side.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from benchmarks.draws import Draw, drawn
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.fem.assembly import Pattern
from tacgen.mechanics import linear_solvers, mesh
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.condensation import Condensation
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row
from tacgen.tensor_engine import dissection, grids
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.dissection import Dissection, dissected
from tacgen.tensor_engine.multifrontal import Multifrontal
from tacgen.tensor_engine.reduction import reduced

Array = np.ndarray
REPEATS = 5  # most repetitions of a measurement, of which the fastest counts


def main() -> None:
    told = arguments()
    end = time.perf_counter() + told.seconds
    device = told.device or ("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(told.threads)
    name = torch.cuda.get_device_name() if device == "cuda" else f"CPU, {told.threads} threads"
    say(f"{name}; PyTorch {torch.__version__}; {told.dtype}")
    for sensor, found in sorted(shared(range(told.draws[0], sum(told.draws))).items()):
        for pattern, scenes in found[: told.patterns]:
            say(f"\n{sensor}, pattern {pattern.cells}, of {len(scenes)} draws")
            matrix = Matrix.of(scenes[0])
            core(matrix, told.contact, end)
            tree = dissected(pattern, told.leaf, told.quartered, told.groups)
            describe(tree)
            solver = Multifrontal(tree, device, getattr(torch, told.dtype))
            for batch in told.batch:
                if time.perf_counter() > end:
                    say("out of time")
                    return
                try:
                    batched(solver, matrix, batch, told.contact, end)
                    if told.profile:
                        profiled(solver, matrix, batch)
                except torch.cuda.OutOfMemoryError:
                    say(f"  batch {batch}: out of memory")
                if device == "cuda":
                    torch.cuda.empty_cache()


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, nargs=2, default=(0, 60), metavar=("FIRST", "COUNT"))
    parser.add_argument("--batch", type=int, nargs="+", default=(1, 64, 256))
    parser.add_argument("--patterns", type=int, default=1, help="of each sensor, the most common first")
    parser.add_argument("--contact", type=int, default=100, help="nodes to condense to")
    parser.add_argument("--seconds", type=float, default=120.0, help="no measurement begins later")
    parser.add_argument("--leaf", type=int, default=dissection.LEAF, help="see dissection.LEAF")
    parser.add_argument("--quartered", type=int, default=dissection.QUARTERED, help="see dissection.QUARTERED")
    parser.add_argument("--groups", type=int, default=dissection.MOST_GROUPS, help="batches of a level")
    parser.add_argument("--profile", action="store_true", help="which operations take the time of a factorisation")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="a GPU if there is one")
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch on the CPU")
    return parser.parse_args()


def say(text: str) -> None:
    print(text, flush=True)


def scene_of(draw: Draw, quality: str = "draft", sets: Sequence[str] = ()) -> Scene:
    """The scene of a draw."""
    about = "outputs=[force]", f"sensor={draw.sensor}", f"quality={quality}"
    return scene_of_row.build(row_of((*about, *draw.sets, *sets)))


def shared(draws: Sequence[int]) -> dict[str, list[tuple[grids.GridPattern, list[Scene]]]]:
    """The patterns of these draws by sensor, the most common first, with their scenes; prints them."""
    found: dict[str, list[tuple[Scene, grids.Embedded | None]]] = defaultdict(list)
    for index in draws:
        scene = scene_of(drawn(index))
        found[drawn(index).sensor].append((scene, grids.embedded(scene)))
    out = {}
    for sensor, pairs in sorted(found.items()):
        inside = [(scene, grid) for scene, grid in pairs if grid is not None]
        by_pattern: dict[grids.GridPattern, list[Scene]] = defaultdict(list)
        for scene, grid in inside:
            by_pattern[grid.pattern].append(scene)
        own = sum(int(grid.pattern.free[grid.nodes].sum()) for _, grid in inside)
        all_of_them = sum(int(grid.pattern.free.sum()) for _, grid in inside)
        ranked = sorted(by_pattern.items(), key=lambda item: -len(item[1]))
        say(
            f"{sensor}: {len(pairs)} draws, {len(pairs) - len(inside)} in no pattern, {len(ranked)} patterns"
            f" ({', '.join(str(len(scenes)) for _, scenes in ranked)}); {3 * own / len(inside):.0f} unknowns of the"
            f" meshes, {100 * (all_of_them / own - 1):.0f} % more with the void ones"
        )
        out[sensor] = ranked
    return out


@dataclass(frozen=True)
class Matrix:
    """A tangent on its own mesh and embedded in its pattern: element tangents (e, 24, 24)."""

    grid: grids.Embedded
    problem: mechanics.Problem
    data: Array
    elements: Array

    @classmethod
    def of(cls, scene: Scene) -> "Matrix":
        """At rest."""
        grid, problem = grids.embedded(scene), mechanics.Problem.of(scene, mesh.of(scene))
        assert grid is not None
        data = Bulk(problem.elastic, problem.folding, ()).at(problem.mesh.points).stiffness(problem.pattern)
        return cls(grid, problem, data, elements_of(grid, problem.pattern, data))

    def contact(self, count: int) -> Array:
        """So many nodes (m,) of the pattern in the middle of the patch that the mesh has."""
        patch = self.grid.pattern.patch
        patch = patch[self.grid.used[patch]]
        at = self.grid.points[patch, :2]
        return np.sort(patch[np.argsort(np.linalg.norm(at - np.median(at, axis=0), axis=1), kind="stable")[:count]])


def elements_of(grid: grids.Embedded, pattern: Pattern, data: Array) -> Array:
    """Element tangents (e, 24, 24) whose sum is the matrix of `data`, the entries of the mesh's pattern: each block of
    two nodes is given wholly to the first element that has both."""
    n = pattern.nodes
    i, j, slots = pattern.pairs // n, pattern.pairs % n, pattern.blocks
    upper = np.where(slots >= 0, data[slots], 0.0)
    turned = upper[np.searchsorted(pattern.pairs, j * n + i)].transpose(0, 2, 1)
    both = np.where((slots >= 0) & (i == j)[:, None, None], 0.0, turned) + upper
    hexes = grid.pattern.hexes
    row, column = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
    keys, first = np.unique(row * grid.pattern.size + column, return_index=True)
    out = np.zeros((row.size, 3, 3))
    out[first[np.searchsorted(keys, grid.nodes[i] * grid.pattern.size + grid.nodes[j])]] = both
    return out.reshape(len(hexes), 8, 8, 3, 3).transpose(0, 1, 3, 2, 4).reshape(len(hexes), 24, 24)


def describe(tree: Dissection) -> None:
    """Prints the size of a pattern's tree."""
    names = "flops", "entries", "filled"
    flops, entries, filled = (sum(getattr(group, name) for group in tree.groups) for name in names)
    fronts = ", ".join(f"{len(v.own)} of {3 * v.own.shape[1]} + {3 * v.bound.shape[1]}" for v in tree.groups)
    say(
        f"  {3 * int(tree.pattern.free.sum())} unknowns, {3 * len(tree.patch)} of the patch; {flops / 1e9:.2f} GFLOP,"
        f" {entries / 1e6:.1f} M numbers, {100 * filled / entries:.0f} % without padding; fronts: {fronts}"
    )


def core(matrix: Matrix, count: int, end: float) -> None:
    """CHOLMOD on one core, on the mesh without void nodes."""
    problem, pattern = matrix.problem, matrix.problem.pattern
    if "cholmod" not in linear_solvers.available() or time.perf_counter() > end:
        say("  CHOLMOD on a core: not measured")
        return
    whole, condensed = linear_solvers.Cholmod(pattern), Condensation(pattern, lambda: matrix.data)
    numbers = np.full(matrix.grid.pattern.size, -1)
    numbers[matrix.grid.nodes] = np.arange(len(matrix.grid.nodes))
    near = np.isin(problem.mesh.facets["coated"], numbers[matrix.contact(count)]).all(1)
    condensed.cover(problem.mesh.facets["coated"][near])
    b = np.ones(pattern.size)
    each = {
        "factor": lambda: whole.factor(matrix.data),
        "solve": lambda: whole.solve(b),
        f"factor with Schur complement on {condensed.size} unknowns": lambda: condensed.factor(matrix.data),
    }
    said = ", ".join(f"{name} {1 / fastest(job, 'cpu', end):.0f}/s" for name, job in each.items())
    say(f"  CHOLMOD on a core, {pattern.size} unknowns: {said}")


def batched(solver: Multifrontal, matrix: Matrix, batch: int, count: int, end: float) -> None:
    """Rates with a batch of this size, whose matrices differ by a factor."""
    device, dtype = solver.device, solver.dtype
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
    scale = torch.linspace(1, 1.1, batch, dtype=dtype, device=device)
    elements = torch.as_tensor(matrix.elements, dtype=dtype, device=device) * scale[:, None, None, None]
    nodes = torch.as_tensor(matrix.contact(count), device=device).expand(batch, -1)
    slots, kept = torch.arange(batch, device=device), Condensed(solver, batch)
    kept.reserve(nodes.shape[1])
    data = solver.assembled(elements)
    flops = sum(group.flops for group in solver.tree.groups)
    rates = Rates(batch, device.type, end)
    rates.of("assembled", lambda: solver.assembled(elements))
    panels = solver.empty(batch)
    seconds = rates.of("factor with S of the patch", lambda: solver.factor(data, panels, slots))
    rates.of("all, condensed and kept", lambda: kept.factor(slots, elements, nodes, count))
    g = torch.ones((batch, solver.nodes, 3), dtype=dtype, device=device)
    y, load = kept.forward(slots, g, nodes.shape[1])
    rates.of("forward", lambda: kept.forward(slots, g, nodes.shape[1]))
    rates.of("back", lambda: kept.expand(slots, load, y))
    S = kept.schur(elements, nodes, count)[1]
    half = S.shape[1] // 2
    active = torch.arange(S.shape[1], device=device).expand(batch, -1) < half
    parts = S, active, torch.ones_like(active), half, S.shape[1] - half
    contact = reduced(*parts)[0]
    rates.of("contact reduced to half", lambda: reduced(*parts))
    rates.of(f"coupled step of {half}", lambda: contact.solve(contact.K, load, False))
    rates.of("symmetric", lambda: contact.solve(contact.K, load, True))
    memory = f", {torch.cuda.max_memory_allocated() / 1e9:.1f} GB" if device.type == "cuda" else ""
    said = ", ".join(f"{each:.0e}" for each in residuals(kept, S, elements, slots, g, matrix))
    say(f"  batch {batch}: {rates}; {batch * flops / seconds / 1e12:.2f} TFLOP/s; residuals {said}{memory}")


def residuals(
    kept: Condensed, S: Tensor, elements: Tensor, slots: Tensor, g: Tensor, matrix: Matrix
) -> Iterator[float]:
    """Of K x = g, over |g|, and after each of two refinements."""
    L, right = torch.linalg.cholesky(S), g.double()
    free = torch.as_tensor(kept.solver.tree.pattern.free & matrix.grid.used, device=g.device)
    times = partial(product, elements.double(), torch.as_tensor(matrix.grid.pattern.hexes, device=g.device))

    def solve(b: Tensor) -> Tensor:
        y, load = kept.forward(slots, b, S.shape[1] // 3)
        return -kept.expand(slots, -torch.cholesky_solve(load[:, :, None], L).squeeze(-1), y)

    for rounds in range(3):
        x = refined(solve, times, right, rounds)
        yield float(((times(x) - right)[:, free].norm() / right[:, free].norm()).cpu())


def product(elements: Tensor, hexes: Tensor, x: Tensor) -> Tensor:
    """The sums of element tangents (B, e, 24, 24) of hexes (e, 8) times x (B, n, 3)."""
    parts = elements @ x[:, hexes].flatten(2)[..., None]
    return torch.zeros_like(x).index_add_(1, hexes.flatten(), parts.reshape(len(x), -1, 3))


def refined(solve: Callable[[Tensor], Tensor], times: Callable[[Tensor], Tensor], b: Tensor, rounds: int) -> Tensor:
    """x with K x = b by iterative refinement (Wilkinson 1963): `solve` is approximate, `times` gives K x in the
    precision of b (B, n, 3), in which x is returned."""
    x = solve(b).to(b.dtype)
    for _ in range(rounds):
        x = x + solve(b - times(x)).to(b.dtype)
    return x


def profiled(solver: Multifrontal, matrix: Matrix, batch: int) -> None:
    """Prints the operations of one factorisation that take most time."""
    elements = torch.as_tensor(matrix.elements, dtype=solver.dtype, device=solver.device)
    data = solver.assembled(elements.expand(batch, -1, -1, -1))
    panels, slots = solver.empty(batch), torch.arange(batch, device=solver.device)
    with torch.profiler.profile() as found:
        solver.factor(data, panels, slots)
    key = "self_device_time_total" if solver.device.type == "cuda" else "self_cpu_time_total"
    say(found.key_averages().table(sort_by=key, row_limit=12, max_name_column_width=40))


class Rates:
    """Rates of jobs on a batch, one after the other, as text."""

    def __init__(self, batch: int, device: str, end: float) -> None:
        self._batch, self._measure, self._said = batch, partial(fastest, device=device, end=end), list[str]()

    def of(self, name: str, job: Callable[[], object]) -> float:
        """Seconds of a job."""
        seconds = self._measure(job)
        self._said.append(f"{name} {self._batch / seconds:.0f}/s")
        return seconds

    def __str__(self) -> str:
        return ", ".join(self._said)


def fastest(job: Callable[[], object], device: str, end: float) -> float:
    """Seconds of the fastest of some runs after a first one, which compiles."""
    times: list[float] = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        job()
        if device == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
        if time.perf_counter() > end:
            break
    return min(times[1:] or times)


if __name__ == "__main__":
    main()
