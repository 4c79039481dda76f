import pickle

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.dataset.make import make_dataset
from periscopy_sim.errors import DatasetError

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module", autouse=True)
def torch():
    return pytest.importorskip("torch")


@pytest.fixture(scope="module")
def path(configured, tmp_path_factory):
    out = tmp_path_factory.mktemp("torch") / "data.zarr"
    settings = configured(
        splits={"train": 0.5, "validation": 0.25, "test": 0.25}, count=80, samples_per_geometry=10
    )
    make_dataset(settings, out)
    return out


def test_splits_are_apart_and_make_up_the_whole(path):
    parts = [ps.TorchDataset(path, split) for split in ("train", "validation", "test")]
    indices = np.concatenate([part.samples for part in parts])
    assert sorted(indices.tolist()) == list(range(80))
    data = ps.open_dataset(path)
    assert set(data.split.values[parts[1].samples]) == {"validation"}


@pytest.mark.parametrize("start", [None, "spawn", "fork"])
def test_loaders_feed_every_sample_once_in_batches(torch, path, start):
    samples = ps.TorchDataset(
        path, variables=("photograph", "hidden", "sbr", "ambient", "clip_number")
    )
    samples[0]  # opened here, before any fork
    settings = {"multiprocessing_context": start, "num_workers": 2} if start else {}
    loader = torch.utils.data.DataLoader(
        samples, batch_size=16, shuffle=True, timeout=60 if start else 0, **settings,
        generator=torch.Generator().manual_seed(0),
    )  # fmt: skip
    batches = list(loader)
    data = ps.open_dataset(path)
    assert [len(batch["sbr"]) for batch in batches] == [16] * 5
    clips = torch.cat([batch["clip_number"] for batch in batches]).numpy()
    assert sorted(clips.tolist()) == sorted(data.clip_number.values.tolist())
    means = torch.cat([batch["photograph"].mean(dim=(1, 2, 3)) for batch in batches]).numpy()
    np.testing.assert_allclose(
        np.sort(means), np.sort(data.photograph.values.mean(axis=(1, 2, 3))), rtol=1e-5
    )
    assert set(batches[0]["ambient"]) <= {"lamps", "none"}


def test_transform_is_applied_and_the_archive_is_left_behind_when_pickled(torch, path):
    samples = ps.TorchDataset(path, variables=("sbr",), transform=dict.keys)
    assert list(samples[0]) == ["sbr"]
    plain = ps.TorchDataset(path)
    plain[0]
    pickled = pickle.dumps(plain)
    assert len(pickled) < 10_000
    again = pickle.loads(pickled)
    assert torch.equal(again[7]["hidden"], plain[7]["hidden"])


def test_unknown_splits_and_variables_are_named(path):
    with pytest.raises(DatasetError, match="no samples of split 'tset'; it has test, train"):
        ps.TorchDataset(path, "tset")
    for name in ("depth", "geometry_scene", "channel"):
        with pytest.raises(DatasetError, match=f"no variable '{name}'"):
            ps.TorchDataset(path, variables=("photograph", name))
