import numpy as np
import pytest

from periscopy_sim.rendering.wall_polynomials import SITES, chosen_sites, polynomials


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 4), (12, 200), (17, 16), (126, 126)])
def test_sites_are_pixels_no_more_than_asked_for_and_reach_the_edges(shape):
    sites = chosen_sites(shape)
    assert np.all(np.diff(sites) > 0)
    assert len(sites) == min(SITES, shape[0] * shape[1])
    rows, columns = np.divmod(sites, shape[1])
    for found, pixels in ((rows, shape[0]), (columns, shape[1])):
        assert found.min() < 0.02 * pixels and found.max() >= 0.98 * pixels - 1


@pytest.mark.parametrize("shape", [(126, 126), (40, 7), (1, 30)])
@pytest.mark.parametrize("largest", [(0, 0), (5, 5), (3, 0), (0, 13), (8, 2)])
def test_polynomials_are_orthonormal_and_reach_their_powers_together(shape, largest):
    found = polynomials(shape, largest, np.arange(shape[0] * shape[1]))
    np.testing.assert_allclose(found.T @ found / len(found), np.eye(found.shape[1]), atol=1e-10)
    y, x = (2 * grid.ravel() / max(shape) - 1 for grid in np.indices(shape))
    a, b = (max(power, 1e-9) for power in largest)
    terms = [
        y**i * x**j
        for i in range(largest[0] + 1)
        for j in range(largest[1] + 1)
        if i / a + j / b < 1 + 1e-9 and i < shape[0] and j < shape[1]
    ]
    assert len(terms) == found.shape[1]
    # The same space.
    inside = found @ (found.T @ np.stack(terms, axis=1)) / len(found)
    np.testing.assert_allclose(inside, np.stack(terms, axis=1), atol=1e-9)
