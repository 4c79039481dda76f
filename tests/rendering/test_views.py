"""Several cameras of one scene, and the walls that they see."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import Outlines, are_apart, area_transport, ways_to
from periscopy_sim.errors import SceneError
from tests.scenes.two_walls import CAMERAS, SHAPES, write_two_walls

pytestmark = pytest.mark.usefixtures("variant")


@pytest.fixture
def views(tmp_path):
    """A view by each camera, of one scene."""
    path = write_two_walls(tmp_path)
    first = ps.load_scenario(path, (3, 4), camera="left")
    return {each: ps.load_scenario(first.scene, (3, 4), camera=each) for each in CAMERAS}


def test_each_camera_sees_the_wall_in_its_middle_and_the_other_is_an_occluder(views):
    for camera, wall, other, axis, place in (
        ("left", "wall_back", "wall", 1, 1.0),
        ("right", "wall", "wall_back", 0, 0.9),
    ):
        view = views[camera].view
        assert (view.camera, view.wall, view.shape) == (camera, wall, SHAPES[camera])
        np.testing.assert_allclose(view.centers[:, axis], place, atol=1e-6)
        assert [each.name for each in view.occluders] == ["far", "near", other]
    assert views["left"].scene is views["right"].scene


@pytest.mark.parametrize("camera", CAMERAS)
def test_areas_of_either_wall_agree_with_rays(views, camera):
    """The other wall reaches the planes of monitor and wall, but lies beyond all light."""
    assert all(isinstance(way, Outlines) for way in ways_to(views[camera]).values())
    A = area_transport(views[camera])
    rays = ps.render_transport(views[camera].averaged(2), samples=64)
    assert np.linalg.norm(A - rays) < 0.02 * np.linalg.norm(rays)


@pytest.mark.parametrize("camera", CAMERAS)
def test_photograph_is_that_of_the_views_camera(views, camera):
    image = np.random.default_rng(3).uniform(0.2, 1, (3, 4, 3))
    photograph = ps.render_photograph(views[camera], image, samples=256, bounces=1)
    A = ps.transport(views[camera])
    expected = (A @ image.reshape(-1, 3)).reshape(*SHAPES[camera], 3)
    assert photograph.shape == expected.shape
    assert np.linalg.norm(photograph - expected) < 0.02 * np.linalg.norm(expected)


@pytest.mark.parametrize("camera", CAMERAS)
def test_view_stays_its_cameras_where_things_move(views, camera):
    moved = views[camera].at(left_dx=0.01, right_dx=-0.02)
    path, values = moved.path, {"left_dx": 0.01, "right_dx": -0.02}
    anew = ps.load_scenario(path, (3, 4), values, camera=camera)
    assert moved.view.wall == anew.view.wall == views[camera].view.wall
    np.testing.assert_allclose(moved.view.points, anew.view.points, atol=1e-6)
    shift = moved.view.centers - views[camera].view.centers
    along = [0.01, 0, 0] if camera == "left" else [0, 0, 0]  # towards the wall nothing changes
    np.testing.assert_allclose(shift, np.tile(along, (len(shift), 1)), atol=1e-6)
    assert moved.averaged(2).view.camera == camera


def test_camera_that_is_not_there_or_sees_no_wall_is_refused(tmp_path):
    path = write_two_walls(tmp_path)
    with pytest.raises(SceneError, match=r"no sensor .* 'camera' \('left', 'right'\)"):
        ps.load_scenario(path, (3, 4))
    turned = path.read_text().replace('target="0.3, 1, 0.3"', 'target="0.3, 0.9, 0.3"')
    path.write_text(turned)
    with pytest.raises(SceneError, match=r"'left' shows nothing, none of .*wall_back, wall;"):
        ps.load_scenario(path, (3, 4), camera="left")


def test_sets_are_apart_where_a_plane_parts_them():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(40, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for direction in rng.normal(size=(8, 3)):
        way = direction / np.linalg.norm(direction)
        # The hull of points on a sphere reaches this far towards the other one.
        gap = (ball @ way).max() - (ball @ way).min()
        assert are_apart(ball, ball + 1.01 * gap * way)
        assert not are_apart(ball, ball + 0.5 * way)
