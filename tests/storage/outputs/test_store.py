"""A store that no crash can spoil, laid out as a small data set."""

import json

import numpy as np
import pytest

from periscopy_sim.dataset.layout import Layout, read_head
from periscopy_sim.errors import DatasetError, OutputError
from periscopy_sim.storage.outputs import store
from periscopy_sim.storage.outputs.store import (
    MAKING,
    BlockStore,
    digest_of,
    record_file,
)

SIZES = {
    "block": 3,
    "photograph_shape": [4, 5],
    "hidden_shape": [2, 3],
    "photograph_type": "float32",
    "keep_background": False,
}
ATTRIBUTES = {"kind": "periscopy data set", "layout": SIZES, "configuration": {"seed": 1}}


def layout(count=7):
    return Layout(count, 3, (4, 5), (2, 3), "float32", keep_background=False)


def block(number, size=3):
    rng = np.random.default_rng(number)
    text = np.dtypes.StringDType()
    return {
        "photograph": rng.random((size, 4, 5, 3)).astype(np.float32),
        "hidden": rng.random((size, 2, 3, 3)).astype(np.float32),
        **{name: rng.random(size) for name in ("signal_scale", "sbr", "snr", "exposure")},
        "clip_number": np.arange(size) + 3 * number,
        "frame": np.zeros(size, np.int32),
        "geometry": np.zeros(size, np.int32),
        "split": np.array(["train"] * size, text),
        "hidden_kind": np.array(["shapes"] * size, text),
        "ambient": np.array(["none"] * size, text),
    }


def file_of(path, name, number):
    return path / layout().block(number).files[name]


def check_place(path):
    store.check_place(path, Layout.what, Layout.recognizes)


def archive(path, count=7, attributes=ATTRIBUTES):
    (path / MAKING).mkdir(parents=True, exist_ok=True)
    labels = {"geometry_scene": ("geometries", ["chair"]), "channel": ("channel", list("rgb"))}
    return BlockStore(path, layout(count), attributes, labels)


def filled(path, count=7):
    made = archive(path, count)
    for number in made.missing():
        made.write(number, block(number))
    return made


def contents(path):
    return {
        str(file.relative_to(path)): file.read_bytes()
        for file in sorted(path.rglob("*")) if file.is_file()
    }  # fmt: skip


def test_what_is_written_is_read_and_the_last_block_is_cut_short(tmp_path):
    import zarr

    filled(tmp_path / "d")
    group = zarr.open_group(tmp_path / "d", mode="r")
    for name in block(0):
        whole = np.concatenate([block(number)[name] for number in range(3)])
        np.testing.assert_array_equal(group[name][:], whole[:7], err_msg=name)


def test_order_of_writing_and_a_second_writing_leave_the_same_bytes(tmp_path):
    filled(tmp_path / "a")
    made = archive(tmp_path / "b")
    for number in (2, 0, 2, 1):
        made.write(number, block(number))
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_growing_makes_the_last_block_anew_and_ends_in_the_same_bytes(tmp_path):
    filled(tmp_path / "d", 7)
    grown = archive(tmp_path / "d", 11)
    assert list(grown.missing()) == [2, 3]
    for number in (2, 3):
        grown.write(number, block(number))
    filled(tmp_path / "e", 11)
    assert contents(tmp_path / "d") == contents(tmp_path / "e")


def test_fewer_samples_than_there_are_are_refused(tmp_path):
    filled(tmp_path / "d", 11)
    with pytest.raises(OutputError, match="holds more than 7 samples"):
        archive(tmp_path / "d", 7)


