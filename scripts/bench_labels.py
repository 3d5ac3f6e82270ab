"""What labels cost and how well they agree, at default quality, on each sensor: press, slide and twist of a ball.

    python scripts/bench_labels.py [--sensors gelsight_mini digit ninedtact]

Processor seconds a frame on one core: the solve, stress (recovered, with its quality numbers) and maps (pressure,
traction, forces), and the share of both in the solve. Then the worst frame's sigma n against the force and against the
traction over the face, how much pressure alternates, how far the force map's sum is off, and Coulomb's law in the map.
"""

import argparse
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

from tacgen import fields, mesh, plan, scene, solve  # noqa: E402
from tacgen.maps import maps  # noqa: E402
from tacgen.optics.layers import Camera  # noqa: E402
from tacgen.stress import Stresses  # noqa: E402

RECIPE = """
tacgen: 1
name: labels
sensor: {sensor}
indenter: {{shape: sphere, radius_mm: 4.0}}
trajectory:
  - press: {{depth_mm: 0.8, frames: 3}}
  - slide: {{x_mm: 1.0, y_mm: 0.3, frames: 4}}
  - twist: {{angle_deg: 12, frames: 3}}
contact: {{friction: 0.6}}
outputs: [stress, traction, force_map]
"""


def measured(sensor: str, folder: Path) -> str:
    """One line."""
    (folder / "r.yaml").write_text(RECIPE.format(sensor=sensor))
    row = plan.load(folder / "r.yaml").rows[0]
    made = scene.build(row)
    problem = solve.Problem.of(made, mesh.build(made.gel, mesh.footprint(made), made.edge))
    camera, stresses = Camera.from_sensor(row.sensor), Stresses(problem)
    rest = fields.Surface(problem.mesh.points, problem.mesh.facets["coated"])
    seconds, worst = np.zeros(3), np.zeros(5)
    states, frames = solve.states(made, problem), 0
    while True:
        clock = [time.process_time()]
        state = next(states, None)
        clock.append(time.process_time())
        if state is None:
            break
        quality = stresses.quality(stresses.at(state.x), state)
        clock.append(time.process_time())
        found = maps(problem, rest.moved(state.x), state, camera)
        clock.append(time.process_time())
        if frames:  # the first compiles
            seconds += np.diff(clock)
        frames += 1
        force, _ = fields.wrench(problem, state)
        lost = np.linalg.norm(found.force.sum((0, 1)) - force) / np.linalg.norm(force)
        size, limit = np.linalg.norm(found.traction, axis=-1), 0.6 * found.pressure
        worst = np.maximum(worst, [*quality.values(), lost, (size - limit).max() / limit.max()])
    solved, stressed, mapped = seconds / (frames - 1)
    cost = f"{solved:6.2f} {1e3 * stressed:8.0f} {1e3 * mapped:8.0f} {(stressed + mapped) / solved:8.1%}"
    force, traction, alternates, lost, over = worst
    return f"{sensor:<14} {cost}   {force:7.2%} {traction:8.1%} {alternates:9.1%} {lost:9.0e} {over:9.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=["gelsight_mini", "digit", "ninedtact"])
    asked = parser.parse_args()
    print(f"{'':<14} solve s stress ms  maps ms    share   sigma n traction alternates  map sum   Coulomb")
    with TemporaryDirectory() as folder:
        for sensor in asked.sensors:
            print(measured(sensor, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
