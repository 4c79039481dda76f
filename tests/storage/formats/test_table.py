"""A new file format is one decoder and one row of the table."""

import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats import table
from periscopy_sim.storage.formats.decoding import Picture
from periscopy_sim.storage.photographs import read_mask, read_photograph
from periscopy_sim.storage.pictures import read_hidden_image
from periscopy_sim.storage.sequences.opening import open_frames

SHAPE = (2, 3)
VALUES = np.arange(1, 7.0).reshape(SHAPE)


@pytest.fixture
def another_format(monkeypatch):
    def decode(path, key, size):
        assert key in ("photograph", "mask", "hidden") and size in (None, SHAPE)
        text = path.read_text().split()[1:]
        return Picture(np.array(text, float).reshape(SHAPE))

    row = table.FileFormat("NUMBERS", (".num",), ((2, b"numbers"),), decode)
    monkeypatch.setattr(table, "FORMATS", (*table.FORMATS, row))


@pytest.mark.usefixtures("another_format")
def test_one_row_is_read_as_still_mask_hidden_image_and_frame(tmp_path):
    for name in ("y1.num", "y2.num"):
        (tmp_path / name).write_text("a_numbers " + " ".join(map(str, VALUES.ravel())))
    file = tmp_path / "y1.num"
    grey = np.repeat(VALUES[..., None], 3, axis=2)
    assert np.array_equal(read_photograph(file, SHAPE).values, grey)
    assert np.array_equal(read_mask(file, SHAPE), VALUES > 3)
    assert np.array_equal(read_hidden_image(file, SHAPE), grey)
    frames = open_frames(tmp_path, SHAPE)
    assert frames.names == ("y1.num", "y2.num")
    assert all(np.array_equal(frame.values, grey) for frame in frames)
    with pytest.raises(PhotographError, match="is a single NUMBERS file"):
        open_frames(file, SHAPE)


def test_every_row_has_a_name_of_its_own_and_signatures_that_differ():
    names = [row.name for row in table.FORMATS]
    signatures = [known for row in table.FORMATS for known in row.signatures]
    assert len(set(names)) == len(names) and len(set(signatures)) == len(signatures)
    assert len(table.suffixes()) == sum(len(row.suffixes) for row in table.FORMATS)
    assert ".mat" in table.suffixes() and ".mat" not in table.suffixes(raw=False)
