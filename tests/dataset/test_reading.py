import json
import shutil

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.dataset.layout import read_head
from periscopy_sim.dataset.make import make_dataset
from periscopy_sim.dataset.reading import Damage, describe, verify_dataset
from periscopy_sim.errors import DatasetError, OutputError
from periscopy_sim.storage.outputs.store import record_file


@pytest.fixture(scope="module")
def whole(configured, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "data.zarr"
    make_dataset(configured(), path)
    return path


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
    assert data.attrs["configuration"]["seed"] == 3
    assert data.attrs["configuration"]["scenes"][0]["version"]
    assert {"mitsuba", "variant", "numpy"} <= set(data.attrs["versions"])
    assert np.isfinite(data.photograph.values).all()


def test_labels_select_samples(whole):
    data = ps.open_dataset(whole)
    dark = data.sel(sample=data.ambient == "none")
    assert 0 < dark.sizes["sample"] < 46
    assert np.isinf(dark.sbr.values).all() and (dark.background.values == 0).all()


@pytest.fixture
def bounced(doubtful, tmp_path):
    path = tmp_path / "bounced.zarr"
    with pytest.warns(RuntimeWarning):
        make_dataset(doubtful, path)
    return path


def test_samples_of_light_that_bounces_alone_tell_its_error(bounced, whole):
    data = ps.open_dataset(bounced)
    assert data.bounced_error.dims == ("sample",) and "bounced_error" in data.coords
    assert data.bounced_error.dtype == np.float64 and data.bounced_error.attrs["units"] == "1"
    assert (data.bounced_error > 2e-4).all() and data.bounced_error.size == 30
    assert describe(bounced)["bounced_error"][0] == data.bounced_error.min()
    assert verify_dataset(bounced) == (30, [])
    direct = ps.open_dataset(whole)  # with the head that it had before there was that error
    assert "bounced_error" not in {*direct.variables, *direct.attrs["layout"]}


@pytest.fixture
def older(bounced):
    """Return a data set as it was made before it told that error."""
    shutil.rmtree(bounced / "bounced_error")
    head = json.loads((bounced / "zarr.json").read_text())
    del head["attributes"]["layout"]["bounced_error"]
    (bounced / "zarr.json").write_text(json.dumps(head))
    for number in range(3):
        record = json.loads(record_file(bounced, number).read_text())
        del record["crc32c"]["bounced_error"]
        record["of"] = read_head(bounced)[2]
        record_file(bounced, number).write_text(json.dumps(record))
    return bounced


def test_data_set_from_before_the_error_was_told_is_read_but_not_added_to(older, doubtful):
    assert ps.open_dataset(older).photograph.shape[0] == 30
    assert verify_dataset(older) == (30, [])
    assert "bounced_error" not in describe(older)
    with pytest.raises(OutputError, match=r"\(layout.bounced_error unset, here true\)"):
        make_dataset(doubtful, older)


def test_unfinished_data_set_is_refused_unless_asked_for(data, configured):
    record_file(data, 2).unlink()
    with pytest.raises(DatasetError, match="not finished, 20 of 46"):
        ps.open_dataset(data)
    assert ps.open_dataset(data, incomplete=True).sizes["sample"] == 20
    make_dataset(configured(), data)
    assert ps.open_dataset(data).sizes["sample"] == 46


def test_data_set_that_grows_never_passes_for_whole_before_it_is(data, configured, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("periscopy_sim.dataset.make.BlockStore.write", stop)
    with pytest.raises(KeyboardInterrupt):
        make_dataset(configured(), data, count=50)
    with pytest.raises(DatasetError, match="not finished, 40 of 50"):
        ps.open_dataset(data)
    assert describe(data)["finished"] == 40
    monkeypatch.undo()
    make_dataset(configured(), data, count=50)
    assert np.isfinite(ps.open_dataset(data).photograph.values).all()


@pytest.mark.parametrize("lost", ["parameter_occluder_dx", "channel"])
def test_verification_misses_what_is_not_of_samples_too(data, lost):
    (data / lost / "c/0").unlink()
    assert verify_dataset(data) == (0, [Damage((0, 46), f"{lost}: its file is missing")])


def test_variable_that_is_lost_is_told(data):
    shutil.rmtree(data / "sbr")
    assert verify_dataset(data)[1][0].reason == "sbr: is missing"
    with pytest.raises(DatasetError, match="'sbr' is lost"):
        describe(data)


def test_damaged_chunk_is_an_error_not_a_sample(data):
    file = data / "photograph/c/1/0/0/0"
    content = bytearray(file.read_bytes())
    content[100] ^= 4
    file.write_bytes(content)
    opened = ps.open_dataset(data)
    opened.photograph[:10].values  # noqa: B018 (other blocks are whole)
    with pytest.raises(Exception, match=r"(?i)checksum|crc"):
        opened.photograph[10].values  # noqa: B018


def test_whole_data_set_is_verified(whole):
    steps = []
    assert verify_dataset(whole, lambda *step: steps.append(step)) == (46, [])
    assert steps[-1] == (5, 5)


@pytest.mark.parametrize("name", ["photograph", "hidden", "sbr", "ambient"])
def test_verification_names_damaged_and_missing_blocks(data, name):
    file = data / name / ("c/3/0/0/0" if name in ("photograph", "hidden") else "c/3")
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    record_file(data, 1).unlink()
    whole, damaged = verify_dataset(data)
    assert whole == 26
    assert [d.samples for d in damaged] == [(10, 20), (30, 40)]
    assert damaged[0].reason == "missing" and damaged[1].reason.startswith(f"{name}: ")


def test_neighbouring_blocks_that_miss_are_told_as_one(data):
    for block in (1, 2, 4):
        record_file(data, block).unlink()
    _, damaged = verify_dataset(data)
    assert [(d.samples, d.reason) for d in damaged] == [
        ((10, 30), "missing"),
        ((40, 46), "missing"),
    ]


def test_description_counts_what_there_is(data):
    found = describe(data)
    assert (found["samples"], found["finished"], found["geometries"]) == (46, 46, 3)
    assert sum(found["split"].values()) == sum(found["ambient"].values()) == 46
    assert found["photograph"] == [16, 16] and found["hidden"] == [3, 4]
    assert found["snr"][0] >= 20 and found["snr"][1] <= 60
    record_file(data, 4).unlink()
    assert describe(data)["finished"] == 40
    assert sum(describe(data)["split"].values()) == 40


def test_what_is_no_data_set_is_refused(tmp_path):
    for opens in (ps.open_dataset, verify_dataset, describe):
        with pytest.raises(DatasetError, match="no such data set"):
            opens(tmp_path / "none.zarr")
        with pytest.raises(DatasetError, match="is no data set"):
            opens(tmp_path)
