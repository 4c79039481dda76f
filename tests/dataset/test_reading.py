import json
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from periscopy_sim.dataset.make import make_dataset
from periscopy_sim.dataset.reading import describe, read_head, verify_dataset
from periscopy_sim.errors import DatasetError


@pytest.fixture
def data(whole, tmp_path):
    path = tmp_path / "data.zarr"
    shutil.copytree(whole, path)
    return path


def test_variables_have_labelled_dimensions_units_and_provenance(whole):
    data = ps.open_dataset(whole)
    assert data.sizes["sample"] == 46
    assert data.photograph.dims == ("sample", "row", "column", "channel")
    assert data.hidden.dims == ("sample", "hidden_row", "hidden_column", "channel")
    assert data.photograph.dtype == np.float32 and data.photograph.attrs["units"]
    assert data.channel.values.tolist() == ["red", "green", "blue"]
    configuration = json.loads(data.attrs["configuration"])
    assert configuration["seed"] == 3
    assert configuration["scenes"][0]["version"]
    assert {"mitsuba", "variant", "numpy"} <= set(json.loads(data.attrs["versions"]))
    assert np.isfinite(data.photograph.values).all()


@pytest.mark.thorough
def test_light_that_bounces_adds_its_error_to_the_samples(configured, whole, tmp_path, monkeypatch):
    """One round of paths tells little of it."""
    monkeypatch.setattr("periscopy_sim.rendering.bounced.ROUNDS", 1)
    scenes = [{"scene": "bright_room", "parameters": {"resolution": 12}}]
    light, path = {"kind": "bounced"}, tmp_path / "bounced.zarr"
    with pytest.warns(RuntimeWarning, match="'bright_room': light that bounces"):
        make_dataset(configured(count=30, light=light, scenes=scenes), path)
    error = ps.open_dataset(path).bounced_error
    assert error.dims == ("sample",) and error.dtype == np.float64 and error.attrs["units"] == "1"
    assert (error > 2e-4).all() and describe(path)["bounced_error"][0] == error.min()
    assert "bounced_error" not in ps.open_dataset(whole).variables


def test_a_data_set_is_a_sequence_of_frames(whole):
    data = ps.open_dataset(whole)
    frames = ps.open_frames(whole, (16, 16))
    np.testing.assert_array_equal([frame.values for frame in frames], data.photograph)


def test_unfinished_data_set_is_refused_unless_asked_for(data, configured):
    read_head(data)[2].file((2,)).unlink()
    with pytest.raises(DatasetError, match="not finished, 20 of 46"):
        ps.open_dataset(data)
    assert ps.open_dataset(data, incomplete=True).sizes["sample"] == 20
    make_dataset(configured(), data)
    assert ps.open_dataset(data).sizes["sample"] == 46


def test_damaged_chunk_is_an_error_not_a_sample(data):
    file = data / "photograph/c/1/0/0/0"
    content = bytearray(file.read_bytes())
    content[100] ^= 4
    file.write_bytes(content)
    opened = ps.open_dataset(data)
    opened.photograph[:10].values  # noqa: B018 (other blocks are whole)
    with pytest.raises(Exception, match=r"(?i)checksum|crc"):
        opened.photograph[10].values  # noqa: B018


def test_verification_lists_damaged_and_missing_samples(data):
    file = data / "ambient/c/3"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    read_head(data)[2].file((1,)).unlink()
    assert verify_dataset(data) == [(10, 20), (30, 40)]
    read_head(data)[2].file((2,)).unlink()
    assert verify_dataset(data) == [(10, 40)]
    shutil.rmtree(data / "sbr")
    with pytest.raises(DatasetError, match="sbr"):
        verify_dataset(data)


def test_description_counts_what_there_is(data):
    found = describe(data)
    assert (found["samples"], found["finished"], found["geometries"]) == (46, 46, 3)
    assert sum(found["split"].values()) == sum(found["ambient"].values()) == 46
    assert found["photograph"] == [16, 16] and found["hidden"] == [3, 4]
    assert found["snr"][0] >= 10 and found["snr"][1] <= 20
    read_head(data)[2].file((4,)).unlink()
    assert describe(data)["finished"] == 40
    assert sum(describe(data)["split"].values()) == 40


def test_torch_data_sets_are_public_without_pytorch_and_say_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    assert "TorchDataset" in ps.__all__ and hasattr(ps, "TorchDataset")
    with pytest.raises(ps.PeriscopyError, match=r"pip install -e '\.\[torch\]'"):
        ps.TorchDataset("data.zarr")


def test_torch_data_sets_take_one_number(monkeypatch, whole):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(as_tensor=np.asarray))
    samples = ps.TorchDataset(whole)
    photographs = ps.open_dataset(whole).photograph.values
    for number in (1, np.int32(1), np.array(1), -45):
        np.testing.assert_array_equal(samples[number]["photograph"][2], photographs[1, ..., 2])
    assert len(samples.__getitems__(np.array([1, -1]))) == 2
    for wrong in ([0, 1], np.array([0, 1]), np.array([1]), [-1], (0,), slice(2), 1.0):
        with pytest.raises(TypeError, match="integer"):
            samples[wrong]
    with pytest.raises(IndexError):
        samples[46]


def check_refused(path, said):
    for opens in (ps.open_dataset, verify_dataset, describe):
        with pytest.raises(DatasetError, match=said):
            opens(path)


def test_attributes_that_others_wrote_are_refused(data):
    texts, head = (None, '{"seed": 3}', {"seed": 3}, [1]), data / "zarr.json"
    wrong = [(name, each) for name in ("layout", "configuration", "versions") for each in texts]
    whole = json.loads(head.read_text())
    for name, value in [*wrong, *(("count", n) for n in (True, -1, 0, "46", 10**9, 10**30, None))]:
        head.write_text(json.dumps(whole | {"attributes": whole["attributes"] | {name: value}}))
        check_refused(data, "attributes|too small")


@pytest.mark.filterwarnings("ignore")  # text of any length is not in Zarr's standard
def test_what_xarray_saved_or_appended_to_is_refused(data, tmp_path):
    opened = ps.open_dataset(data)
    opened.to_zarr(tmp_path / "copy.zarr")
    nested = xr.open_zarr(data, consolidated=False, chunks=None).drop_encoding()
    nested.to_zarr(tmp_path / "whole.zarr")
    opened.isel(sample=slice(2)).to_zarr(data, append_dim="sample")
    for path in (tmp_path / "copy.zarr", tmp_path / "whole.zarr", data):
        check_refused(path, "attributes")


def test_what_is_no_data_set_is_refused(tmp_path):
    check_refused(tmp_path / "none.zarr", "none.zarr: is no data set")
    for head in ("", "{}", "[]", '{"attributes": {"kind": "sweep", "count": 1}}'):
        (tmp_path / "zarr.json").write_text(head)
        check_refused(tmp_path, f"{tmp_path}: is no data set")
