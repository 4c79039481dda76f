import numpy as np
import pytest
import scipy.io

import periscopy_sim as ps
from experiments.published.setting import read_capture
from tests.scenes.published import COUNTS, save_capture

NPY = b"\x93NUMPY\x01\x00" + bytes(120)
GREY = np.full((6, 8, 3), 0.5)
TRUTH = np.linspace(0, 1, 10 * 12 * 3).reshape(10, 12, 3)


def read(path, shape=(6, 8), hidden=(10, 12)):
    return read_capture(path, shape, hidden)


@pytest.mark.parametrize("exposure", [2.0, 50.0])
def test_a_capture_counts_for_each_unit_of_exposure(tmp_path, exposure):
    light = np.random.default_rng(0).uniform(0.2, 1, (6, 8, 3))
    save_capture(tmp_path / "c.mat", light, TRUTH, exposure=exposure, noise=0)
    capture = read(tmp_path / "c.mat")
    assert np.allclose(capture.photograph, COUNTS * light, rtol=1e-12)


def test_halves_have_independent_noise(tmp_path):
    """Bounds are five standard errors of a correlation and of a deviation over 2688 pixels."""
    light, noise = np.ones((42, 64, 3)), 0.01
    save_capture(tmp_path / "c.mat", light, TRUTH, noise=noise, side=4, seed=3)
    capture = read(tmp_path / "c.mat", (42, 64))
    first, second = capture.halves - capture.halves.mean(axis=(1, 2), keepdims=True)
    expected = noise * COUNTS * np.array([1, np.sqrt(0.5), 1]) * np.sqrt(2)
    assert np.allclose(first.std(axis=(0, 1)), expected, rtol=5 / np.sqrt(2 * 2688))
    for channel in range(3):
        pair = (first[..., channel].ravel(), second[..., channel].ravel())
        assert abs(np.corrcoef(*pair)[0, 1]) < 5 / np.sqrt(2688)


@pytest.mark.parametrize("whole", [True, False])
def test_what_was_shown_is_decoded_from_either_scale(tmp_path, whole):
    save_capture(tmp_path / "c.mat", GREY, None)
    fields = scipy.io.loadmat(tmp_path / "c.mat")
    sent = np.array([[[0.0, 128.0, 255.0]]]) / (1 if whole else 255)
    fields["ground_truth"] = np.tile(sent, (10, 12, 1))
    scipy.io.savemat(tmp_path / "c.mat", {k: v for k, v in fields.items() if k[0] != "_"})
    # (128/255 + 0.055)/1.055 to the power of 2.4, by hand.
    assert np.allclose(read(tmp_path / "c.mat").truth, [0, 0.2158605, 1], atol=1e-6)


@pytest.mark.parametrize("truth", [None, np.zeros((10, 12, 3))])
def test_a_capture_without_ground_truth_is_a_capture(tmp_path, truth):
    save_capture(tmp_path / "c.mat", GREY, truth)
    assert read(tmp_path / "c.mat").truth is None


def test_a_file_that_is_no_capture_is_refused_in_one_line(tmp_path):
    for damage, said in [
        (lambda path: path.unlink(), "No such file"),
        (lambda path: path.write_bytes(path.read_bytes()[:900]), "MATLAB"),
        (lambda path: path.write_text("no"), "MATLAB"),
        (lambda path: path.write_bytes(NPY), "MATLAB"),
        (lambda path: scipy.io.savemat(path, {"image": np.ones((24, 32))}), "shutter_speed"),
    ]:
        path = tmp_path / "c.mat"
        save_capture(path, GREY, TRUTH)
        damage(path)
        with pytest.raises(ps.PeriscopyError, match=said) as caught:
            read(path)
        assert "\n" not in str(caught.value)
