import numpy as np
import pytest

from periscopy_sim.rendering.survey import RAYS, Survey, hidden_fraction, shadow_doubt

CUBE = (0.45, 0.5, 0.3), (0.05, 0.01, 0.04)


def test_parallel_rays_begin_beside_each_other(room):
    survey = Survey(room.load())
    assert survey.parallel
    x, z = [0.5, 0.9, 0.9, 0.5, 0.7], np.array([1, 1, -1, -1, 0]) * 0.2 * 5 / 6 + 0.3
    # The corners lie within the picture by a ten-thousandth of its size.
    np.testing.assert_allclose(survey.view_points[:, 0], x, atol=5e-5)
    np.testing.assert_allclose(survey.view_points[:, 2], z, atol=5e-5)
    np.testing.assert_allclose(survey.view_points[:, 1], 1, atol=1e-5)
    np.testing.assert_allclose(
        survey.view_origins[:, [0, 2]], survey.view_points[:, [0, 2]], atol=1e-6
    )


def test_solids_reach_as_far_as_their_shapes(room):
    ball = room.blocker("0.45, 0.5, 0.3", 0.06)
    survey = Survey(room.load(room.cube(*CUBE), ball))
    found = {solid.name: solid for solid in survey.solids}
    assert set(found) == {"box", "ball"}
    assert found["box"].faces is not None and found["ball"].faces is None
    box, ball = found["box"].points, found["ball"].points
    np.testing.assert_allclose(np.ptp(box, axis=0), [0.1, 0.02, 0.08], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(ball - [0.45, 0.5, 0.3], axis=1), 0.06, rtol=1e-3)
    np.testing.assert_allclose(np.ptp(ball, axis=0), 0.12, rtol=0.02)


def test_share_of_the_monitor_is_that_of_rays_that_miss_the_box(room):
    scenario = room.load(room.cube(*CUBE), hidden=(9, 12), camera=room.camera((12, 12)))
    survey = Survey(scenario)
    points = np.array([(x, 1 - 1e-4, z) for x in (0.5, 0.65, 0.72, 1.3) for z in (0.2, 0.31, 0.5)])
    targets = scenario.hidden.centers
    expected = []
    for point in points:
        path = targets - point
        # Slabs: where the ray enters and leaves the box along each axis.
        with np.errstate(divide="ignore"):
            ends = (np.array([[(0.4, 0.49, 0.26)], [(0.5, 0.51, 0.34)]]) - point) / path
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        expected.append(np.mean(enter > leave))
    share = survey.lit_share(points, targets)
    assert min(expected) < 0.9 < max(expected) == 1
    np.testing.assert_allclose(share, expected, atol=1e-12)


def test_a_wire_of_a_millimetre_between_monitor_and_wall_is_a_shadow(room):
    assert shadow_doubt(room.load(room.cube((0.45, 0.5, 0.3), (0.0005, 0.0005, 1.0)))) == ""


@pytest.mark.parametrize("place", [(0.3, -0.4, 0.3), (0.3, 1.4, 0.3), (2.5, 0.5, 0.3)])
def test_an_occluder_without_a_shadow_is_named(room, place):
    assert "'box'" in shadow_doubt(room.load(room.cube(place, (0.04, 0.04, 0.04))))


def test_a_scene_without_occluders_or_without_light_is_doubted(room):
    assert "no occluder" in shadow_doubt(room.load())
    assert "hide all" in shadow_doubt(room.load(room.cube((0.4, 0.2, 0.3), (2, 0.01, 2))))


def test_fraction_of_blocked_paths_is_that_of_a_plate_in_closed_form(room):
    """Between parallel, equal rectangles 1 m apart, an endless edge halfway hides what it must.

    A ray from (x, 0) on the monitor to (X, 1) on the wall passes x + X over 2; the plate hides
    what passes beyond its edge: the triangular distribution of the sum of two uniform variables.
    """
    # Monitor x in (0, 0.4), wall x in (0.5, 0.9): their mean runs from 0.25 to 0.65.
    edge = 0.35
    expected = 2 * ((edge - 0.25) / 0.4) ** 2
    plate = room.cube((edge - 2, 0.5, 0.3), (2, 1e-4, 2))
    hidden = hidden_fraction(room.load(plate, camera=room.camera((64, 64))))
    error = np.sqrt(expected * (1 - expected) / RAYS)
    assert abs(hidden - expected) < 5 * error + 2e-3  # rays end at the pixels' centres
