import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.dataset import make as making
from periscopy_sim.dataset.make import make_dataset
from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.rendering import ambient as ambient
from periscopy_sim.shipped import find_scene
from tests.scenes.contents import contents


def test_growing_ends_in_the_same_bytes(configured, whole, tmp_path):
    path = tmp_path / "data.zarr"
    assert make_dataset(configured(), path, count=13).made == 13
    assert make_dataset(configured(), path, count=20).made == 10  # a block of 3 is made anew
    assert make_dataset(configured(), path).made == 26
    assert contents(path) == contents(whole)


def test_a_camera_of_four_channels_is_announced_by_its_size(configured, tmp_path):
    np.save(tmp_path / "y.npy", np.ones((16, 16, 4), np.float32))
    pictures = [{"kind": "pictures", "files": [str(tmp_path / "y.npy")]}]
    settings = configured(
        ambient=pictures, colour_matrix=[*np.eye(3).tolist(), (1, 0, 0)], count=20
    )
    plans, seconds = [], []
    path = tmp_path / "data.zarr"
    make_dataset(settings, path, planned=plans.append, estimated=seconds.append)
    data = ps.open_dataset(path)
    images = [data[name].nbytes for name in ("photograph", "background", "hidden")]
    assert plans[0].size == sum(images) and seconds[0] > 0


class Stopped(BaseException):
    pass


def test_stopped_run_goes_on_where_it_was(configured, whole, tmp_path, monkeypatch):
    path, written = tmp_path / "data.zarr", []
    write = making.BlockStore.write

    def stop(archive, block, values):
        if len(written) == 3:
            raise Stopped
        written.append(block)
        write(archive, block, values)

    monkeypatch.setattr(making.BlockStore, "write", stop)
    with pytest.raises(Stopped):
        make_dataset(configured(), path)
    monkeypatch.undo()
    assert make_dataset(configured(), path).made == 46 - 30
    assert contents(path) == contents(whole)


def test_workers_of_a_dask_cluster_make_the_same_bytes(configured, whole, tmp_path):
    distributed = pytest.importorskip("distributed")
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(processes=False, silence_logs=50, **local) as cluster:
        make_dataset(configured(), tmp_path / "d.zarr", scheduler=cluster.scheduler_address)
    assert contents(tmp_path / "d.zarr") == contents(whole)


SIZES = [{"scene": "plate", "parameters": {"resolution": {"choice": [16, 20]}}}]


def test_what_does_not_exist_is_refused_before_anything_is_written(configured, tmp_path):
    for changes, message in [
        ({"scenes": [{"scene": "nowhere"}]}, "nowhere"),
        ({"scenes": [{"scene": "chair", "parameters": {"dx": 1}}]}, "'dx'"),
        ({"hidden_images": [{"kind": "folder", "folder": "none"}]}, "none"),
        ({"ambient": [{"kind": "conditions", "names": ["disco"]}]}, "'disco'"),
        ({"ambient": [{"kind": "pictures", "files": ["none.exr"]}]}, "none.exr"),
        ({"hidden": "200x200"}, "16x16"),
        ({"scenes": SIZES, "count": 400}, r"geometry \d+"),
    ]:
        settings = configured(**changes).model_copy(update={"folder": tmp_path})
        with pytest.raises(PeriscopyError, match=message):
            make_dataset(settings, tmp_path / "d.zarr")
        assert not (tmp_path / "d.zarr").exists() or changes.get("scenes") == SIZES


def test_other_pictures_under_the_same_name_are_another_data_set(configured, tmp_path):
    settings = configured(
        hidden_images=[{"kind": "folder", "folder": "pictures"}], count=2
    ).model_copy(update={"folder": tmp_path})
    (tmp_path / "pictures").mkdir()
    for value in (255, 0):
        image = np.array([[[255, value, value]]], np.uint8)
        Image.fromarray(image).save(tmp_path / "pictures/a.png")
        make_dataset(settings, tmp_path / f"{value}.zarr")
        hidden = ps.open_dataset(tmp_path / f"{value}.zarr").hidden.values
        assert (hidden[..., 0] == 1).all() and (hidden[..., 1] == value / 255).all()
    assert make_dataset(settings, tmp_path / "0.zarr").made == 0
    with pytest.raises(OutputError, match="holds another data set"):
        make_dataset(settings, tmp_path / "255.zarr")


def test_given_ambient_light_is_read_checked_and_coloured(configured, tmp_path):
    light = np.random.default_rng(0).random((16, 16, 3)).astype(np.float32) + 1
    np.save(tmp_path / "light.npy", light)
    entry = {"kind": "pictures", "files": ["light.npy"], "flip": False}
    settings = configured(ambient=[entry], count=4).model_copy(update={"folder": tmp_path})
    make_dataset(settings, tmp_path / "d.zarr")
    found = ps.open_dataset(tmp_path / "d.zarr").background.values[0]
    np.testing.assert_allclose(found / found.mean(), light / light.mean(), rtol=1e-5)
    np.save(tmp_path / "light.npy", light[:8])
    with pytest.raises(PeriscopyError, match=r"light.npy.*8"):
        make_dataset(settings, tmp_path / "e.zarr")


@pytest.fixture
def rendered(monkeypatch):
    """Replace the rendering of ambient light by random numbers; return the names asked for."""
    calls = []

    def render(path, scenario, *, seed, **_):
        calls.append(path.stem)
        picture = np.random.default_rng(seed).random((*scenario.photograph_shape, 3)) + 1
        return ambient.Background(picture * scenario.view.reflectance, 0.0, 0.0)

    monkeypatch.setattr(ambient, "render_background", render)
    return calls


def test_rendered_conditions_are_kept_and_not_rendered_again(configured, tmp_path, rendered):
    entry = {"kind": "conditions", "names": ["overcast", "corridor"]}
    settings = configured(ambient=[entry])
    make_dataset(settings, tmp_path / "d.zarr", count=6)
    assert rendered == ["overcast", "corridor"]  # one wall, though three geometries
    make_dataset(settings, tmp_path / "d.zarr")
    assert rendered == ["overcast", "corridor"]


@pytest.mark.usefixtures("rendered")
def test_walls_of_many_colours_are_lit_alike_in_a_run_that_goes_on(configured, tmp_path):
    plate = find_scene("plate").read_text()
    plate = plate.replace('value="0.8"', 'value="$red, 0.5, 0.5"').replace(
        "<default", '<default name="red" value="0.5"/><default', 1
    )
    (tmp_path / "colours.xml").write_text(plate)
    np.save(tmp_path / "light.npy", np.ones((16, 16, 3)))
    parameters = {"red": {"uniform": [0.2, 0.9]}, "resolution": 16}
    settings = configured(
        scenes=[{"scene": "colours.xml", "parameters": parameters}],
        ambient=[
            {"kind": "conditions", "names": ["overcast"], "flip": False},
            {"kind": "pictures", "files": ["light.npy"]},
        ],
    ).model_copy(update={"folder": tmp_path})
    make_dataset(settings, tmp_path / "whole.zarr")
    for count in (20, 46):  # of geometry 0, of them all
        make_dataset(settings, tmp_path / "parts.zarr", count=count)
    assert contents(tmp_path / "parts.zarr") == contents(tmp_path / "whole.zarr")
    data = ps.open_dataset(tmp_path / "whole.zarr")
    red = data.parameter_red.values[data.geometry.values]
    lit = data.background.values.mean(axis=(1, 2))
    ratio = (lit[:, 0] / lit[:, 2]) / (red / 0.5)
    for source in ("overcast", "light"):
        assert np.ptp(ratio[data.ambient.values == source]) < 1e-4
