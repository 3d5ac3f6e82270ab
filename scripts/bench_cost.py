"""What a frame costs: every sensor pressed, slid and twisted, and how the cost grows with the mesh.

    python scripts/bench_cost.py [--qualities draft default] [--nodes 2000 5000 10000 20000 40000] [--solid gel.yaml]

A ball of 4 mm with friction 0.6: pressed in five frames, slid 1 mm in five, twisted 10 deg in five. Each line is a
process of its own on one core: processor seconds a frame, Newton iterations, factorisations and peak memory. Ratios
carry over to other machines, seconds do not. The exponent is the slope of log seconds over log nodes.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.6, "ninedtact": 1.0}
PRESS = "{{press: {{depth_mm: {depth}, frames: {frames}}}}}"
MOVES = f"[{PRESS}, {{{{slide: {{{{x_mm: 1, frames: 5}}}}}}}}, {{{{twist: {{{{angle_deg: 10, frames: 5}}}}}}}}]"


def solved(sets: list[str]) -> dict[str, float | list[float]]:
    """Solve the quickstart with changes, here and now."""
    from tacgen import assets, foresee, mesh, plan, scene, solve

    row = plan.load(assets.recipe_path("quickstart"), ["outputs=[force]", *sets]).rows[0]
    made = foresee.foreseen(scene.build(row))
    warm = solve.Problem.of(made, mesh.of(made))
    next(solve.states(made, warm))  # compile, or read what was compiled
    del warm
    begun = time.process_time()
    problem = solve.Problem.of(made, mesh.of(made))
    ready = time.process_time()
    seconds, iterations = [], []
    last = ready
    for state in solve.states(made, problem):
        iterations.append(state.iterations)
        seconds.append(time.process_time() - last)
        last = time.process_time()
    return {
        "nodes": len(problem.mesh.points),
        "mesh": ready - begun,
        "seconds": seconds,
        "iterations": iterations,
        "factored": problem.factored,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def apart(*sets: str) -> dict:
    """The same in a process of its own, so that its peak of memory is its own."""
    environment = os.environ | dict.fromkeys(ONE_THREAD, "1")
    done = subprocess.run([sys.executable, __file__, "--one", *sets], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--qualities", nargs="*", default=["draft", "default"])
    parser.add_argument("--sensors", nargs="*", default=list(DEPTHS))
    parser.add_argument("--nodes", nargs="*", type=int, default=[2000, 5000, 10000, 20000])
    parser.add_argument("--tet", action="store_true", help="quadratic tetrahedra instead of hexes")
    parser.add_argument("--one", nargs="*", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one is not None:
        print(json.dumps(solved(asked.one)))
        return
    element = ["mesh=tet"] if asked.tet else []
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}\n")
    print(f"{'':<24}{'nodes':>7}{'press':>8}{'slide':>8}{'twist':>8}  s a frame   iterations  factored   MB")
    for sensor in asked.sensors:
        for quality in asked.qualities:
            trajectory = MOVES.format(depth=DEPTHS[sensor], frames=5)
            found = apart(f"sensor={sensor}", f"trajectory={trajectory}", f"quality={quality}", *element)
            s = found["seconds"]
            parts = "".join(f"{sum(s[k : k + 5]) / 5:8.2f}" for k in (0, 5, 10))
            count = sum(found["iterations"]) / len(s)
            print(f"{sensor + ' ' + quality:<24}{found['nodes']:>7}{parts}  {sum(s) / len(s):9.2f}   {count:10.1f}"
                  f"  {found['factored']:8.0f}  {found['memory']:5.0f}")  # fmt: skip
    sizes, costs = [], []
    print("\na press in two frames, ever finer")
    for nodes in asked.nodes:
        edge = round(0.4 * (5600 / nodes) ** (1 / 2.6), 3)
        found = apart(
            f"trajectory=[{PRESS.format(depth=1.0, frames=2)}]",
            f"quality={{edge_mm: {edge}, dhat_mm: 0.03}}",
            *element,
        )
        s = found["seconds"]
        sizes.append(found["nodes"])
        costs.append(sum(s) / sum(found["iterations"]))
        each = f"{sum(s) / len(s):7.2f} s a frame  {costs[-1]:6.3f} s an iteration"
        print(f"edge {edge:<6}  {found['nodes']:>7} nodes  {each}  {found['factored']:3.0f} factored  "
              f"{found['memory']:5.0f} MB")  # fmt: skip
    if len(sizes) > 1:
        import numpy as np

        exponent = np.polyfit(np.log(sizes), np.log(costs), 1)[0]
        print(f"cost an iteration grows as nodes^{exponent:.2f}, {sizes[0]} to {sizes[-1]} nodes")


if __name__ == "__main__":
    main()
