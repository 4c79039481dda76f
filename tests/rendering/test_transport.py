"""How A is made: its stated error against the closed form, and the budget of rays."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import has_areas
from periscopy_sim.errors import ClosedFormError
from periscopy_sim.rendering import transport as planning
from periscopy_sim.rendering.transport import planned, planned_for

pytestmark = pytest.mark.usefixtures("every_wall_point")


def plan_transport(*scene, **settings):
    return planned(*scene, **settings)


@pytest.mark.parametrize(("noise", "samples"), [(0.01, 256), (0.002, None)])
def test_error_by_rays_is_the_distance_from_areas_and_small_beside_noise(shipped, noise, samples):
    """To a third: the rows of 64 pixels measure the error to 9 %, and A is one draw."""
    scene = shipped("chair")
    plan = plan_transport(scene, noise, by="rays", samples=samples)
    exact = ps.transport(scene)  # averaged over pixels: rays of a given number leave their centres
    off = plan.transport(scene, seed=7).sum(axis=1, dtype=float) - exact.sum(axis=1)
    assert plan.error == pytest.approx(np.sqrt(np.mean(off**2)) / exact.sum(axis=1).mean(), 1 / 3)
    assert samples or plan.error < noise / 3


def test_beyond_the_budget_the_error_is_warned_of(shipped, monkeypatch):
    scene = shipped("chair")
    monkeypatch.setattr(planning, "BUDGET", 0)
    plan = plan_transport(scene, 1e-6, by="rays")
    assert plan.samples == planning.FEWEST
    with pytest.warns(RuntimeWarning, match="noise"):
        ps.transport(scene, by="rays", noise=2 * plan.error)


@pytest.mark.parametrize(("near", "noise", "pixels"), [(0, 3e-4, 24), (0.3, 1e-3, 12)])
def test_error_by_areas_is_the_distance_from_the_mean_over_each_pixel(shipped, near, noise, pixels):
    """Of white light, by four times the points; the nearer the chair, the sharper its shadows."""
    scene = shipped("chair", resolution=pixels).at(occluder_dy=near)
    plan = plan_transport(scene, noise)
    exact, light = (
        ps.analytic_transport(scene.averaged(across)).sum(axis=1, dtype=float)
        for across in (2 * plan.across, plan.across)
    )
    error = np.sqrt(np.mean((light - exact) ** 2)) / exact.mean()
    assert error < plan.error * 1.5 + planning.ROUNDING
    assert plan.error < noise / 10


@pytest.mark.parametrize("noise", [-1, np.nan])
def test_noise_is_a_number_from_0_on(shipped, noise):
    with pytest.raises(ValueError, match="noise"):
        plan_transport(shipped("chair"), noise)


def test_a_monitor_edge_on_is_planned_though_parts_of_pixels_are_behind_it(room):
    """The wall's first column of pixels reaches from 0.5 to 0.567 m."""
    monitor = room.monitor(room.area, turn=90).replace('x="0.2" y="0"', 'x="0.51" y="0"')
    scene = room.load(monitor=monitor)
    areas, rays = (
        plan_transport(scene, 0.03, by=by).transport(scene).sum(axis=1, dtype=float)
        for by in (None, "rays")
    )
    np.testing.assert_allclose(areas, rays, rtol=0, atol=0.03 * rays.mean())


def test_rays_take_no_surfaces_that_the_scene_has_elsewhere(shipped):
    scene = shipped("chair")
    moved = scene.hidden.moved({"monitor": np.eye(4) + 0.1 * np.eye(4, k=3)})
    with pytest.raises(ValueError, match="areas"):
        ps.transport(scene.view, moved, by="rays")
    with pytest.raises(ValueError, match="beside"):
        ps.transport(scene, moved)


def test_a_curved_surface_of_few_patches_is_bent_all_the_same(room):
    """Its middles alone would look flat; the plan says how far off A by areas is, and less so."""
    monitor = room.curved_monitor(room.area)
    one, four, eight = (
        room.load(monitor=monitor, hidden=size) for size in ((2, 1), (1, 4), (1, 8))
    )
    for seen in (one, four, eight):
        assert seen.hidden["monitor"].curved is not None
        assert not seen.hidden.is_flat
    assert room.load().hidden["monitor"].curved is None
    light = [ps.analytic_transport(each).sum(axis=1) for each in (one, four, eight)]
    off = np.sqrt(np.mean((light[0] - light[2]) ** 2)) / light[2].mean()
    assert off > 1e-3
    errors = [plan_transport(each, 1e-3, by="areas").error for each in (one, four, eight)]
    assert errors[0] > off / 2 and errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("size", [(1, 2), (4, 7)])
def test_whether_folds_hide_each_other_is_told_whatever_the_patches(room, size):
    """Patches as wide as a fold are alike, and by themselves would hide nothing."""
    seen = room.load(monitor=room.folded_monitor(), camera=room.camera(size=(6, 8)), hidden=size)
    assert not has_areas(seen)
    plan = plan_transport(seen, 0.1)
    assert plan.by == "rays"
    with pytest.raises(ClosedFormError, match="hides parts of itself"):
        plan_transport(seen, 0.1, by="areas")


def test_areas_that_fail_on_another_grid_leave_rays(room, monkeypatch):
    def refuse(*_):
        raise ClosedFormError("no")

    monkeypatch.setattr(planning, "area_transport", refuse)
    assert plan_transport(room.load(), 0.1).by == "rays"
    with pytest.raises(ClosedFormError):
        plan_transport(room.load(), 0.1, by="areas")


def test_a_scene_whose_pixels_edges_miss_the_wall_has_an_a_for_images(room):
    """The wall ends in the last column of pixels, past the points of A."""
    scene = room.load(wall=room.wall(x=-0.10117), camera=room.camera(size=(6, 8)))
    plan = plan_transport(scene, 0.1)
    error, A = planned_for(np.ones((1, 6, 3)), scene, 0.1)
    assert (error, A.shape) == (plan.error, scene.transport_shape)
