import json
import os
import pickle

import numpy as np
import png
import pytest
import scipy.io
import tifffile
from PIL import Image

from periscopy_sim.storage.formats.exr import write_exr

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
COUNTS = np.random.default_rng(21).integers(9000, 65536, (24, 24, 3)).astype(np.uint16)


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    """Reconstruct from a file into `out`; return the image and the summary."""

    def run(photo):
        succeeds("reconstruct", photo, *TINY, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


# -- photographs of every kind -------------------------------------------------------------------


def save_png(path):
    with path.open("wb") as stream:
        writer = png.Writer(24, 24, greyscale=False, bitdepth=16)
        writer.write(stream, COUNTS.reshape(24, -1).tolist())


def save_matlab(path):
    bayer = np.zeros((48, 48), np.uint16)
    bayer[0::2, 0::2], bayer[1::2, 1::2] = COUNTS[..., 0], COUNTS[..., 2]
    bayer[0::2, 1::2] = bayer[1::2, 0::2] = COUNTS[..., 1]
    scipy.io.savemat(path, {"image": bayer, "shutter_speed": 0.5, "iterations": 2.0})


WRITERS = {
    "y.exr": lambda path: write_exr(path, COUNTS, {}),
    "y.npz": lambda path: np.savez(path, photograph=COUNTS, hidden=np.zeros(3)),
    "y.png": save_png,
    "y.tif": lambda path: tifffile.imwrite(path, COUNTS, photometric="rgb"),
    "float.tiff": lambda path: tifffile.imwrite(path, COUNTS / 1.0, photometric="rgb"),
    "y.mat": save_matlab,
}


def test_every_format_gives_the_same_image(reconstruct, without_doubts, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS.astype(">f8"))
    expected, _ = reconstruct("y.npy")
    assert np.ptp(expected) > 0
    for name, write in WRITERS.items():
        write(tmp_path / name)
        image, summary = reconstruct(name)
        assert np.array_equal(image, expected), name
        assert without_doubts(summary["warnings"]) == []


def test_one_channel_is_taken_as_grey(reconstruct, tmp_path):
    np.save(tmp_path / "grey.npy", COUNTS[..., 1])
    np.save(tmp_path / "thrice.npy", np.stack([COUNTS[..., 1]] * 3, axis=-1))
    grey, _ = reconstruct("grey.npy")
    thrice, _ = reconstruct("thrice.npy")
    assert np.array_equal(grey, thrice)


def test_8_bit_photograph_is_decoded_with_a_warning(
    reconstruct, periscopy, without_doubts, tmp_path
):
    codes = (COUNTS // 257).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "y.png")
    shown = codes / 255
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    np.save(tmp_path / "y.npy", linear)
    expected, _ = reconstruct("y.npy")
    outcome = periscopy("reconstruct", "y.png", *TINY, "--out", "out")
    assert outcome.code == 0
    (line,) = without_doubts(outcome.err.splitlines())
    assert line.startswith("periscopy: warning: y.png: 8-bit PNG, which is normally gamma")
    image = np.load(tmp_path / "out" / "reconstruction.npy")
    assert np.allclose(image, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert f"periscopy: warning: {summary['warnings'][0]}" == line


# -- what is refused -----------------------------------------------------------------------------


def with_values(*values):
    broken = COUNTS.astype(np.float32)
    for number, value in enumerate(values):
        broken[3 + number, 4, 1] = value
    return broken


@pytest.mark.parametrize(
    ("photograph", "message"),
    [
        (np.ones((48, 48, 3)), "48 x 48 pixels (rows x columns), but the scene's camera has 24 x"),
        (np.ones((24, 25, 3)), "24 x 25 pixels (rows x columns), but the scene's camera has 24 x"),
        (COUNTS[..., :2], "has shape (24, 24, 2)"),
        (COUNTS[0, 0], "has shape (3,)"),
        (with_values(np.nan), "1 value is NaN or infinite, the first at row 3, column 4, chan"),
        (with_values(np.inf, -np.inf), "2 values are NaN or infinite, the first at row 3"),
        (np.zeros((24, 24, 3)), "every value is zero"),
        (COUNTS * 1j, "complex numbers"),
        (COUNTS.astype(str), "text"),
    ],
)
def test_array_that_is_no_photograph_is_refused(photograph, message, refused, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    line = refused("reconstruct", "y.npy", *TINY, "--out", "out")
    assert line.startswith("y.npy: ") and message in line


# Of EXR files OpenEXR prints lines of its own.
@pytest.mark.parametrize("name", ["y.npy", *(name for name in WRITERS if name != "y.exr")])
def test_truncated_photograph_is_refused(name, refused, tmp_path):
    WRITERS.get(name, lambda path: np.save(path, COUNTS))(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    for length in (0, 3, len(content) // 2):
        (tmp_path / name).write_bytes(content[:length])
        assert refused("reconstruct", name, *TINY, "--out", "out").startswith(f"{name}: ")


def test_what_is_no_photograph_file_is_refused(refused, tmp_path):
    (tmp_path / "notes.exr").write_text("x, y, z\n" * 40)
    assert "notes.exr: is no EXR" in refused("reconstruct", "notes.exr", *TINY, "--out", "out")
    line = refused("reconstruct", "none.exr", *TINY, "--out", "out")
    assert line == "none.exr: no such file; check the path"
    assert "is a folder" in refused("reconstruct", ".", *TINY, "--out", "out")
    np.savez(tmp_path / "y.npz", image=COUNTS)
    line = refused("reconstruct", "y.npz", *TINY, "--out", "out")
    assert "has no array 'photograph', only image" in line


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_pickles_are_never_loaded(refused, tmp_path):
    trap = np.array([Trap(tmp_path / "sprung")], dtype=object)
    np.save(tmp_path / "trap.npy", trap)
    np.savez(tmp_path / "trap.npz", photograph=trap, hidden=trap)
    (tmp_path / "raw.npy").write_bytes(pickle.dumps(trap[0]))
    np.save(tmp_path / "y.npy", COUNTS)
    for name in ("trap.npy", "trap.npz", "raw.npy"):
        assert name in refused("reconstruct", name, *TINY, "--out", "out")
        assert name in refused("reconstruct", "y.npy", *TINY, "--truth", name, "--out", "out")
        assert name in refused("reconstruct", "y.npy", *TINY, "--transport", name, "--out", "out")
        tiny = ("-D", "resolution=24", "--hidden", "4x5", "--out", "y.exr")
        assert name in refused("photograph", "chair", name, *tiny)
        ambient = ("--ambient", name, "--sbr", "1")
        assert name in refused("photograph", "chair", "bars", *tiny, *ambient)
    assert not (tmp_path / "sprung").exists()
    np.load(tmp_path / "trap.npy", allow_pickle=True)
    assert (tmp_path / "sprung").exists()  # it would have


def test_matlab_objects_are_refused(refused, tmp_path):
    for image in (np.array([1, "a"], dtype=object), {"a": 1.0}):
        fields = {"image": image, "shutter_speed": 1.0, "iterations": 1.0}
        scipy.io.savemat(tmp_path / "y.mat", fields)
        line = refused("reconstruct", "y.mat", *TINY, "--out", "out")
        assert "y.mat: has no numbers 'image'" in line


# -- photographs at the edge ---------------------------------------------------------------------


def hot(light):
    light = 0 * light
    light[3, 4, 1] = 1e6
    return light


@pytest.mark.parametrize(
    "change",
    [
        np.asfortranarray,
        lambda light: light.astype(">f4"),
        lambda light: light.astype(np.longdouble),
        lambda light: light.astype(np.int32),
        lambda light: light.astype(">u2"),
    ],
)
def test_type_and_order_of_an_array_do_not_matter(reconstruct, tmp_path, change):
    plain = COUNTS.astype(np.float64)
    np.save(tmp_path / "plain.npy", plain)
    np.save(tmp_path / "y.npy", change(plain))
    expected, _ = reconstruct("plain.npy")
    found, _ = reconstruct("y.npy")
    np.testing.assert_array_equal(found, expected)


@pytest.mark.usefixtures("drawings")
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(np.ones_like, id="even"),
        pytest.param(hot, id="one value"),
        pytest.param(lambda light: light * [1, 0, 1], id="a dark channel"),
        pytest.param(lambda light: light * 1e-25, id="dim"),
        *(
            pytest.param(change, id=name, marks=pytest.mark.thorough)
            for name, change in {
                "hot pixel": lambda light: light + hot(light),
                "saturated": lambda light: np.minimum(light, np.quantile(light, 0.1)),
                "mostly negative": lambda light: light - 0.9 * light.max(),
                "bright": lambda light: light * 1e20,
            }.items()
        ),
    ],
)
def test_extreme_photographs_are_reconstructed(periscopy, without_doubts, tmp_path, change):
    np.save(tmp_path / "y.npy", change(COUNTS.astype(np.float64)))
    outcome = periscopy("reconstruct", "y.npy", *TINY, "--out", "out")
    assert outcome.code == 0
    for line in without_doubts(outcome.err.splitlines()):
        assert line.startswith("periscopy: warning: y.npy: ")
        assert "--mask" in line or "negative" in line
    assert np.isfinite(np.load(tmp_path / "out" / "reconstruction.npy")).all()


@pytest.mark.parametrize("scale", [1e300, 1e-300, 1e-320])
def test_photograph_of_no_usable_scale_is_refused(refused, tmp_path, scale):
    np.save(tmp_path / "y.npy", scale * COUNTS)
    line = refused("reconstruct", "y.npy", *TINY, "--out", "out")
    assert "its largest value is" in line and "scale it to about 1" in line
