"""Elasticity, contact and friction know no length: with all lengths s times as long, forces are s^2 times as large.

By powers of two, of which not even rounding knows.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from helpers.presses import Run, gel, poses, run, scene

from tacgen.geometry import mesh_file, mesh_import
from tacgen.geometry.analytic_sdf import Shape, SphereSdf
from tacgen.recipe import scene_of_row

Array = np.ndarray
PATH = [(0.0, 0.0, -0.3), (0.0, 0.0, -0.6), (0.3, 0.1, -0.6)]


def pressed(by: float, shape: Shape) -> Run:
    """The same press and slide with all lengths `by` times as long."""
    path = poses([(x * by, y * by, z * by) for x, y, z in PATH])
    made = scene(shape, path, pad=gel(24 * by, 16 * by, 3 * by), friction=0.5, edge=0.6 * by)
    return run(replace(made, dhat=0.05 * by))


def assert_alike(one: Run, other: Run, by: float, tol: float = 1e-9) -> None:
    assert np.abs(other.forces / by**2 - one.forces).max() < tol * np.abs(one.forces).max()
    assert [s.iterations for s in other.states] == [s.iterations for s in one.states]
    assert np.abs(one.forces[-1, :2]).min() > 0.02  # it is dragged


@pytest.mark.parametrize("by", [1 / 128, 128])
def test_a_pad(by: float) -> None:
    assert_alike(pressed(1, SphereSdf(2.5)), pressed(by, SphereSdf(2.5 * by)), by)


def test_a_mesh_indenter() -> None:
    """Its distance is on a grid of single precision."""
    by = 1 / 128

    def ball(by: float) -> Shape:
        found = trimesh.creation.icosphere(subdivisions=3, radius=2.5 * by)
        cell = scene_of_row.SDF_CELL_PER_EDGE * 0.6 * by
        raw = mesh_file.SolidMesh("ball", found.vertices, found.faces, np.zeros(len(found.faces), int))
        return mesh_import.field(mesh_import.placed(raw), cell=cell, height=1.0 * by, half=8.0 * by, radius=0.02 * by)

    assert_alike(pressed(1, ball(1)), pressed(by, ball(by)), by, 1e-6)
