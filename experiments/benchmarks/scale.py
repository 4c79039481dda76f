"""What a data set costs on worker processes, and what the scheduler adds to each block.

The example's configuration, made by 1, 2, 4 and 8 worker processes of one thread each, which write
their blocks to `file://` themselves, as to an object store. Processor seconds are compared, not
the wall's: eight workers on few cores wait for each other. Scheduler, client and what watches the
workers are one process here. What it takes while nobody works is stated apart: it grows with the
wall's seconds, not with blocks.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import periscopy_sim as ps
from experiments.page import described, processor_seconds
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import Setting
from periscopy_sim.dataset.configuration import EXAMPLE

WORKERS = 1, 2, 4, 8
GEOMETRIES, IDLE = 8, 10.0
GOAL = 0.05
"""Of a block's time, what the scheduler may add."""


def scale(setting: Setting) -> Section:
    """Make the same data set by more and more workers."""
    rows, overheads = [], []
    for workers in WORKERS:
        found = _made(setting.out / "scale.zarr", workers)
        of_workers, of_blocks, idle, megabytes, blocks, samples, size = found
        overheads.append(of_blocks / of_workers)
        rows.append(
            (
                str(workers),
                f"{1e3 * of_workers / samples:.1f}",
                f"{1e3 * of_workers / blocks:.0f}",
                f"{1e3 * of_blocks / blocks:.0f}",
                f"{100 * overheads[-1]:.1f} %",
                f"{1e3 * idle:.0f}",
                f"{megabytes:.0f}",
                f"{size / samples / 1e3:.0f}",
            )
        )
    return Section(
        "scale",
        "A data set on worker processes",
        text=described(__doc__),
        claims=[
            Claim(
                f"what scheduler and client add to a block, {WORKERS[-1]} workers",
                f"at most {100 * GOAL:g} %",
                f"{100 * overheads[-1]:.1f} %",
                Verdict.of(overheads[-1] <= GOAL),
            )
        ],
        tables=[
            Table(
                "Processor milliseconds, and kilobytes of a sample.",
                (
                    "workers",
                    "a sample",
                    "a block",
                    "scheduler and client, a block",
                    "share",
                    "watching, a second",
                    "MB of a worker",
                    "kB",
                ),
                rows,
            )
        ],
    )


def _made(path: Path, workers: int) -> tuple[float, float, float, float, int, int, int]:
    """Return what making a data set takes.

    Processor seconds of workers, of this process but for its watching, and of that a second;
    the most memory of a worker in MB, blocks, samples and bytes.
    """
    from distributed import Client, LocalCluster

    shutil.rmtree(path, ignore_errors=True)
    configuration = ps.load_configuration(EXAMPLE)
    samples = GEOMETRIES * configuration.samples_per_geometry
    local = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**local) as cluster, Client(cluster) as client:

        def taken() -> tuple[float, float, float]:
            of_workers = sum(client.run(processor_seconds).values())
            return of_workers, processor_seconds(), time.perf_counter()

        def watching() -> float:
            before = taken()
            time.sleep(IDLE)
            _, seconds, wall = np.subtract(taken(), before)
            return float(seconds / wall)

        def make(count: int) -> Sequence[float]:
            before = taken()
            url = f"file://{path.resolve()}"
            ps.make_dataset(configuration, url, count=count, scheduler=cluster.scheduler_address)
            return [float(each) for each in np.subtract(taken(), before)]

        make(workers * configuration.samples_per_geometry)  # loads and compiles
        shutil.rmtree(path)
        idle = watching()
        of_workers, of_client, wall = make(samples)
        idle = (idle + watching()) / 2
        megabytes = max(client.run(_peak).values())
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    shutil.rmtree(path)
    blocks = samples // configuration.samples_per_shard
    return of_workers, of_client - idle * wall, idle, megabytes, blocks, samples, size


def _peak() -> float:
    """Return the most memory that this process has taken, in MB."""
    import resource  # where this page is opened, Windows has none

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
