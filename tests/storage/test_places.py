"""Results on an object store: an S3 server on this machine."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.dataset.configuration import Configuration
from periscopy_sim.dataset.make import make_dataset
from periscopy_sim.dataset.reading import open_dataset, verify_dataset
from periscopy_sim.errors import DatasetError, OutputError, PeriscopyError
from periscopy_sim.evaluation.sweep import Sweep, World, run_sweep
from periscopy_sim.evaluation.sweep_store import read_sweep
from periscopy_sim.storage.places import place, put
from periscopy_sim.storage.store import BlockStore, Records, StoreLayout
from tests.scenes.contents import contents

moto = pytest.importorskip("moto.server")
pytest.importorskip("s3fs")

CONFIGURATION = Configuration.model_validate(
    {
        "count": 26,
        "hidden": "3x4",
        "samples_per_geometry": 20,
        "samples_per_shard": 10,
        "scenes": [{"scene": "plate", "parameters": {"resolution": 16}}],
        "hidden_images": [{"kind": "shapes"}],
        "ambient": [{"kind": "lamps"}],
        "light": {"kind": "direct", "samples": 16},
        "snr": {"uniform": [10, 20]},
    }
)

pytestmark = pytest.mark.usefixtures("server")


@pytest.fixture(scope="module")
def server():
    """The server; what it holds outlives its stops."""
    of_module = pytest.MonkeyPatch()
    first = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    first.start()
    host, port = first.get_host_and_port()
    of_module.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    of_module.setenv("AWS_ACCESS_KEY_ID", "any")
    of_module.setenv("AWS_SECRET_ACCESS_KEY", "any")
    of_module.setenv("AWS_DEFAULT_REGION", "us-east-1")
    of_module.setenv("AWS_MAX_ATTEMPTS", "1")
    running = SimpleNamespace(server=first)

    def start():
        running.server = moto.ThreadedMotoServer(host, port, verbose=False)
        running.server.start()

    running.stop, running.start = lambda: running.server.stop(), start
    import s3fs

    s3fs.S3FileSystem().mkdir("lab")
    yield running
    running.stop()
    of_module.undo()


def held(url):
    """The bytes of each object below a URL by its name there."""
    top = place(url)
    files = (each for each in top.rglob("*") if each.is_file())
    return {str(each)[len(url) + 1 :]: each.read_bytes() for each in files}


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    path = tmp_path_factory.mktemp("local") / "data.zarr"
    make_dataset(CONFIGURATION, path)
    return contents(path)


def test_a_data_set_has_the_bytes_of_one_in_a_folder(local):
    url = "s3://lab/sets/whole.zarr"
    assert make_dataset(CONFIGURATION, url, count=13).made == 13
    with pytest.raises(DatasetError, match="is not finished"):
        place(f"{url}/making/finished/00000001.json").unlink()
        open_dataset(url)
    assert make_dataset(CONFIGURATION, url).made == 16
    assert held(url) == local
    assert open_dataset(url).sizes["sample"] == 26
    place(f"{url}/photograph/c/2/0/0/0").write_bytes(b"damaged")
    assert verify_dataset(url) == [(20, 26)]


def test_an_epoch_in_any_order_reads_each_byte_about_once(local, monkeypatch):
    import s3fs

    url, read, sizes = "s3://lab/sets/read.zarr", s3fs.S3FileSystem._cat_file, []
    for name, data in local.items():
        put(place(url) / name, data)

    async def counted(*given, **how):
        data = await read(*given, **how)
        sizes.append(len(data))
        return data

    photographs = open_dataset(url).photograph.variable
    monkeypatch.setattr(s3fs.S3FileSystem, "_cat_file", counted)
    for k in np.random.default_rng(0).permutation(26):
        photographs[int(k)].values  # noqa: B018
    stored = sum(len(data) for name, data in local.items() if name.startswith("photograph/c"))
    assert stored / 2 < sum(sizes) <= 1.2 * stored


def test_a_shared_folder_is_a_store(local, tmp_path):
    make_dataset(CONFIGURATION, f"file://{tmp_path}/data.zarr")
    assert contents(tmp_path / "data.zarr") == local


def test_a_store_cut_off_midway_is_one_line_and_the_rest_is_made_later(server, local):
    url, reports = "s3://lab/sets/cut.zarr", []

    def cut(done, _):
        reports.append(done)
        if done == 10:
            server.stop()

    with pytest.raises(OutputError, match="cannot use s3://") as failed:
        make_dataset(CONFIGURATION, url, progress=cut)
    assert "\n" not in str(failed.value)
    server.start()
    assert make_dataset(CONFIGURATION, url).made == 16
    assert held(url) == local


@pytest.mark.thorough
def test_workers_that_die_leave_nothing_half_written(local):
    distributed = pytest.importorskip("distributed")
    url, killed = "s3://lab/sets/killed.zarr", threading.Event()
    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(silence_logs=50, **settings) as cluster:

        def kill(done, _):
            """Kill all workers, and with them what they were sent; others come."""
            if done and not killed.is_set():
                killed.set()
                for worker in cluster.workers.values():
                    worker.process.process._process.kill()

        address = cluster.scheduler_address
        assert make_dataset(CONFIGURATION, url, scheduler=address, progress=kill).made == 26
    assert killed.is_set()
    assert held(url) == local


def test_a_sweep_has_the_bytes_of_one_in_a_folder(tmp_path):
    rng = np.random.default_rng(5)
    signal, truth, light = (
        rng.uniform(0.5, 1, shape) for shape in ((6, 7, 3), (3, 4, 3), (6, 7, 3))
    )
    method = SimpleNamespace(reconstruct=lambda photograph: photograph[:3, :4])
    world = World({"p": signal}, {"p": truth}, {"lamp": light}, {"corner": method})
    folder = tmp_path / "sweep"
    run_sweep(Sweep(world, [0.1, 1]), folder)
    run_sweep(Sweep(world, [0.1]), "s3://lab/sweep")
    found = run_sweep(Sweep(world, [0.1, 1]), "s3://lab/sweep")
    assert held("s3://lab/sweep") == contents(folder)
    assert read_sweep(place("s3://lab/sweep/sweep.zarr")).equals(found)


def store(url):
    variable = {"shape": (4,), "chunks": (2,), "dtype": float, "dimension_names": ("k",)}
    layout = StoreLayout("sweep", {"x": {**variable, "fill_value": np.nan}}, {"k": (4, 2)})
    return BlockStore(place(url), layout, {"seed": 1}, {})


def test_a_second_command_takes_nothing_from_the_first(monkeypatch):
    first, record = store("s3://lab/two.zarr"), Records.write

    def late(*of_first):
        store("s3://lab/two.zarr")
        record(*of_first)

    monkeypatch.setattr(Records, "write", late)
    first.write((0,), {"x": np.ones(2)})
    assert store("s3://lab/two.zarr").records.verify((0,))


def test_a_fault_of_the_store_costs_no_record(monkeypatch):
    store("s3://lab/fault.zarr").write((0,), {"x": np.ones(2)})

    def refused(*_, **__):
        raise PermissionError("token expired")

    with monkeypatch.context() as of_fault:
        of_fault.setattr(place("s3://lab").fs, "cat_file", refused)
        with pytest.raises(OutputError, match="token expired"):
            store("s3://lab/fault.zarr")
    assert [*store("s3://lab/fault.zarr").missing()] == [(1,)]


def test_a_bucket_that_vanishes_is_one_line():
    import s3fs

    s3fs.S3FileSystem().mkdir("brief")
    begun = store("s3://brief/data.zarr")
    s3fs.S3FileSystem().rm("brief", recursive=True)
    with pytest.raises(OutputError, match=r"cannot use s3://brief/.*does not exist"):
        begun.write((0,), {"x": np.ones(2)})


@pytest.mark.parametrize("url", ["s3://none/data.zarr", "nowhere://lab/data.zarr"])
def test_a_place_that_no_one_has_is_said(url):
    with pytest.raises(PeriscopyError, match=url):
        make_dataset(CONFIGURATION, url)
