"""Independent pieces of work on threads, for compiled functions that release the GIL."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_PARTS_PER_CORE = 4

_here = threading.local()
_starting = threading.Lock()


def core_count() -> int:
    """Count the processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_parallel(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Call a function with each item, on as many threads as there are cores; results are in order.

    The threads are started once and kept; waking them takes some 50 µs. With one item, on one core,
    or when called from one of the threads itself, the calls are made one after another. The
    function only runs faster where it releases the GIL. The first item's error is raised.
    """
    if len(items) < 2 or core_count() < 2 or getattr(_here, "is_worker", False):
        return [function(item) for item in items]
    return list(_executor().map(function, items))


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the function's result for each item, in order, called on threads a few calls ahead.

    Calls to `in_parallel` within it are made one after another. An error is raised in the place of
    its result; what waits is then not called.
    """
    waiting = iter(items)
    running = deque(
        _executor().submit(function, item) for item in islice(waiting, core_count() + 1)
    )
    try:
        while running:
            yield running.popleft().result()
            running.extend(_executor().submit(function, item) for item in islice(waiting, 1))
    finally:
        for future in running:
            future.cancel()


def ranges(count: int) -> list[tuple[int, int]]:
    """Split range(count) into a few parts a core, which evens out parts of unequal work.

    Each is (start, stop), none of them empty, in order.
    """
    parts = min(count, _PARTS_PER_CORE * core_count())
    return [(part * count // parts, (part + 1) * count // parts) for part in range(parts)]


def _executor() -> ThreadPoolExecutor:
    with _starting:  # or two callers at once would start two sets of threads
        return _started_executor()


@cache
def _started_executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(core_count(), "periscopy", initializer=_mark_as_worker)


def _mark_as_worker() -> None:
    # A worker that waited for others could wait for itself.
    _here.is_worker = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_starting.acquire,
        after_in_parent=_starting.release,
        after_in_child=_starting.release,
    )
    # Threads do not survive a fork; the child starts its own, the thread that forked is no worker.
    os.register_at_fork(after_in_child=_started_executor.cache_clear)
    os.register_at_fork(after_in_child=lambda: setattr(_here, "is_worker", False))
