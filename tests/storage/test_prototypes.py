import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.prototypes import read_prototypes

PIXELS = 6


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16])
def test_columns_are_read_as_they_were_saved(tmp_path, kind):
    B = np.arange(PIXELS * 2).reshape(PIXELS, 2).astype(kind)
    np.save(tmp_path / "B.npy", B)
    found = read_prototypes(tmp_path / "B.npy", PIXELS)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, B)


@pytest.mark.parametrize(
    ("held", "message"),
    [
        (
            np.ones((5, 2)),
            r"holds an array of shape \(5, 2\); prototype backgrounds are \(6, lights",
        ),
        (np.ones(PIXELS), r"of shape \(6,\)"),
        (np.ones((PIXELS, 0)), r"of shape \(6, 0\)"),
        (np.full((PIXELS, 1), np.nan), "holds NaN or infinities"),
        (np.ones((PIXELS, 1), complex), "save real numbers"),
    ],
)
def test_what_is_no_set_of_columns_is_refused(tmp_path, held, message):
    np.save(tmp_path / "B.npy", held)
    with pytest.raises(PhotographError, match=message):
        read_prototypes(tmp_path / "B.npy", PIXELS)


def test_files_that_are_missing_or_of_another_kind_are_refused(tmp_path):
    with pytest.raises(PhotographError, match="no such file"):
        read_prototypes(tmp_path / "B.npy", PIXELS)
    (tmp_path / "B.npy").write_bytes(b"\x93NUMPY broken")
    with pytest.raises(PhotographError, match=r"B\.npy"):
        read_prototypes(tmp_path / "B.npy", PIXELS)
