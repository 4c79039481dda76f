import numpy as np
import pytest

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.growing import GrowingStack


def test_a_stack_is_whole_at_any_moment(tmp_path):
    file = tmp_path / "frames.npy"
    file.write_bytes(b"of a former run, and longer than what is written now" * 99)
    arrays = np.random.default_rng(0).normal(size=(12, 3, 4, 3)).astype(np.float32)
    stack = GrowingStack(file, (3, 4, 3))
    for k, each in enumerate(arrays):  # the header keeps its length from 9 to 10
        np.testing.assert_array_equal(np.load(file), arrays[:k])
        stack.append(each.astype(np.float64))
    with file.open("ab") as other:  # the writer is killed amid a frame
        other.write(b"half a frame")
    np.testing.assert_array_equal(np.load(file), arrays)
    with pytest.raises(ValueError, match="holds arrays of shape"):
        stack.append(arrays[0, 0])
    stack.close()


def test_what_cannot_be_written_is_an_error_of_the_output(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/frames\.npy"):
        GrowingStack(tmp_path / "nowhere" / "frames.npy", (3,))
