"""Rows rendered on demand against the stored matrix."""

import numpy as np
import pytest

from periscopy_sim.rendering.transport import shadow_rays
from periscopy_sim.rendering.transport.shadow_rays import RenderedTransport, render_transport


@pytest.mark.parametrize("lanes", [1, 1000, 1 << 22])
def test_every_pass_gives_the_bytes_of_the_stored_matrix(shipped, lanes, monkeypatch):
    scene = shipped("chair", (4, 5), 12)
    settings = {"samples": 6, "pixel_samples": 2, "seed": 3}
    A = render_transport(scene, **settings)
    monkeypatch.setattr(shadow_rays, "LANES", lanes)
    rendered = RenderedTransport(scene, **settings)
    assert rendered.shape == A.shape
    for _ in range(2):
        covered = 0
        for rows, block in rendered.row_blocks():
            assert rows.start == covered
            covered = rows.stop
            np.testing.assert_array_equal(block, A[rows])
        assert covered == len(A)
