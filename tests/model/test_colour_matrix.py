import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.model.colour_matrix import ColourMatrix
from periscopy_sim.storage.tables import read_colour_matrix

M = np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]])
TRUTH = np.random.default_rng(0).uniform(0.2, 1, (20, 3))


def test_light_is_mixed_by_the_matrix():
    colours = ColourMatrix(M)
    np.testing.assert_allclose(colours.mix(TRUTH)[3], M @ TRUTH[3])
    np.testing.assert_allclose(colours.unmix(colours.mix(TRUTH)), TRUTH)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        (np.eye(2), "3 x 3"),
        (np.eye(3).astype(complex), "3 x 3"),
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


@pytest.mark.parametrize("text", ["", "1,2,3", "[[1, 2], [3]]", "{}", "a,b,c\n" * 3, None])
@pytest.mark.parametrize("suffix", ["npy", "json", "csv"])
def test_files_that_hold_no_matrix_are_named(tmp_path, text, suffix):
    file = tmp_path / f"matrix.{suffix}"
    if text is not None:
        file.write_text(text)
    with pytest.raises(PhotographError, match=file.name):
        read_colour_matrix(file)
