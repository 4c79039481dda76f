"""Times of tasks: medians of several runs."""

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

Result = TypeVar("Result")


def clocked(task: Callable[[], Result], runs: int = 1) -> tuple[float, Result]:
    """Return the median of a task's seconds in several runs, and the last run's result."""
    seconds = []
    for run in range(1, runs + 1):
        start = time.perf_counter()
        result = task()
        seconds.append(time.perf_counter() - start)
        if run < runs:
            del result  # gigabytes, before the next ones
    return float(np.median(seconds)), result
