"""What the hidden scene showed while a sequence was photographed."""

import numpy as np
import pytest
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.sequences import read_hidden_frames

PATCHES = (2, 3)
SENT = np.random.default_rng(17).integers(0, 256, (4, 4, 6, 3)).astype(np.uint8)


def averaged(light):
    """Means of 2 x 2 pixels."""
    return light.reshape(-1, 2, 2, 3, 2, 3).mean(axis=(2, 4))


def decoded(codes):
    shown = codes / 255
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def hidden(path, count=4):
    return np.array(list(read_hidden_frames(path, PATCHES, count)))


def test_folder_of_pictures_is_decoded_and_averaged_in_natural_order(tmp_path):
    for k, codes in zip((1, 2, 10, 11), SENT, strict=True):
        Image.fromarray(codes).save(tmp_path / f"f{k}.png")
    assert np.allclose(hidden(tmp_path), averaged(decoded(SENT)))


@pytest.mark.parametrize("scale", [1, 255, 65535])
def test_stack_of_hidden_frames_is_linear(scale, tmp_path):
    light = SENT / 255
    dtype = {1: np.float32, 255: np.uint8, 65535: np.uint16}[scale]
    np.save(tmp_path / "f.npy", np.rint(light * scale).astype(dtype) if scale > 1 else light)
    assert np.allclose(hidden(tmp_path / "f.npy"), averaged(light), atol=1e-6)


def test_one_image_stands_for_every_frame(tmp_path):
    light = SENT[0] / 255
    np.save(tmp_path / "f.npy", light)
    (tmp_path / "folder").mkdir()
    np.save(tmp_path / "folder" / "f.npy", light)
    np.save(tmp_path / "stack.npy", light[None])
    for name in ("f.npy", "folder", "stack.npy"):
        found = hidden(tmp_path / name)
        assert found.shape == (4, *PATCHES, 3) and np.allclose(found, averaged(light)), name


def test_wrong_number_of_hidden_frames_is_refused(tmp_path):
    np.save(tmp_path / "f.npy", SENT)
    for count in (1, 3, 5):
        with pytest.raises(PhotographError, match=r"f\.npy"):
            hidden(tmp_path / "f.npy", count)


@pytest.mark.parametrize(
    ("stack", "place"),
    [
        (np.where(np.arange(4)[:, None, None, None] == 2, -1.0, SENT), "frame 2"),
        (np.where(np.arange(4)[:, None, None, None] == 3, np.nan, SENT), "frame 3"),
        (SENT.astype(np.int32), "frame 0"),
        (SENT[..., :2] / 1.0, "f.npy"),
        (SENT * 1j, "f.npy"),
        (SENT[:0], "f.npy"),
    ],
)
def test_stack_that_holds_no_light_is_refused(stack, place, tmp_path):
    np.save(tmp_path / "f.npy", stack)
    with pytest.raises(PhotographError, match=place):
        hidden(tmp_path / "f.npy")
