"""Rows rendered on demand against the stored matrix."""

import numpy as np
import pytest

from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.reconstruction.large_scale.iterative import IterativePeriscope
from periscopy_sim.rendering.transport.shadow_rays import RenderedTransport, render_transport


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("lanes", [1, 1000, 1 << 22])
def test_every_pass_gives_the_bytes_of_the_stored_matrix(shipped, lanes):
    scene = shipped("chair", (4, 5), 12)
    settings = {"samples": 6, "pixel_samples": 2, "seed": 3}
    A = render_transport(scene, **settings)
    rendered = RenderedTransport(scene, **settings, lanes=lanes)
    assert rendered.shape == A.shape
    for _ in range(2):
        covered = 0
        for rows, block in rendered.row_blocks():
            assert rows.start == covered
            covered = rows.stop
            np.testing.assert_array_equal(block, A[rows])
        assert covered == len(A)


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
def test_reconstruction_without_a_stored_matrix_is_that_with_it(shipped):
    scene = shipped("chair", (4, 5), 16)
    A = render_transport(scene, seed=1)
    rng = np.random.default_rng(0)
    f = rng.random((20, 3))
    y = (A @ f).reshape(16, 16, 3)
    y += 1e-3 * y.mean() * rng.normal(size=y.shape)
    rendered = RenderedTransport(scene, seed=1, lanes=2600)  # two blocks
    stored = IterativePeriscope.for_scene(scene, A, tolerance=1e-6).reconstruct(y)
    found = IterativePeriscope.for_scene(scene, rendered, tolerance=1e-6).reconstruct(y)
    assert np.linalg.norm(found - stored) < 1e-3 * np.linalg.norm(stored)


@pytest.mark.usefixtures("jit")
def test_it_makes_a_linear_operator_that_passes_the_dot_test(shipped):
    scene = shipped("chair", (4, 5), 12)
    operator = TransportOperator(RenderedTransport(scene, lanes=500))
    rng = np.random.default_rng(1)
    f, y = rng.normal(size=20), rng.normal(size=144)
    assert (operator @ f) @ y == pytest.approx(f @ (operator.H @ y), rel=1e-12)
