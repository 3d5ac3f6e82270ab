"""Estimate of the cost of scenes from scenes that are finished, with a confidence interval."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from tacgen.bundle.run_status import Survey
from tacgen.report.sheet import counted, duration

ONE_TIME_STAGES = ("start", "compile")  # stages that occur once per process or machine, not in each scene
RANGE_END_PROBABILITY = 0.95  # probability for each end of a range, so that 90 % lie within


class Made(NamedTuple):
    """A finished scene: number of frames, seconds of one core, gigabytes on disk."""

    frames: int
    seconds: float
    gigabytes: float


class Range(NamedTuple):
    """An estimated sum and its 90 % confidence interval; the ends are nan if only one scene is known."""

    expected: float
    low: float
    high: float


class Cost(NamedTuple):
    """Total cost of scenes."""

    seconds: Range  # of one core
    gigabytes: Range  # on disk
    judged_by: int  # number of finished scenes

    def text(self, workers: int) -> str:
        """`about 3.4 h of one core (2.6 h to 4.2 h), 26 min with 8 workers; 12 GB; estimated from 6 scenes`"""
        time, size = self.seconds, self.gigabytes
        text = f"about {duration(time.expected)} of one core"
        text += "" if math.isnan(time.low) else f" ({duration(time.low)} to {duration(time.high)})"
        text += f", {duration(time.expected / workers)} with {workers} workers" if workers > 1 else ""
        text += f"; {size.expected:.2g} GB"
        text += "" if math.isnan(size.low) else f" ({size.low:.2g} to {size.high:.2g})"
        return f"{text}; estimated from {counted(self.judged_by, 'scene')}"

    def plain(self) -> dict[str, Any]:
        """As JSON values; null without a confidence interval."""
        ranges = {"seconds": self.seconds, "gigabytes": self.gigabytes}
        said = {name: [None if math.isnan(x) else x for x in value] for name, value in ranges.items()}
        return {**said, "judged_by": self.judged_by}


def work(seconds: dict[str, float]) -> float:
    """Seconds of a scene without the stages in ONE_TIME_STAGES."""
    return sum(value for stage, value in seconds.items() if stage not in ONE_TIME_STAGES)


def cost(frames: Sequence[int], made: Sequence[Made]) -> Cost | None:
    """Estimated cost of scenes with these numbers of frames; None if no scene is finished."""
    if not sum(one.frames for one in made):
        return None
    seconds, gigabytes = ([getattr(one, name) for one in made] for name in ("seconds", "gigabytes"))
    known = [one.frames for one in made]
    return Cost(_sum(frames, known, seconds), _sum(frames, known, gigabytes), len(made))


def _sum(frames: Sequence[int], known: Sequence[int], costs: Sequence[float]) -> Range:
    """Ratio estimate by cost per frame (Cochran 1977, Sampling Techniques, 6.4): scenes of the same distribution."""
    k, n, rate = len(costs), len(frames), sum(costs) / sum(known)
    expected = rate * sum(frames)
    if k < 2:
        return Range(expected, math.nan, math.nan)
    from scipy.special import stdtrit  # the quantile of Student's t

    variance = sum((cost - rate * f) ** 2 for cost, f in zip(costs, known, strict=True)) / (k - 1)
    off = float(stdtrit(k - 1, RANGE_END_PROBABILITY)) * math.sqrt(variance * (n + n * n / k))
    return Range(expected, max(0.0, expected - off), expected + off)


def left(survey: Survey) -> Cost | None:
    """Estimated cost of the unfinished scenes of a folder; None if there are none, or nothing to estimate from."""
    done = [scene for scene in survey.scenes if scene.seconds and scene.state in ("ok", "rejected")]
    made = [Made(scene.frames, work(scene.seconds), scene.path.stat().st_size / 1e9) for scene in done]
    frames = [scene.frames for scene in survey.scenes if scene.state in ("waiting", "at work", "damaged")]
    return cost(frames, made) if frames else None
