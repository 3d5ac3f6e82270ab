"""Estimate of the cost of a plan: a few scenes are made and timed in a temporary folder."""

import math
import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from tacgen.base.errors import UserError
from tacgen.batch.local import SCENE_TASK, OnEvent, Pool
from tacgen.recipe.plan import Plan
from tacgen.recipe.row import Row
from tacgen.report.estimate import Cost, Made, cost, work

MAX_TIMED_SCENES = 8  # timed scenes at most
TIMING_S = 10.0  # for which scenes are timed [s]


class PlanCost(NamedTuple):
    """Estimated cost of a plan, and the peak memory of a worker [GB]."""

    cost: Cost
    memory_gb: float


def chosen(plan: Plan) -> list[Row]:
    """The scenes that are timed, evenly spread over the plan."""
    count = min(MAX_TIMED_SCENES, len(plan.rows))
    return [plan.rows[i * len(plan.rows) // count] for i in range(count)]


def probe(plan: Plan, workers: int, task: str = SCENE_TASK, on_event: OnEvent = lambda event: None) -> PlanCost:
    """Time some scenes on the same number of workers as the run, for TIMING_S after their first frame.

    What comes before it, as compiling, happens once. Where no scene is finished by then, the frames of those at work
    are judged by.

    Raises:
        UserError: none of them could be made.
    """
    rows, clock = chosen(plan), _FrameClock(on_event)
    with TemporaryDirectory() as name, Pool(min(workers, len(rows)), task=task) as pool:
        results = pool.run(rows, Path(name), on_event=clock, enough=clock.enough)
        good = [result for result in results if result.status != "failed"]
        made = [Made(r.frames, work(r.seconds), r.path.stat().st_size / 1e9) for r in good if r.frames]
        made = made or clock.made(Path(name))
    estimated = cost(plan.frames, made)
    if estimated is None:
        reason = next((f"{result.name}: {result.reason}" for result in results), "")
        raise UserError(f"no scene could be made to judge by: {reason}")
    return PlanCost(estimated, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6)


class _FrameClock:
    """When the frames of each scene came."""

    def __init__(self, on_event: OnEvent) -> None:
        self.on_event, self.finished = on_event, False
        self.times: dict[str, list[float]] = {}  # scene -> times of its frames [s]

    def __call__(self, event: dict[str, Any]) -> None:
        if event["event"] == "frame":
            self.times.setdefault(event["scene"], []).append(time.monotonic())
        self.finished = self.finished or event["event"] == "scene"
        self.on_event(event)

    def enough(self) -> bool:
        """Whether the time is over and there is something to judge by."""
        first = min((times[0] for times in self.times.values()), default=math.inf)
        judged = self.finished or any(len(times) > 1 for times in self.times.values())
        return judged and time.monotonic() - first > TIMING_S

    def made(self, folder: Path) -> list[Made]:
        """The frames after the first one of each scene at work, as if they were a scene."""
        frames = {name: len(times) - 1 for name, times in self.times.items() if len(times) > 1}
        seconds = {name: times[-1] - times[0] for name, times in self.times.items()}
        size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e9
        share = size / max(1, sum(n + 1 for n in frames.values()))
        return [Made(n, seconds[name], n * share) for name, n in frames.items()]
