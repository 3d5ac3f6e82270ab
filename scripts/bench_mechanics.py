"""Error against run time of the mechanics: each quality on the Mini's pad, on one core.

    python scripts/bench_mechanics.py [--repeats 3] [--qualities draft default]

Error: forces of single presses against CalculiX 2.20 (quadratic hexes). Time: processor seconds a frame of the
quickstart's press, slide and twist, median over the repeats and their spread. Ratios carry over to other machines,
seconds do not.
"""

import argparse
import os
import platform
import statistics
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

from tacgen import assets, mesh, plan, scene, solve  # noqa: E402

CALCULIX = {  # name: (force [N], --set lines)
    "R 4, 1 mm": (1.000, ("indenter.radius_mm=4",)),
    "R 4, 1 mm, friction 0.6": (1.087, ("contact.friction=0.6", "trajectory[0].press.frames=5")),
    "R 3, 0.8 mm": (
        0.3465,
        (
            "indenter.radius_mm=3",
            "trajectory=[{press: {depth_mm: 0.8, frames: 1}}]",
            "sensor.gel.layers[0].youngs_modulus_mpa=0.1",
            "sensor.gel.layers[0].poissons_ratio=0.49",
        ),
    ),
}
PRESS = (
    "outputs=[force]",
    "contact.friction=0",
    "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]",
    "sensor.gel.layers[0].youngs_modulus_mpa=0.15",
    "sensor.gel.layers[0].poissons_ratio=0.48",
)


def solved(*sets: str) -> tuple[solve.Problem, list[solve.State], list[float]]:
    """The quickstart with changes: its problem, states and processor seconds of each frame."""
    row = plan.load(assets.recipe_path("quickstart"), sets).rows[0]
    made = scene.build(row)
    problem = solve.Problem.of(made, mesh.build(made.gel, mesh.footprint(made), made.edge))
    states, seconds = [], []
    start = time.process_time()
    for state in solve.states(made, problem):
        states.append(state)
        seconds.append(time.process_time() - start)
        start = time.process_time()
    return problem, states, seconds


def times(quality: str, repeats: int) -> str:
    """Seconds a frame of press, slide and twist at a quality, as one line."""
    runs = []
    for _ in range(repeats):
        problem, states, seconds = solved("outputs=[force]", f"quality={quality}")
        runs.append(seconds)
    parts = [statistics.median(sum(r[5 * k : 5 * k + 5]) / 5 for r in runs) for k in range(3)]
    means = [sum(r) / len(r) for r in runs]
    iterations = sum(s.iterations for s in states) / len(states)
    return (
        f"{quality:<10} {len(problem.mesh.points):>6} nodes  {iterations:4.1f} iterations a frame  "
        f"press {parts[0]:.2f}  slide {parts[1]:.2f}  twist {parts[2]:.2f}  "
        f"all {statistics.median(means):.2f} s a frame ({min(means):.2f}-{max(means):.2f})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--qualities", nargs="+", default=["draft", "default"])
    asked = parser.parse_args()
    solved("outputs=[force]", "quality=draft")  # compile
    problem, _, _ = solved("outputs=[force]", "quality=draft")
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, {problem.linear.name}")
    print("\nforce against CalculiX")
    for quality in asked.qualities:
        for name, (reference, sets) in CALCULIX.items():
            problem, states, seconds = solved(*PRESS, f"quality={quality}", *sets)
            force = -states[-1].traction_force.sum((0, 1))[2]
            print(
                f"{quality:<10} {name:<24} {force:.4f} N against {reference:.4f} N: {force / reference - 1:+.2%}  "
                f"({len(problem.mesh.points)} nodes, {sum(seconds):.1f} s)"
            )
    print("\nquickstart, processor seconds a frame on one core")
    for quality in asked.qualities:
        print(times(quality, asked.repeats))


if __name__ == "__main__":
    main()
