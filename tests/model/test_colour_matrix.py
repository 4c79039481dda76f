from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import ColourMatrix, Photograph
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.storage.tables import read_colour_matrix

HIDDEN, PHOTOGRAPH = (4, 5), (14, 15)
RNG = np.random.default_rng(0)
A, B = RNG.random((210, 20)) ** 3 + 0.1, RNG.random((210, 3))
M = np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]])
TRUTH = RNG.uniform(0.2, 1, (20, 3))
LIGHT = (A @ TRUTH + B @ RNG.random((3, 3))).reshape(*PHOTOGRAPH, 3)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("shape", [(4, 3), (2, 1)])
def test_cameras_may_have_more_channels_than_the_monitor_primaries(name, shape):
    colours = ColourMatrix(np.random.default_rng(3).uniform(0.2, 1, shape))
    y = LIGHT[..., : shape[1]]
    noise = np.random.default_rng(1).standard_normal((*PHOTOGRAPH, shape[0]))
    given = Photograph.of(colours.mix(y) + 1e-3 * noise, colour_matrix=colours)
    scene = SimpleNamespace(photograph_shape=PHOTOGRAPH, hidden=HIDDEN, channel_gain=None)
    found = METHODS[name](scene, A, B).reconstruct(given)
    expected = METHODS[name](scene, A, B).reconstruct(y)
    assert found.shape == (*HIDDEN, shape[1])
    np.testing.assert_allclose(found, expected, atol=0.1 * np.sqrt(np.mean(expected**2)))


def test_light_is_mixed_by_the_matrix():
    colours = ColourMatrix(M)
    np.testing.assert_allclose(colours.mix(TRUTH)[3], M @ TRUTH[3])
    np.testing.assert_allclose(colours.unmix(colours.mix(TRUTH)), TRUTH)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        (np.ones(3), "channels, primaries"),
        (np.eye(3).astype(complex), "real numbers"),
        (np.eye(3)[:2], "2 x 3"),
        (np.full((3, 3), np.nan), "finite"),
        (np.diag([1.0, 0, 1]), "alike"),
    ],
)
def test_matrices_that_tell_no_colours_apart_are_rejected(values, name):
    with pytest.raises(ValueError, match=name):
        ColourMatrix(values)


@pytest.mark.parametrize("suffix", ["npy", "json", "csv"])
def test_files_hold_the_matrix(tmp_path, suffix):
    file = tmp_path / f"matrix.{suffix}"
    if suffix == "npy":
        np.save(file, M)
    else:
        file.write_text(str(M.tolist()) if suffix == "json" else "\n".join(
            ",".join(map(str, row)) for row in M
        ))  # fmt: skip
    np.testing.assert_array_equal(read_colour_matrix(file).matrix, M)


@pytest.mark.parametrize(
    ("suffix", "text"),
    [("npy", "1,2,3"), ("npy", None), ("json", "[[1, 2], [3]]"), ("json", "{}"), ("json", ""),
     ("csv", "a,b,c\n" * 3), ("csv", "1,2,3")],
)  # fmt: skip
def test_files_that_hold_no_matrix_are_named(tmp_path, suffix, text):
    file = tmp_path / f"matrix.{suffix}"
    if text is not None:
        file.write_text(text)
    with pytest.raises(PhotographError, match=file.name):
        read_colour_matrix(file)
