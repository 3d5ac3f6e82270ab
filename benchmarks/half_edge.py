"""Forces of ordinary scenes before any fold against those on a mesh of half the edge, beside the error that is told."""

from collections.abc import Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from benchmarks.draws import Draw
from benchmarks.reference_runs import forces_of, row_of, solve_frames
from benchmarks.results_page import Cell, Table, columns
from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.expected_error import ERROR_ESTIMATE_FACTOR, frame_error
from tacgen.recipe import scene_of_row

EDGE_MM, DHAT_MM, LIMIT_S = 0.6, 0.05, 240.0  # of `draft`; longest processor time of a scene on the finer mesh [s]


class Compared(NamedTuple):
    """Error of the largest force before a fold on both meshes, and the error that is told [-]; nan if there is none."""

    shape: str
    error: float
    told: float


def compared(draw: Draw) -> Compared:
    """One scene on both meshes; a bench goes on where it is refused."""
    found = list[mechanics.State]()
    try:
        for half in (1, 2):
            quality = f"quality={{edge_mm: {EDGE_MM / half}, dhat_mm: {DHAT_MM / half}}}"
            row = row_of(("outputs=[force]", f"sensor={draw.sensor}", *draw.sets, quality))
            made = presolve.presolved(scene_of_row.build(row))
            states = solve_frames(made, mechanics.Problem.of(made, mesh.of(made)), LIMIT_S).states
            unique = list(takewhile(lambda state: state.unique, states))[: len(found) or None]
            if not unique:
                return Compared(draw.shape, np.nan, np.nan)
            if half == 1:
                found, scene = unique, made
    except UserError:
        return Compared(draw.shape, np.nan, np.nan)
    force, finer = forces_of(found), forces_of(unique)
    k = int(np.linalg.norm(finer, axis=1).argmax())
    told = frame_error(scene.gel, scene.shape, scene.poses[k], scene.edge)
    return Compared(draw.shape, float(np.linalg.norm(force[k] - finer[k]) / np.linalg.norm(finer[k])), told)


def table(found: Sequence[Compared]) -> Table:
    """By shape."""
    known = [one for one in found if np.isfinite(one.error)]
    rows: list[list[Cell]] = []
    for name in ["all", *sorted({one.shape for one in known})]:
        some = [one for one in known if name in (one.shape, "all")]
        error, told = (np.array([getattr(one, what) for one in some]) for what in ("error", "told"))
        within = [float(np.mean(error <= times * told)) for times in (1, ERROR_ESTIMATE_FACTOR)]
        rows.append([name, len(some), float(np.median(error)), float(error.max()), float(np.median(told)), *within])
    heads = columns("shape", "scenes: d", "median: .1%", "worst: .1%", "told, median: .1%")
    heads |= columns("within what is told: .0%", "within twice: .0%")
    note = (
        f"At `draft`, edges of {EDGE_MM:g} mm, against {EDGE_MM / 2:g}: the frame with the largest force before a fold"
        f" on both. {len(found) - len(known)} of {len(found)} have none, or took too long. The told error is fitted to"
        f" within a factor of {ERROR_ESTIMATE_FACTOR}; against half the edge some 70 % of it can show."
    )
    return Table("Against half the edge", heads, rows, note)
