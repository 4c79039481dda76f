"""Occluders of equal area, in the plate's place."""

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.design import masks


@pytest.fixture(scope="module")
def stage():
    return ps.load_scenario("plate", (2, 2), {"resolution": 8})


@pytest.mark.parametrize("cells", [3, 4, 8])
def test_random_mask_has_half_of_its_cells_and_is_another_for_another_seed(cells):
    first, second = (masks.random_mask(cells, seed) for seed in (0, 1))
    assert first.sum() == -(-cells * cells // 2)
    assert (first == masks.random_mask(cells, 0)).all()
    assert (first != second).any()


def test_flat_masks_have_the_plates_area(stage):
    for opaque in (np.ones((1, 1), bool), masks.random_mask(3, 0), masks.random_mask(8, 2)):
        _, area = masks.silhouette(masks.flat_mesh(opaque), stage)
        assert area == pytest.approx(masks.SIDE**2, rel=0.01)


def test_chair_is_scaled_to_the_plates_area(stage):
    mesh = masks.scaled(masks.shape_of("chair", "chair_"), stage)
    seen, area = masks.silhouette(mesh, stage)
    assert area == pytest.approx(masks.SIDE**2, rel=1e-6)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    assert middle == pytest.approx(masks.CENTRE, abs=1e-12)
    # The back stands above the seat, and there is room between the legs below.
    rows = np.flatnonzero(seen.any(axis=1))
    assert not seen[rows[-40], :].all()


def test_silhouette_is_where_shadow_rays_are_blocked(stage, tmp_path):
    """By Mitsuba: of rays from the monitor's middle to that of the wall, moved side by side."""
    candidate = masks.Candidate(
        "chair", "chair", masks.scaled(masks.shape_of("chair", "chair_"), stage)
    )
    scene = ps.load_scenario(masks.write_scene(candidate, tmp_path), (2, 2), {"resolution": 8})
    from periscopy_sim.rendering.survey import Survey

    seen, _ = masks.silhouette(candidate.mesh, scene)
    way = scene.wall_points.mean(axis=0) - scene.patch_centers.mean(axis=0)
    offset = candidate.mesh.vertices - masks.CENTRE
    flat = (offset - offset[:, 1:2] / way[1] * way)[:, [0, 2]]
    half = 1.02 * np.abs(flat).max()
    place = half * (2 * (np.arange(masks.FINE) + 0.5) / masks.FINE - 1)
    x, z = np.meshgrid(place, -place)
    points = masks.CENTRE + np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3)
    blocked = Survey(scene).blocked(points - 0.3 * way, points + 0.3 * way)
    assert np.mean(blocked.reshape(seen.shape) != seen) < 0.005


def test_scene_holds_the_mesh_where_it_is(tmp_path):
    mask = masks.flat_mesh(masks.random_mask(4, 0))
    scene = masks.write_scene(masks.Candidate("random", "four", mask), tmp_path)
    (occluder,) = ps.load_scenario(scene, (2, 2), {"resolution": 8}).occluders
    assert occluder.bounds[0] == pytest.approx(mask.vertices.min(axis=0), abs=1e-6)
    assert occluder.bounds[1] == pytest.approx(mask.vertices.max(axis=0), abs=1e-6)
