"""What a data set costs on worker processes, and what the scheduler adds to each block.

The example's configuration, made by 1, 2, 4 and 8 worker processes of one thread each, which write
their blocks to `file://` themselves, as to an object store. Processor seconds are compared, not
the wall's: eight workers on few cores wait for each other. Scheduler, client and what watches the
workers are one process here. What it takes while nobody works is stated apart: it grows with the
wall's seconds, not with blocks.
"""

import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.page import described, processor_seconds
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import Setting
from periscopy_sim.dataset.configuration import EXAMPLE

Array = NDArray[np.float64]

WORKERS = 1, 2, 4, 8
GEOMETRIES, IDLE = 8, 10.0
GOAL = 0.05
"""Of a block's time, what the scheduler may add."""


class Cost(NamedTuple):
    """What making a data set takes."""

    of_workers: float  # processor seconds
    of_blocks: float  # those of this process, but for its watching
    watching: float  # of this process a second, while nobody works
    megabytes: float  # the most memory of a worker
    blocks: int
    samples: int
    size: int  # bytes

    @property
    def overhead(self) -> float:
        """What scheduler and client add to a block, over what the workers take."""
        return self.of_blocks / self.of_workers


def scale(setting: Setting) -> Section:
    """Make the same data set by more and more workers."""
    costs = {workers: _made(setting.out / "scale.zarr", workers) for workers in WORKERS}
    overhead = costs[WORKERS[-1]].overhead
    return Section(
        "scale",
        "A data set on worker processes",
        text=described(__doc__),
        claims=[
            Claim(
                f"what scheduler and client add to a block, {WORKERS[-1]} workers",
                f"at most {100 * GOAL:g} %",
                f"{100 * overhead:.1f} %",
                Verdict.of(overhead <= GOAL),
            )
        ],
        tables=[
            Table(
                "Processor milliseconds, and kilobytes of a sample.",
                (
                    "workers", "a sample", "a block", "scheduler and client, a block", "share",
                    "watching, a second", "MB of a worker", "kB",
                ),
                [
                    (
                        str(workers),
                        f"{1e3 * cost.of_workers / cost.samples:.1f}",
                        f"{1e3 * cost.of_workers / cost.blocks:.0f}",
                        f"{1e3 * cost.of_blocks / cost.blocks:.0f}",
                        f"{100 * cost.overhead:.1f} %",
                        f"{1e3 * cost.watching:.0f}",
                        f"{cost.megabytes:.0f}",
                        f"{cost.size / cost.samples / 1e3:.0f}",
                    )
                    for workers, cost in costs.items()
                ],
            )
        ],
    )  # fmt: skip


def _made(path: Path, workers: int) -> Cost:
    from distributed import Client, LocalCluster

    shutil.rmtree(path, ignore_errors=True)
    configuration = ps.load_configuration(EXAMPLE)
    samples = GEOMETRIES * configuration.samples_per_geometry
    local = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**local) as cluster, Client(cluster) as client:

        def taken(task: Callable[[], object]) -> tuple[float, float, float]:
            """Return the processor seconds of the workers and of this process, and the wall's."""

            def now() -> Array:
                of_workers = sum(client.run(processor_seconds).values())
                return np.array([of_workers, processor_seconds(), time.perf_counter()])

            before = now()
            task()
            of_workers, own, wall = (now() - before).tolist()
            return of_workers, own, wall

        def watching() -> float:
            _, seconds, wall = taken(partial(time.sleep, IDLE))
            return seconds / wall

        make = partial(
            ps.make_dataset,
            configuration,
            f"file://{path.resolve()}",
            scheduler=cluster.scheduler_address,
        )
        make(count=workers * configuration.samples_per_geometry)  # loads and compiles
        shutil.rmtree(path)
        idle = watching()
        of_workers, of_client, wall = taken(partial(make, count=samples))
        idle = (idle + watching()) / 2
        megabytes = max(client.run(_peak).values())
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    shutil.rmtree(path)
    blocks = samples // configuration.samples_per_shard
    of_blocks = of_client - idle * wall
    return Cost(of_workers, of_blocks, idle, megabytes, blocks, samples, size)


def _peak() -> float:
    """Return the most memory that this process has taken, in MB."""
    import resource  # where this page is opened, Windows has none

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
