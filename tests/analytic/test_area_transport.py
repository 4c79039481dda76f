"""A by areas is A: as by boxes' half-spaces, as by rays; and smooth."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_derivatives, area_transport, has_areas
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import EmissionProfile, Occluder
from periscopy_sim.testing import derivative_test
from tests.scenes.boxes import LAMBERTIAN, LCD, Box, changed, make_scenario, merged, oracle, welded

PLATE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
TWO_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def plate(corner, size):
    """A rectangle without thickness, parallel to wall and monitor."""
    across, up = (PLATE * size).T
    vertices = np.array(corner) + np.stack([across, 0 * across, up], axis=1)
    return Occluder("plate", vertices, TWO_TRIANGLES)


@pytest.mark.parametrize("emission", [LCD, LAMBERTIAN, EmissionProfile(2.5, 0.5)])
def test_without_occluders_it_is_the_integral(emission):
    scenario = make_scenario(emission=emission)
    assert relative(area_transport(scenario), oracle(scenario, (30, 30))) < 4e-4


def test_one_patch_sends_the_light_of_all():
    fine, coarse = (
        area_transport(ps.load_scenario("chair", hidden, photograph=(5, 6)))
        for hidden in ((5, 6), (1, 1))
    )
    np.testing.assert_allclose(coarse[:, 0], fine.sum(axis=1), rtol=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(4))
def test_boxes_anywhere_hide_what_their_half_spaces_hide(seed):
    rng = np.random.default_rng(seed)
    boxes = [Box.random(rng) for _ in range(3)]  # they may overlap, and part of it is aside
    scenario = make_scenario([box.occluder(f"box{k}") for k, box in enumerate(boxes)])
    # Of 900 samples a shadow's border crosses some 60, each half wrong.
    assert relative(area_transport(scenario), oracle(scenario, (30, 30), boxes)) < 6e-3


@pytest.mark.parametrize("scene", ["chair", "plate", "plant"])
def test_it_is_what_rays_make(scene):
    scenario = ps.load_scenario(scene, (8, 9), photograph=(14, 18))
    by_rays = ps.render_transport(scenario, samples=256)
    assert by_rays.sum() == pytest.approx(area_transport(scenario).sum(), rel=1e-3)
    # Stratified in 16 x 16, a border leaves the 256th part of a patch per stratum that it crosses.
    assert relative(area_transport(scenario), by_rays) < 6e-3


def test_a_pixel_is_the_mean_of_its_wall_points():
    fine = ps.load_scenario("chair", (4, 4), photograph=(12, 15))
    A = area_transport(fine).reshape(4, 3, 5, 3, 16).mean(axis=(1, 3)).reshape(20, 16)
    pixels = ps.load_scenario("chair", (4, 4), photograph=(4, 5)).averaged(3)
    np.testing.assert_allclose(area_transport(pixels), A, rtol=1e-5, atol=1e-4 * A.max())
    some = np.random.default_rng(0).random((4, 5)) < 0.5
    part = Scenario(pixels.view.of_pixels(some), pixels.hidden)
    np.testing.assert_allclose(
        area_transport(part), A[some.ravel()], rtol=1e-5, atol=1e-4 * A.max()
    )


def test_boxes_that_touch_or_lie_in_each_other_hide_once():
    left, right = Box((0.4, 0.5, 0.25), (0.1, 0.05, 0.1)), Box((0.5, 0.5, 0.25), (0.1, 0.05, 0.1))
    whole, within = Box((0.45, 0.5, 0.25), (0.2, 0.05, 0.1)), Box((0.45, 0.5, 0.25), (0.1,) * 3)
    within = Box(within.center, (0.1, 0.03, 0.05))
    A = area_transport(make_scenario([whole.occluder()]))
    for boxes in ([left, right], [whole, within], [whole, whole]):
        occluders = [box.occluder(str(k)) for k, box in enumerate(boxes)]
        for scene in (occluders, [welded(merged(*occluders))]):
            np.testing.assert_allclose(
                area_transport(make_scenario(scene)), A, rtol=1e-5, atol=1e-5 * A.max()
            )


def test_a_wall_that_stands_out_of_its_plane_is_refused():
    assert not has_areas(changed(make_scenario(), view={"relief": 0.01}))
    assert has_areas(changed(make_scenario(), view={"relief": 1e-6}))


def chair(**values):
    given = {
        "occluder_dx": "0.002",
        "occluder_turn": "0.7",
        "monitor_turn": "0.4",
        "camera_dz": "0",
    }
    given |= {name: f"{value:.12g}" for name, value in values.items()}
    return ps.load_scenario("chair", (8, 9), given, photograph=(18, 20)).averaged(2)


@pytest.mark.parametrize(
    ("name", "middle", "step", "within"),
    [
        ("occluder_dx", 0.002, 1e-3, 0.03),
        ("occluder_turn", 0.7, 0.5, 0.04),
        ("camera_dz", 0.0, 1e-3, 0.05),
        ("monitor_stretch", 1.0, 0.01, 0.03),
        ("vertical_exponent", 18.0, 0.5, 1e-3),
    ],
)
def test_derivatives_are_those_of_the_photograph(name, middle, step, within):
    """By differences an eighth as wide, whose own error is about what is allowed.

    Single precision and shadows' corners leave no more; `test_border_motion` has a thousandth.
    """
    light = np.random.default_rng(0).random((72, 3)) + np.linspace(0, 1, 72)[:, None]
    _, (found,) = area_derivatives(chair(), [(chair(**{name: middle + step}), step)])

    def photograph(value):
        return area_transport(chair(**{name: value[0]})) @ light

    derivative_test(photograph, [found @ light], [middle], steps=step / 8, rtol=within)


@pytest.mark.parametrize(
    ("scene", "name", "middle", "step"),
    [
        ("chair", "occluder_turn", 0.0, 0.02),
        ("chair", "seat_thickness", 0.004, 1e-5),
        ("plate", "occluder_turn", 0.0, 0.02),
    ],
)
def test_derivatives_hold_where_edges_run_along_the_rows(scene, name, middle, step):
    """Patch by patch, as the scenes are shipped; what differs is the differences' own error."""
    behind, here, ahead = (
        ps.load_scenario(scene, (8, 9), {name: f"{value:.12g}"}, photograph=(36, 40))
        for value in (middle - step, middle, middle + step)
    )
    _, (found,) = area_derivatives(here, [(ahead, step)])
    expected = (area_transport(ahead).astype(float) - area_transport(behind)) / (2 * step)
    assert relative(found, expected) < 0.005


def test_a_parameter_that_adds_vertices_has_no_derivative_by_areas():
    own = chair().scene.occluders
    more = changed(chair(), scene={"occluders": (*own, plate([0.1, 0.5, 0.1], [0.05, 0.05]))})
    with pytest.raises(SceneError, match="how many vertices"):
        area_derivatives(chair(), [(more, 1.0)])
