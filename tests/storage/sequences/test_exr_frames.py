"""Frames in the parts of an OpenEXR file."""

import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.sequences.opening import open_frames

SHAPE = (6, 5)
CLIP = np.random.default_rng(17).uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)


def read(path):
    return [frame.values for frame in open_frames(path, SHAPE)]


def test_exr_parts_keep_their_order_and_other_channels_are_left_out(save, tmp_path):
    clip = np.concatenate([CLIP, CLIP[..., :2]], axis=3)
    save.exr(tmp_path / "y.exr", clip, channels="RGBAZ")
    frames = open_frames(tmp_path / "y.exr", SHAPE)
    assert np.array_equal([frame.values for frame in frames], CLIP)
    assert frames.warnings == (f"{tmp_path / 'y.exr'}: left out the channels A, Z",)


def test_exr_of_one_part_is_one_frame(tmp_path):
    write_exr(tmp_path / "y.exr", CLIP[0], {})
    assert np.array_equal(read(tmp_path / "y.exr"), CLIP[:1])


def test_truncated_part_of_an_exr_is_named(save, tmp_path, capfd):
    save.exr(tmp_path / "y.exr", CLIP)
    content = (tmp_path / "y.exr").read_bytes()
    (tmp_path / "y.exr").write_bytes(content[:-20])
    seen = []
    with pytest.raises(PhotographError, match=r"y\.exr, frame 11: truncated or damaged EXR"):
        for frame in open_frames(tmp_path / "y.exr", SHAPE):
            seen.append(frame.values)
    assert np.array_equal(seen, CLIP[:11])
    assert capfd.readouterr() == ("", "")


def test_frame_may_be_any_layer_that_a_still_may_be(save, tmp_path):
    clip = np.concatenate([CLIP, CLIP[..., :1]], axis=3)
    save.exr(tmp_path / "y.exr", clip, channels=("wall.R", "wall.G", "wall.B", "depth.Z"))
    frames = open_frames(tmp_path / "y.exr", SHAPE)
    assert np.array_equal([frame.values for frame in frames], CLIP)
    assert frames.warnings == (f"{tmp_path / 'y.exr'}: left out the channels depth.Z",)
    save.exr(tmp_path / "one.exr", clip[:1], channels=("wall.R", "wall.G", "wall.B", "depth.Z"))
    still = read_photograph(tmp_path / "one.exr", SHAPE)
    assert np.array_equal(still.values, CLIP[0]) and "depth.Z" in still.warnings[0]


@pytest.mark.parametrize(
    ("channels", "said"),
    [("RG", "channels G, R there"), ("YZ", "channels Y, Z there"), ("A", "channels A there")],
)
def test_exr_part_without_one_colour_image_is_named(channels, said, save, tmp_path):
    save.exr(tmp_path / "y.exr", CLIP[:2, ..., : len(channels)], channels=channels)
    with pytest.raises(PhotographError, match=f"y.exr, frame 0: among its {said}"):
        open_frames(tmp_path / "y.exr", SHAPE)


def test_exr_part_of_another_size_is_named(save, tmp_path):
    sizes = [CLIP[0], CLIP[0], CLIP[0, :-1]]
    window = (np.array([0, 0], np.int32), np.array([4, 5], np.int32))
    save.exr(tmp_path / "y.exr", sizes, displayWindow=window)
    with pytest.raises(PhotographError, match=r"y\.exr, frame 2: 5 x 5 pixels"):
        open_frames(tmp_path / "y.exr", SHAPE)


def test_channel_whose_name_is_no_text_is_refused(save, tmp_path):
    save.exr(tmp_path / "y.exr", CLIP[:2], channels=("RX", "GX", "BX"))
    content = (tmp_path / "y.exr").read_bytes()
    assert content.count(b"RX\0") == 2
    (tmp_path / "y.exr").write_bytes(content.replace(b"RX\0", b"\x80X\0"))
    with pytest.raises(PhotographError, match="cannot be read as EXR") as caught:
        open_frames(tmp_path / "y.exr", SHAPE)
    assert "\n" not in str(caught.value)
