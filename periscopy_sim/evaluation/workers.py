"""Many independent tasks on Dask workers: few in flight at once, done again where a worker dies."""

from __future__ import annotations

import asyncio
import logging
import pickle
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from itertools import islice
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from distributed import Client

Shared = TypeVar("Shared")
Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")

IN_FLIGHT = 256
"""Tasks that the scheduler holds at once; each waits with its result until that is taken."""

ATTEMPTS = 3
"""How often what dead workers took with them is sent out again."""

PATIENCE = 10
"""Seconds within which a scheduler must answer."""


@contextmanager
def connect(scheduler: str | None) -> Iterator[Client]:
    """Reach a Dask scheduler, ``tcp://host:8786`` say, or start one here, a thread for each core.

    While it lasts, Dask does not log, and this process' linear algebra runs on one thread where
    the workers live here. It is an error if nothing answers, or the scheduler has no workers.
    """
    from distributed import Client
    from threadpoolctl import threadpool_limits

    with _silenced("distributed"):
        if scheduler is None:
            local: dict[str, Any] = {"processes": False, "n_workers": 1, "memory_limit": 0}
            # Its server cannot be switched off; on a free port it disturbs no other.
            with threadpool_limits(1), Client(**local, dashboard_address="127.0.0.1:0") as client:
                yield client
            return
        try:
            _check_answer(scheduler)
            client = Client(scheduler, timeout=PATIENCE)
        except (OSError, ValueError, TypeError) as error:
            raise PeriscopyError(
                f"no Dask scheduler answers at '{scheduler}'; start one by `dask scheduler`, and "
                "give the address that it prints, such as tcp://host:8786"
            ) from error
        with client:
            if not client.nthreads():
                raise PeriscopyError(
                    f"the Dask scheduler at '{scheduler}' has no workers; start some by "
                    f"`dask worker {scheduler}`"
                )
            yield client


def compute(
    client: Client, task: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[tuple[Item, Result]]:
    """Run a task on every item, each on one thread of linear algebra; yield results as they come.

    The task takes `shared`, sent to each worker once, and an item; all items differ. What it
    raises is raised here, after two more tries; a PeriscopyError if workers keep dying.
    """
    from distributed import KilledWorker

    left = dict.fromkeys(items)
    for _ in range(ATTEMPTS):
        try:
            for item, result in _submitted(client, task, shared, list(left)):
                del left[item]
                yield item, result
        except (CancelledError, KilledWorker):  # what was shared died with its last holder
            continue
        return
    raise PeriscopyError(
        f"the Dask workers died {ATTEMPTS} times over, {len(left)} tasks before the end; give them "
        "more memory and run the same again"
    )


def _submitted(
    client: Client, task: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[tuple[Item, Result]]:
    from distributed import as_completed

    held = client.scatter(_Parcel(shared), broadcast=True, hash=False)
    waiting = iter(items)

    def submit(item: Item) -> Any:
        return client.submit(_on_one_thread, task, held, item, pure=False, retries=2)

    running = as_completed([submit(item) for item in islice(waiting, IN_FLIGHT)])
    for future in running:
        yield future.result()
        for item in islice(waiting, 1):
            running.add(submit(item))


def _check_answer(address: str) -> None:
    """Raise an OSError unless a Dask scheduler is at an address and answers in time.

    It is asked in a thread of its own: whatever is there may answer anything, or not.
    """
    from distributed.comm import connect

    async def identity() -> str:
        comm = await connect(address, timeout=PATIENCE)
        try:
            await comm.write({"op": "identity", "reply": True})
            return str((await comm.read())["type"])
        finally:
            comm.abort()

    def ask() -> None:
        try:
            answer.set_result(asyncio.run(asyncio.wait_for(identity(), PATIENCE)))
        except Exception:  # MemoryError too, where it sends what reads as a length of terabytes
            answer.set_result("")

    answer: Future[str] = Future()
    Thread(target=ask, daemon=True).start()
    if answer.result(PATIENCE) != "Scheduler":  # or a TimeoutError; signals interrupt it
        raise ConnectionError(f"{address} is no scheduler")


class _Parcel(Generic[Shared]):
    """Carries what tasks share to other processes.

    Left to itself Dask would lay arrays at any address there. Sums over arrays that are not aligned
    run in another order, and every product would copy them first.
    """

    def __init__(self, content: Shared) -> None:
        self.content = content

    def __reduce__(self) -> tuple[Any, ...]:
        import cloudpickle

        return _unpacked, (cloudpickle.dumps(self.content),)


def _unpacked(content: bytes) -> _Parcel[Any]:
    return _Parcel(pickle.loads(content))


def _on_one_thread(
    task: Callable[[Shared, Item], Result], parcel: _Parcel[Shared], item: Item
) -> tuple[Item, Result]:
    from threadpoolctl import threadpool_limits

    # Never undone: another task of this process may be in the midst of its products.
    threadpool_limits(1)
    return item, task(parcel.content, item)


@contextmanager
def _silenced(library: str) -> Iterator[None]:
    """Log nothing of a library: what matters is raised."""
    loggers = [
        logging.getLogger(name)
        for name in (library, *logging.root.manager.loggerDict)
        if name == library or name.startswith(f"{library}.")
    ]
    before = [(logger, logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:  # those that come later end at the library's own
        logger.handlers, logger.propagate = [logging.NullHandler()], False
    try:
        yield
    finally:
        for logger, handlers, propagate in before:
            logger.handlers, logger.propagate = handlers, propagate
