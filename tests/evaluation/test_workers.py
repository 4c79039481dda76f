import socket
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.workers import check_scheduler, compute, connect
from periscopy_sim.storage.places import place


def test_scheduler_that_does_not_answer_is_one_line(capfd):
    refused = pytest.raises(PeriscopyError, match="nonsense://x")
    with refused as error, connect("nonsense://x"):
        pass
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_port_that_says_nothing_is_one_line_in_time(monkeypatch):
    monkeypatch.setattr("periscopy_sim.evaluation.workers.CONNECTING", 0.2)
    one_line = pytest.raises(PeriscopyError, match="no Dask scheduler")
    with socket.create_server(("127.0.0.1", 0)) as mute, one_line:
        check_scheduler("tcp://127.0.0.1:{1}".format(*mute.getsockname()))


def test_workers_of_another_version_are_refused(monkeypatch):
    from distributed import Client, LocalCluster

    local = {"n_workers": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**local) as cluster:
        with connect(cluster.scheduler_address):
            pass

        async def other(*_, **__):
            return {"tcp://far:1": {"periscopy-sim": "0.0", "mitsuba": "3.0"}}

        monkeypatch.setattr(Client, "run", other)
        refused = pytest.raises(PeriscopyError, match="tcp://far:1")
        with refused, connect(cluster.scheduler_address):
            pass


def test_workers_without_what_opens_a_store_are_refused(monkeypatch):
    from distributed import LocalCluster

    local = {"n_workers": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**local) as cluster:
        out = place("s3://lab/data.zarr")
        check_scheduler(cluster.scheduler_address, out)
        monkeypatch.setitem(sys.modules, "upath", None)
        with pytest.raises(PeriscopyError, match=r"a Dask worker .*pip install -e '\.\[s3\]'"):
            check_scheduler(cluster.scheduler_address, out)


def test_a_url_of_another_machine_is_no_folder():
    assert place("file://localhost/a/b") == place("file:///a/b") == Path("/a/b").absolute()
    with pytest.raises(PeriscopyError, match="machine shared"):
        place("file://shared/b")


def sums(arrays, item):
    return arrays[item].flags.aligned, arrays[item].mean()


def test_arrays_that_travel_keep_the_bits_of_their_sums():
    from distributed import LocalCluster

    rng = np.random.default_rng(3)
    arrays = tuple(rng.uniform(1, 2, (126, 126, 3)) for _ in range(8))
    with (
        LocalCluster(
            n_workers=1, processes=False, protocol="tcp://", dashboard_address="127.0.0.1:0"
        ) as cluster,
        connect(cluster.scheduler_address) as client,
    ):
        found = dict(compute(client, sums, arrays, range(8)))
        with pytest.raises(PeriscopyError, match="pickle"):
            next(compute(client, sums, threading.Lock(), range(8)))
    means = {item: (True, arrays[item].mean()) for item in range(8)}
    assert found == means  # the same bits


class Started:
    def __init__(self):
        self.items = []


def blas_threads(started, item):
    started.items.append(item)
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_few_tasks_are_in_flight_and_linear_algebra_has_one_thread(monkeypatch):
    monkeypatch.setattr("periscopy_sim.evaluation.workers.IN_FLIGHT", 3)
    started, taken = Started(), []
    with threadpool_limits(2):
        assert blas_threads(Started(), None) == {2}
    with threadpool_limits(2), connect(None) as client:
        for item, threads in compute(client, blas_threads, started, range(20)):
            time.sleep(0.02)  # the workers would be far ahead
            assert threads == {1}
            taken.append(item)
            assert len(started.items) <= len(taken) + 3
    assert sorted(taken) == sorted(started.items) == list(range(20))


def fail(shared, item):
    raise ValueError(f"{shared} {item}")


def test_what_a_task_raises_is_raised_in_silence(caplog, capfd):
    with pytest.raises(ValueError, match="no 3"), connect(None) as client:
        list(compute(client, fail, "no", [3]))
    assert capfd.readouterr() == ("", "") and caplog.records == []


def nap(shared, item):  # noqa: ARG001
    time.sleep(0.05)
    return shared


@pytest.mark.parametrize("begun", [False, True])
def test_a_scheduler_lost_midway_is_one_line_that_says_what_goes_on(begun, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr("periscopy_sim.evaluation.workers.CONNECTING", 0.5)

    local = {"n_workers": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
    lost = pytest.raises(PeriscopyError, match="begin again")
    with LocalCluster(protocol="tcp://", **local) as cluster:
        with lost as error, connect(cluster.scheduler_address) as client:
            if not begun:
                cluster.close()
            for _ in compute(client, nap, None, range(400)):
                cluster.close()
        assert "\n" not in str(error.value)