@pytest.mark.thorough
@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "remove"])
def test_every_damaged_file_of_a_block_makes_it_unfinished(tmp_path, damage):
    filled(tmp_path / "d")
    rng = np.random.default_rng(0)
    for name in block(1):
        file = file_of(tmp_path / "d", name, 1)
        content = file.read_bytes()
        if damage == "remove":
            file.unlink()
        elif damage == "flip":
            flipped = bytearray(content)
            flipped[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(flipped)
        else:
            file.write_bytes(content[: 0 if damage == "empty" else len(content) // 2])
        assert list(archive(tmp_path / "d").missing()) == [1], name
        file.write_bytes(content)
    assert list(archive(tmp_path / "d").missing()) == []


@pytest.mark.parametrize("content", ["", "{", "[]", '{"samples": 3}', "null", '{"of": "x"}'])
def test_damaged_record_makes_its_block_unfinished(tmp_path, content):
    filled(tmp_path / "d")
    record_file(tmp_path / "d", 0).write_text(content)
    assert list(archive(tmp_path / "d").missing()) == [0]


@pytest.mark.thorough
def test_damaged_heads_are_written_anew(tmp_path):
    filled(tmp_path / "d")
    before = contents(tmp_path / "d")
    heads = [tmp_path / "d" / name for name in before if name.endswith(("zarr.json", "c/0"))]
    heads = [head for head in heads if head.name == "zarr.json" or "channel" in str(head)]
    assert len(heads) > 14
    for head in heads:
        for content in (b"", b"{", head.read_bytes().replace(b"1", b"2")):
            head.write_bytes(content)
            assert list(archive(tmp_path / "d").missing()) == []
            assert contents(tmp_path / "d") == before, head


def test_samples_of_other_attributes_are_neither_added_to_nor_believed(tmp_path):
    filled(tmp_path / "d")
    other = {**ATTRIBUTES, "configuration": {"seed": 2}}
    for _ in range(2):
        with pytest.raises(OutputError, match=r"another data set"):
            archive(tmp_path / "d", attributes=other)
        (tmp_path / "d/zarr.json").unlink(missing_ok=True)  # even if the head is lost


@pytest.mark.parametrize("change", [{"of": "0" * 16}, {"samples": -1}, {"crc32c": {}}])
@pytest.mark.parametrize("number", [0, 2])
def test_record_that_contradicts_the_head_is_made_anew(tmp_path, change, number):
    filled(tmp_path / "d")
    before = contents(tmp_path / "d")
    file = record_file(tmp_path / "d", number)
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    assert list(archive(tmp_path / "d").missing()) == [number]
    filled(tmp_path / "d")
    assert contents(tmp_path / "d") == before


def test_leftovers_of_killed_runs_go_and_files_of_others_stay(tmp_path):
    filled(tmp_path / "d")
    before = contents(tmp_path / "d")
    (tmp_path / "d/photograph/c/0/0/0/0.1234.partial").write_text("x")
    (tmp_path / "d/making/finished/.00000000.json-1234abcd.partial.json").write_text("x")
    archive(tmp_path / "d")
    assert contents(tmp_path / "d") == before
    (tmp_path / "mine/making").mkdir(parents=True)
    (tmp_path / "mine/thesis.partial").write_text("precious")
    with pytest.raises(OutputError, match="not empty and no data set"):
        check_place(tmp_path / "mine")


def test_write_that_fails_leaves_the_block_unrecorded(tmp_path, monkeypatch):
    made = filled(tmp_path / "d")
    monkeypatch.setattr(
        "periscopy_sim.storage.outputs.store.checksum",
        lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
    )
    with pytest.raises(OutputError, match="disk is full"):
        made.write(1, block(1))
    monkeypatch.undo()
    assert list(archive(tmp_path / "d").missing()) == [1]


def test_attributes_are_those_given_and_no_others_are_read(tmp_path):
    filled(tmp_path / "d")
    attributes = {**ATTRIBUTES, "count": 7}
    assert read_head(tmp_path / "d") == (attributes, layout(), digest_of(ATTRIBUTES))
    with pytest.raises(DatasetError, match="is no data set"):
        read_head(tmp_path / "none")
    (tmp_path / "other").mkdir()
    with pytest.raises(DatasetError, match="is no data set"):
        read_head(tmp_path / "other")
    for content in ("", "{}", "[]", json.dumps({"attributes": {"kind": "sweep", "count": 1}})):
        (tmp_path / "other/zarr.json").write_text(content)
        with pytest.raises(DatasetError, match="is no data set"):
            read_head(tmp_path / "other")


def test_digest_is_of_everything_but_the_count():
    one = digest_of({**ATTRIBUTES, "count": 5})
    assert one == digest_of({**ATTRIBUTES, "count": 9}) == digest_of(ATTRIBUTES)
    assert one != digest_of({**ATTRIBUTES, "configuration": {"seed": 2}})
