"""Cores and processor of this machine, and how a process that is started finds this package."""

import os
import platform
from contextlib import suppress
from functools import cache
from pathlib import Path

PACKAGE_PARENT = str(Path(__file__).resolve().parents[2])


def cores() -> int:
    """Number of processor cores for this process, by its CPU affinity and the quota of its control group."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1  # macOS has none
    with suppress(OSError, ValueError):  # "max": no quota
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text().split()
        count = min(count, max(1, int(quota) // int(period)))
    return count


@cache
def processor() -> str:
    """The processor and what it can do: code for one may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    told = ("model name", "flags", "Features", "CPU part")
    return " ".join(sorted({line for line in lines if line.startswith(told)}))


def environment(**more: str) -> dict[str, str]:
    """Environment variables of a process that this one starts, which imports this very package."""
    paths = [PACKAGE_PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, **more, "PYTHONPATH": os.pathsep.join(paths)}
