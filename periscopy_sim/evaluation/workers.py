"""Many independent tasks on Dask workers, few of them in flight at once."""

import asyncio
import logging
import pickle
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.machine import core_count
from periscopy_sim.storage.places import place

if TYPE_CHECKING:
    from distributed import Client

Shared = TypeVar("Shared")
Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")

IN_FLIGHT = 256
"""Tasks that the scheduler holds at once at least, with results that nobody has read yet."""

CONNECTING, EXAMINING = 10.0, 60.0
"""Seconds for a scheduler to answer, several times those of a slow network, and for its workers to
import this package, perhaps from a shared disk."""


@contextmanager
def connect(scheduler: str | None) -> "Iterator[Client]":
    """Reach a Dask scheduler, ``tcp://host:8786`` say, or start one here, a thread for each core.

    Meanwhile nothing is logged, and the linear algebra of this process runs on one thread if the
    workers live here. A PeriscopyError says that no scheduler answers, or that it has no workers of
    the same versions.
    """
    from distributed import Client

    check_scheduler(scheduler)
    settings: dict[str, Any] = {"address": scheduler, "timeout": CONNECTING}
    if scheduler is None:
        # Its server cannot be switched off; on a free port it disturbs no other.
        settings = {"processes": False, "n_workers": 1, "memory_limit": 0}
        settings |= {"dashboard_address": "127.0.0.1:0"}
    limits = threadpool_limits(1 if scheduler is None else None)
    with _silence(), limits, Client(**settings) as client:
        yield client


@contextmanager
def _silence() -> Iterator[None]:
    """Log nothing, as Dask does of what it also raises."""
    disabled = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(disabled)


def thread_count(scheduler: str | None) -> int:
    """Return how many tasks run at once: the threads of a cluster, or the cores of this machine."""
    if scheduler is None:
        return core_count()
    with connect(scheduler) as client:
        return sum(client.nthreads().values())


def check_scheduler(scheduler: str | None, out: Path | None = None) -> None:
    """Raise the errors of `connect`, before hours of work say; None is this process.

    It is an error, too, if workers lack the library that opens `out`.
    """
    if scheduler is None:
        return
    from dask import config
    from distributed import Client

    async def ask() -> dict[str, Any]:
        # Dask has no limit for a port that accepts and says nothing.
        client = Client(scheduler, asynchronous=True, timeout=CONNECTING)
        try:
            await asyncio.wait_for(client, CONNECTING)
            # A cluster that grows and shrinks by itself has workers once there is a task.
            first = client.submit(_versions, pure=False)
            with suppress(Exception):  # what is wrong, all workers say below
                await asyncio.wait_for(first.result(), EXAMINING)
            answers = client.run(_versions, out and str(out), on_error="return")
            return dict(await asyncio.wait_for(answers, EXAMINING))
        finally:
            await client.close()

    try:
        # In another thread: a notebook's own has a loop of events already.
        with _silence(), config.set(scheduler=None):
            versions = ThreadPoolExecutor(1).submit(asyncio.run, ask()).result()
    except Exception as error:  # of whatever listens there
        raise PeriscopyError(
            f"no Dask scheduler with its workers answers at '{scheduler}'; start one by `dask "
            "scheduler`, and give the address that it prints, such as tcp://host:8786"
        ) from error
    if faults := [each for each in versions.values() if isinstance(each, PeriscopyError)]:
        raise PeriscopyError(f"a Dask worker of '{scheduler}' cannot write there: {faults[0]}")
    if not versions or any(each != _versions() for each in versions.values()):
        raise PeriscopyError(
            f"the Dask scheduler at '{scheduler}' has no workers of {_versions()} alone, but "
            f"{versions}; start some by `dask worker {scheduler}`"
        )


def _versions(out: str | None = None) -> dict[str, str]:
    """Return the versions on which results depend; raise if nothing here opens a URL, `out`."""
    if out is not None:
        place(out)
    return {package: metadata.version(package) for package in ("periscopy-sim", "mitsuba")}


def compute(
    client: "Client", task: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[tuple[Item, Result]]:
    """Run a task on every item, each on one thread of linear algebra; yield results as they come.

    The task gets `shared`, sent to each worker once, and an item; all items differ. Errors of a
    task are raised here. Workers may come and go: Dask repeats what those held that are gone. If
    they keep dying, or the scheduler has, it is a PeriscopyError.
    """
    from distributed import KilledWorker, as_completed
    from distributed.comm import CommClosedError

    waiting = iter(items)
    try:
        try:
            parcel = _sent(client, _Parcel(shared))
        except TypeError as error:
            raise PeriscopyError(
                "a method of yours cannot travel to the workers, because pickle rejects it; keep "
                "locks, threads and open files out of its object"
            ) from error
        submit = partial(client.submit, _on_one_thread, task, parcel, pure=False)
        at_once = max(IN_FLIGHT, 2 * sum(client.nthreads().values()))
        running = as_completed([submit(item) for item in islice(waiting, at_once)])
        for future in running:
            yield future.result()
            for item in islice(waiting, 1):
                running.add(submit(item))
    except Exception as error:
        lost = CancelledError, CommClosedError, KilledWorker, TimeoutError
        if client.status == "running" and not isinstance(error, lost):
            raise  # of the task; without a scheduler Dask raises anything
        raise PeriscopyError(
            "the Dask scheduler or its workers are gone; start them, the workers with more memory, "
            "and begin again: the work goes on where it stopped"
        ) from error


def _sent(client: "Client", parcel: "_Parcel") -> Any:
    """Return the future of a parcel on the workers."""
    from dask import config

    if client.cluster is not None:  # of `connect`: the workers live here
        return client.scatter(parcel, hash=False)
    # As a task, which Dask repeats; scattered data is lost with the workers that hold it.
    with config.set({"distributed.admin.large-graph-warning-threshold": "1 PB"}):
        return client.submit(_same, parcel, pure=False)


def _same(parcel: "_Parcel") -> "_Parcel":
    return parcel


class _Parcel:
    """Carries what tasks share to other processes.

    Left to itself Dask would lay arrays at any address there. Sums over arrays that are not aligned
    run in another order, and every product would copy them first.
    """

    def __init__(self, content: Any) -> None:
        self.content = content

    def __getstate__(self) -> Any:
        import cloudpickle

        return cloudpickle.dumps(self.content)

    def __setstate__(self, content: bytes) -> None:
        self.content = pickle.loads(content)


def _on_one_thread(
    task: Callable[[Any, Item], Result], parcel: _Parcel, item: Item
) -> tuple[Item, Result]:
    # Never undone: another task of this process may be in the midst of its products.
    threadpool_limits(1)
    return item, task(parcel.content, item)
