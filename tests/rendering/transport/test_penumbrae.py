"""Fewer rays where no shadow has an edge: the same entries where one has, no more error else."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import (
    PROBES,
    edges,
    render_penumbrae,
    render_transport,
)
from periscopy_sim.shipped import find_scene

pytestmark = pytest.mark.usefixtures("jit")

RAYS = {"samples": 4, "pixel_samples": 9}
SHAPE = (5, 6, 4, 3)


@pytest.fixture(scope="module")
def chair():
    return load_scenario(find_scene("chair"), (9, 11), {"resolution": "32"})


def test_entries_at_an_edge_are_those_of_all_rays(chair):
    A, full = (render(chair, **RAYS, seed=3) for render in (render_penumbrae, render_transport))
    same = full == A
    assert 0.1 < same.mean() < 0.7
    # Elsewhere all rays pass or none does: what differs is how steeply light falls within a pixel.
    assert np.abs(A - full)[~same].max() < 0.02 * full.max()
    assert A.sum() == pytest.approx(full.sum(), rel=3e-4)


def test_entries_without_an_edge_are_exact_however_large_their_patches(room):
    """By four rays at random they err by more, alike for every image: it passed for a gain."""
    bare = room.load(hidden=(2, 3))
    exact = render_transport(bare, strata="midpoint", samples=4096)
    np.testing.assert_allclose(render_penumbrae(bare, **RAYS), exact, rtol=1e-3)
    jittered = render_transport(bare, samples=PROBES)
    assert np.abs(jittered / exact - 1).max() > 0.01


@pytest.mark.thorough
def test_the_error_is_no_larger_than_with_all_rays(chair):
    truth = render_transport(chair, samples=36, pixel_samples=36, seed=1)
    errors = [
        np.linalg.norm(render(chair, **RAYS, seed=2) - truth)
        for render in (render_penumbrae, render_transport)
    ]
    assert errors[0] < 1.05 * errors[1]


def neighbours(where, axes):
    """The brute-force twin: every index beside a true one, along both axes."""
    found = np.zeros_like(where)
    for index in np.argwhere(where):
        beside = [slice(i, i + 1) for i in index]
        for axis in axes:
            beside[axis] = slice(max(index[axis] - 1, 0), index[axis] + 2)
        found[tuple(beside)] = True
    return found


def test_an_edge_is_where_rays_disagree_with_a_neighbours():
    visible = np.random.default_rng(0).choice([0.0, 0.5, 1.0], SHAPE, p=[0.3, 0.02, 0.68])
    visible[:3] = 1.0
    expected = np.zeros(SHAPE, bool)
    for axes in ((0, 1), (2, 3)):
        expected |= neighbours(visible > 0, axes) & neighbours(visible < 1, axes)
    assert 0.2 < expected.mean() < 0.9
    np.testing.assert_array_equal(edges(visible), expected.ravel())
