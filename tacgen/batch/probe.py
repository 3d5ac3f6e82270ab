"""Estimate of the cost of a plan: a few scenes are made and timed in a temporary folder."""

import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tacgen.batch.local import TASK, Pool
from tacgen.errors import UserError
from tacgen.recipe.plan import Plan
from tacgen.report.estimate import Cost, Made, cost, work

SCENES = 8  # timed scenes at most
ENOUGH_S = 60.0  # after this time no further scenes are timed [s]


class PlanCost(NamedTuple):
    """Estimated cost of a plan, and the peak memory of a worker [GB]."""

    cost: Cost
    memory_gb: float


def probe(plan: Plan, workers: int, task: str = TASK) -> PlanCost:
    """Time some scenes, evenly spread over the plan, on the same number of workers as the run.

    Raises:
        UserError: none of them could be made.
    """
    count = min(SCENES, len(plan.rows))
    chosen = [plan.rows[i * len(plan.rows) // count] for i in range(count)]
    made: list[Made] = []
    reason = ""
    with TemporaryDirectory() as name, Pool(min(workers, count), task=task) as pool:
        folder, begun = Path(name), 0.0
        pool.run(chosen[:1], folder / "first")  # compiles, and fills the caches
        begun = time.monotonic()
        for at in range(0, count, pool.size):
            for result in pool.run(chosen[at : at + pool.size], folder):
                if result.status == "failed":
                    reason = f"{result.name}: {result.reason}"
                else:
                    made.append(Made(result.frames, work(result.seconds), result.path.stat().st_size / 1e9))
            if time.monotonic() - begun > ENOUGH_S:
                break
    estimated = cost(plan.frames, made)
    if estimated is None:
        raise UserError(f"no scene could be made to judge by: {reason}")
    return PlanCost(estimated, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6)
