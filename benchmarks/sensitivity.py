"""Sensitivity of the force to tiny changes of the inputs."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.cases import CASES, PLAIN, Sets
from benchmarks.reference_runs import row_of
from benchmarks.results_page import Cell, Level, Say, Table, columns, cores
from tacgen import mechanics
from tacgen.fem.materials import NeoHooke
from tacgen.fem.potential import Projection, Total
from tacgen.geometry.pose import Pose
from tacgen.mechanics import mesh
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.linear_solvers import NotPositiveDefinite, SuperLU
from tacgen.recipe import scene_of_row

Array = np.ndarray
CASE_NAMES = ("", "nu 0.4999", "1 kPa", "100 MPa", "friction 2", "half deep", "skin stiffer 1000:1")
RELATIVE_NUDGE = 1e-10  # relative change of an input [-]


def table(level: Level, say: Say) -> Table:
    """Condition number of the stiffness, and the effect of each change."""
    names = CASE_NAMES[:1] if level == "smoke" else CASE_NAMES
    with cores(level) as every:
        return _table(names, every(nudged, names), say)


def _solved(sets: Sets, nudge: str = "") -> tuple[mechanics.Problem, mechanics.State]:
    """The last frame of the case, with one input slightly larger."""
    made = scene_of_row.build(row_of((*PLAIN, *sets)))
    if nudge == "depth":
        poses = made.poses.copy()
        poses[:, 2, 3] *= 1 + RELATIVE_NUDGE
        made = replace(made, poses=poses)
    if nudge == "friction":
        made = replace(made, friction=made.friction * (1 + RELATIVE_NUDGE))
    if nudge == "modulus":
        laws = [(layer, layer.law) for layer in made.gel.layers if isinstance(layer.law, NeoHooke)]
        layers = [replace(layer, law=replace(law, mu=law.mu * (1 + RELATIVE_NUDGE))) for layer, law in laws]
        made = replace(made, gel=replace(made.gel, layers=tuple(layers)))
    problem = mechanics.Problem.of(made, mesh.of(made))
    *_, state = mechanics.states(made, problem)
    return problem, state


def nudged(name: str) -> tuple[float, list[float]]:
    """Condition number of a case, and the relative change of its force for each changed input."""
    sets = CASES[name] if name else ()
    problem, state = _solved(sets)
    force, moved = state.traction_force.sum((0, 1)), []
    for nudge in ("depth", "modulus", "friction"):
        other = _solved(sets, nudge)[1].traction_force.sum((0, 1))
        moved.append(float(np.linalg.norm(other - force) / np.linalg.norm(force)))
    return condition(problem, state), moved


def _table(names: tuple[str, ...], found: Iterator[tuple[float, list[float]]], say: Say) -> Table:
    rows: list[list[Cell]] = []
    for name, (number, moved) in zip(names, found, strict=True):
        rows.append([name or "plain", number, *moved])
        say(f"{name or 'plain'}: condition {number:.1e}, moved by {max(moved):.1e}")
    heads = columns("case", "condition: .1e", "depth: .0e", "shear modulus: .0e", "friction: .0e")
    note = (
        "Condition: largest over smallest eigenvalue of the stiffness in the last frame. Other columns: relative"
        f" change of the last frame's force when this input is increased by {RELATIVE_NUDGE:g} of itself. Within"
        " Newton's tolerance it can be up to 1e-3, if the iterations take another path."
    )
    return Table("Condition, and what a nudge does", heads, rows, note)


def condition(problem: mechanics.Problem, state: mechanics.State) -> float:
    """Condition number of the stiffness at a state."""
    import scipy.sparse as sp
    from scipy.sparse.linalg import LinearOperator, eigsh

    contact = problem.contact.moved(Pose.of(state.pose), state.offset)
    data, pat = np.zeros(len(problem.pattern.indices)), problem.pattern
    Total((*problem.elastic, *problem.folding)).add_hessian(state.x, data, Projection.NONE)
    D = CoupledContact(contact, 0.0, contact.faces.at(state.x), 1.0).evaluate(state.x).tangent
    contact.faces.add_blocks(np.arange(len(D)), D, data)
    upper = sp.csr_matrix((data, pat.indices, pat.indptr), shape=(pat.size, pat.size))
    whole = upper + sp.triu(upper, 1).T
    direct = SuperLU(pat)
    try:
        direct.factor(data)
    except NotPositiveDefinite:
        return float("inf")
    inverse = LinearOperator((pat.size, pat.size), direct.solve, dtype=float)
    start = np.ones(pat.size)
    most = eigsh(whole, 1, which="LA", tol=1e-2, v0=start, return_eigenvectors=False)[0]
    least = eigsh(whole, 1, sigma=0, OPinv=inverse, which="LM", tol=1e-2, v0=start, return_eigenvectors=False)[0]
    return float(most / least)
