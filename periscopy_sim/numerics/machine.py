"""The machine: its cores, threads for functions that release the GIL, and its memory."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_here = threading.local()  # of a worker, which waiting for others could make wait for itself


def core_count() -> int:
    """Count the processor cores that this process may use."""
    has_affinity = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1


def in_parallel(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Call a function with each item, on as many threads as there are cores; results are in order.

    The threads are started once and kept; waking them takes some 50 µs. With one item, on one core,
    or when called from one of the threads itself, the calls are made one after another. The
    function only runs faster where it releases the GIL. The first item's error is raised.
    """
    if len(items) < 2 or core_count() < 2 or getattr(_here, "process", 0) == os.getpid():
        return [function(item) for item in items]
    return list(_executor(os.getpid()).map(function, items))


@contextmanager
def one_thread() -> Iterator[None]:
    """Make `in_parallel` use this thread alone, so that its time is all that a call takes."""
    before = getattr(_here, "process", 0)
    _here.process = os.getpid()
    try:
        yield
    finally:
        _here.process = before


Stage = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Receives the name of a long computation, and gives a function of the fraction that is done."""


def silent(_: str) -> AbstractContextManager[Callable[[float], None]]:
    """Show no progress."""
    return nullcontext(lambda _: None)


def rising(progress: Callable[[float], None] | None) -> Callable[[float], None]:
    """Return a function that reports a fraction done, the largest so far: estimates may fall."""
    most = 0.0

    def report(done: float) -> None:
        nonlocal most
        most = max(most, done)
        if progress is not None:
            progress(most)

    return report


LONG = 2.0
"""Seconds of a call beside which what its first run compiles does not count."""


def timed(function: Callable[[], Result]) -> tuple[float, Result]:
    """Return how long a call takes, in seconds, and its result; a short call is repeated."""
    for _ in range(2):
        started = time.perf_counter()
        result = function()
        if (seconds := time.perf_counter() - started) > LONG:
            break
    return seconds, result


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the function's result for each item, in order, called on threads a few calls ahead.

    Calls to `in_parallel` within it are made one after another. An error is raised in the place of
    its result; what waits is then not called.
    """
    calls = (_executor(os.getpid()).submit(function, item) for item in items)
    running = deque(islice(calls, core_count() + 1))
    try:
        while running:
            yield running.popleft().result()
            running.extend(islice(calls, 1))
    finally:
        for future in running:
            future.cancel()


def ranges(count: int, parts_per_core: int = 4) -> list[tuple[int, int]]:
    """Split range(count) into a few parts a core, which evens out parts of unequal work.

    Each is (start, stop), none of them empty, in order.
    """
    parts = min(count, parts_per_core * core_count())
    return [(part * count // parts, (part + 1) * count // parts) for part in range(parts)]


@cache
def _executor(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process; after a fork the child starts its own."""
    return ThreadPoolExecutor(core_count(), "periscopy", setattr, (_here, "process", process))


def available_memory() -> int | None:
    """Return the available bytes, within a container's limit; None if unknown."""
    known = [_of_machine(), _of_container()]
    return min((size for size in known if size is not None), default=None)


def _of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        return 1024 * int(dict(line.split(":") for line in lines)["MemAvailable"].split()[0])
    except (KeyError, ValueError, OSError):  # of Linux alone
        return None


def _of_container(folder: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return what cgroups (version 2) leave, without what their cache could give back."""
    try:
        limit, used, statistics = (
            (folder / f"memory.{name}").read_text("ascii") for name in ("max", "current", "stat")
        )
        cached = dict(map(str.split, statistics.splitlines())).get("inactive_file", 0)
        return int(limit) - int(used) + int(cached)
    except (ValueError, OSError):  # no container, or no limit
        return None
