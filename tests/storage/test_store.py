import json
import pickle

import numpy as np
import pytest

from periscopy_sim.dataset.reading import Layout, read_head
from periscopy_sim.errors import OutputError
from periscopy_sim.storage import outputs, places
from periscopy_sim.storage.outputs import alone_in
from periscopy_sim.storage.store import MAKING, BlockStore, Label, StoreLayout, check_place
from tests.scenes.contents import contents

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


def archive(path, count=7, attributes=ATTRIBUTES):
    (path / MAKING).mkdir(parents=True, exist_ok=True)
    labels = {
        "geometry_scene": Label("geometries", ["chair"]), "channel": Label("channel", list("rgb"))
    }  # fmt: skip
    return BlockStore(path, layout(count).of_store(), {**attributes, "count": count}, labels)


def filled(path, count=7):
    made = archive(path, count)
    for number in made.missing():
        made.write(number, block(*number))
    return made


def test_blocks_are_read_as_written_and_the_last_is_cut_short(tmp_path):
    import zarr

    filled(tmp_path / "d")
    group = zarr.open_group(tmp_path / "d", mode="r")
    for name in block(0):
        whole = np.concatenate([block(number)[name] for number in range(3)])
        np.testing.assert_array_equal(group[name][:], whole[:7], err_msg=name)
    attributes, found, _ = read_head(tmp_path / "d")
    assert (attributes, found) == ({**ATTRIBUTES, "count": 7}, layout())


def test_order_of_writing_and_a_second_writing_leave_the_same_bytes(tmp_path):
    filled(tmp_path / "a")
    made = archive(tmp_path / "b")
    for number in (2, 0, 2, 1):
        made.write((number,), block(number))
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_a_block_of_fill_values_takes_the_place_of_a_former_one(tmp_path):
    import zarr

    (tmp_path / MAKING).mkdir(parents=True)
    variable = {"shape": (4,), "chunks": (2,), "dtype": float, "dimension_names": ("k",)}
    chunked = StoreLayout("sweep", {"x": {**variable, "fill_value": np.nan}}, {"k": (4, 2)})
    made = BlockStore(tmp_path, chunked, {"seed": 1}, {})
    for value in (1.0, np.nan):
        made.write((0,), {"x": np.full(2, value)})
    assert list(made.missing()) == [(1,)]
    assert np.isnan(zarr.open_group(tmp_path, mode="r")["x"][:]).all()


def test_growing_makes_the_last_block_anew_and_ends_in_the_same_bytes(tmp_path):
    filled(tmp_path / "d", 7)
    assert list(archive(tmp_path / "d", 11).missing()) == [(2,), (3,)]
    filled(tmp_path / "d", 11)
    filled(tmp_path / "e", 11)
    assert contents(tmp_path / "d") == contents(tmp_path / "e")
    filled(tmp_path / "f", 8)
    for name in ("d", "f"):  # a block more than 7 samples have, and a sample more in the last
        with pytest.raises(OutputError, match="7 samples"):
            archive(tmp_path / name, 7)


@pytest.mark.thorough
@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "remove"])
def test_every_damaged_file_of_a_block_makes_it_unfinished(tmp_path, damage):
    filled(tmp_path / "d")
    rng = np.random.default_rng(0)
    for name in block(1):
        file = tmp_path / "d" / layout().of_store().files((1,))[name]
        content = file.read_bytes()
        if damage == "remove":
            file.unlink()
        elif damage == "flip":
            flipped = bytearray(content)
            flipped[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(flipped)
        else:
            file.write_bytes(content[: 0 if damage == "empty" else len(content) // 2])
        assert list(archive(tmp_path / "d").missing()) == [(1,)], name
        file.write_bytes(content)
    assert list(archive(tmp_path / "d").missing()) == []


def test_damaged_or_foreign_record_makes_its_block_anew(tmp_path):
    for content in ["", "[]", '{"samples": 3}', {"of": "0" * 16}, {"crc32c": {}}]:
        made = filled(tmp_path / "d")
        before = contents(tmp_path / "d")
        if isinstance(content, dict):
            content = json.dumps({**made.records.read((0,)), **content})
        made.records.file((0,)).write_text(content)
        assert list(archive(tmp_path / "d").missing()) == [(0,)]
        filled(tmp_path / "d")
        assert contents(tmp_path / "d") == before


@pytest.mark.thorough
def test_damaged_heads_of_variables_are_written_anew(tmp_path):
    filled(tmp_path / "d")
    before = contents(tmp_path / "d")
    for head in (tmp_path / "d" / name for name in before if name.endswith("/zarr.json")):
        head.write_bytes(b"{")
        assert list(archive(tmp_path / "d").missing()) == []
        assert contents(tmp_path / "d") == before, head


def test_blocks_of_other_or_unknown_attributes_are_refused(tmp_path):
    filled(tmp_path / "d")
    other = {**ATTRIBUTES, "configuration": {"seed": 2}}
    with pytest.raises(OutputError, match=r"configuration\.seed"):
        archive(tmp_path / "d", attributes=other)
    (tmp_path / "d/zarr.json").unlink()
    for attributes in (other, ATTRIBUTES):
        with pytest.raises(OutputError, match="another data set"):
            archive(tmp_path / "d", attributes=attributes)


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
        check_place(tmp_path / "mine", "data set")


def test_write_that_fails_leaves_the_block_unrecorded(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    made = archive(tmp_path / "d")
    monkeypatch.setattr("periscopy_sim.storage.store.checksum", full)
    with pytest.raises(OutputError, match="disk is full"):
        made.write((1,), block(1))
    monkeypatch.undo()
    assert list(archive(tmp_path / "d").missing()) == [(0,), (1,), (2,)]


def test_a_second_writer_removes_nothing_of_the_first(tmp_path, monkeypatch):
    first, whole = archive(tmp_path / "d"), []
    blocks = [*layout().of_store().blocks]

    def watched(does):
        def then(*given):
            done = does(*given)
            whole.append([*map(first.records.verify, written)])
            return done

        return then

    for module, name in ((places, "put"), (places, "clear"), (outputs, "staged_file")):
        monkeypatch.setattr(module, name, watched(getattr(module, name)))
    written = []
    before = contents(tmp_path / "d")
    archive(tmp_path / "d")  # both have begun
    assert contents(tmp_path / "d") == before and not whole
    for number in blocks:
        first.write(number, block(number[0], layout().of_store().size(number)))
    written = blocks
    whole.clear()
    second = archive(tmp_path / "d")
    for number in blocks:
        second.write(number, block(number[0], layout().of_store().size(number)))
    assert len(whole) == len(blocks) * (len(block(0)) + 1) and np.all(whole)


def test_a_machine_that_does_not_see_the_store_says_so(tmp_path):
    made = pickle.loads(pickle.dumps(archive(tmp_path / "shared")))
    made.check_seen()
    (tmp_path / "shared").rename(tmp_path / "of another machine")
    with pytest.raises(OutputError):
        made.check_seen()


def test_folder_is_free_again_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyError), alone_in(tmp_path):
            raise KeyError
    with alone_in(tmp_path), pytest.raises(OutputError), alone_in(tmp_path):
        pass
