"""Stiff and extreme scenes: each converges, and none turns an element inside out or lets the indenter through."""

from pathlib import Path

import pytest

from tacgen import mesh, plan, solve
from tacgen import scene as stage

RECIPE = """\
tacgen: 1
name: extreme
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
trajectory:
  - press: {depth_mm: 1.0, frames: 2}
  - slide: {x_mm: 0.4, frames: 1}
contact: {friction: 0.6}
outputs: [force]
quality: {edge_mm: 0.8, dhat_mm: 0.05}
"""
GEL = "sensor.gel.layers[0]"
QUICK = {
    "1 kPa": (f"{GEL}.youngs_modulus_mpa=0.001",),
    "100 MPa": (f"{GEL}.youngs_modulus_mpa=100",),
    "nu 0": (f"{GEL}.poissons_ratio=0.0",),
    "nu 0.4999": (f"{GEL}.poissons_ratio=0.4999",),
    "half deep": ("trajectory=[{press: {depth_mm: 2.0, frames: 2}}]",),
    "three quarters deep at once": ("trajectory=[{press: {depth_mm: 3.0, frames: 1}}]",),
    "friction 2": ("contact.friction=2",),
    "no friction": ("contact.friction=0",),
    "sharp cone": ("indenter={shape: cone, half_angle_deg: 30, tip_radius_mm: 0.1}",),
    "small ball": (
        "indenter={shape: sphere, radius_mm: 0.3}",
        "quality={edge_mm: 0.2, dhat_mm: 0.02}",
        "trajectory=[{press: {depth_mm: 0.3, frames: 2}}, {slide: {x_mm: 0.2, frames: 1}}]",
    ),
    "jump across the pad": ("trajectory=[{press: {depth_mm: 1.0, frames: 1}}, {slide: {x_mm: 6, frames: 1}}]",),
}
SLOW = {
    "wedge": ("indenter={shape: wedge, half_angle_deg: 30, tip_radius_mm: 0.2, length_mm: 8}",),
    "torus": ("indenter={shape: torus, radius_mm: 4, tube_radius_mm: 0.6}",),
}
CASES = [pytest.param(sets, id=name) for name, sets in QUICK.items()]
CASES += [pytest.param(sets, id=name, marks=pytest.mark.slow) for name, sets in SLOW.items()]


@pytest.mark.parametrize("sets", CASES)
def test_it_converges_without_inversion_or_penetration(sets: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "extreme.yaml"
    path.write_text(RECIPE)
    made = stage.build(plan.load(path, sets).rows[0])
    problem = solve.Problem.of(made, mesh.build(made.gel, mesh.footprint(made), made.edge))
    states = list(solve.states(made, problem))
    assert len(states) == len(made.poses)
    for state in states:
        assert state.min_gap > 0
        assert state.balance < 1e-3
        assert state.residual < 1e-3
        assert min(part.at(state.x).J.min() for part in problem.elastic) > 0
        assert state.traction_force.sum((0, 1))[2] < 0
