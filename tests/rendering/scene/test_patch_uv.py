"""Where the patches of the hidden image lie in the monitor's UV square."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from periscopy_sim.rendering.scene.load import patch_uv

sizes = st.tuples(st.integers(1, 500), st.integers(1, 500))
offsets = st.tuples(*[st.floats(1e-6, 1 - 1e-6)] * 2)


@given(hidden=sizes, offset=offsets)
def test_patches_tile_the_square_from_the_viewers_upper_left(hidden, offset):
    rows, columns = hidden
    row, column = np.divmod(np.arange(rows * columns), columns)
    u, v = patch_uv(row, column, hidden, False, offset)
    assert (np.diff(u.reshape(hidden), axis=1) > 0).all()
    assert (np.diff(v.reshape(hidden), axis=0) < 0).all()
    mirrored, same = patch_uv(row, column, hidden, True, offset)
    np.testing.assert_allclose(u + mirrored, 1, rtol=1e-12)
    np.testing.assert_array_equal(v, same)
    np.testing.assert_allclose(u.mean(), 0.5 + (offset[1] - 0.5) / columns)
    np.testing.assert_allclose(v.mean(), 0.5 - (offset[0] - 0.5) / rows)
