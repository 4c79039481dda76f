import numpy as np
import pytest

from periscopy_sim.rendering.overview import View, covered, find_view
from periscopy_sim.rendering.survey import Survey

SCREEN = (
    '<shape type="rectangle" id="screen"><transform name="to_world"><scale value="2"/>'
    '<rotate y="1" angle="90"/><translate x="{}" y="0.5" z="0.3"/></transform></shape>'
)
SHAPE = (24, 32)


def view_of(scenario, survey, shape=SHAPE):
    points = np.concatenate([survey.monitor_points, survey.view_points, survey.view_origins])
    screen, facing = scenario.patch_centers.mean(axis=0), scenario.patch_normals.mean(axis=0)
    wall, normal = survey.view_points[4], scenario.wall_normals.mean(axis=0)
    landmarks = np.array([screen + 0.01 * facing, screen - 0.01 * facing, wall + 0.01 * normal])
    surfaces = [(screen, facing), (wall, normal)]
    return find_view(survey, points, landmarks, surfaces, shape, -normal), points, landmarks


@pytest.mark.parametrize("side", [-0.3, 1.2])
def test_view_is_from_where_nothing_stands_in_the_way(room, side):
    """A large screen on either side hides the monitor from there."""
    scenario = room.load(SCREEN.format(side))
    survey = Survey(scenario)
    view, _, landmarks = view_of(scenario, survey)
    hidden = survey.blocked(np.tile(view.origin, (3, 1)), landmarks)
    assert not hidden[2] and not hidden[:2].all()  # the monitor is seen from one side


def test_pixels_that_show_something_are_those_of_the_things(room):
    """A camera before the wall's middle, 2 m x 2 m: its edges are where they are projected."""
    scenario = room.load()
    view = View(np.array([0.7, -6.0, 0.3]), np.array([(1, 0, 0), (0, 0, 1), (0, 1, 0)]), (30, 30))
    shown = covered(Survey(scenario), view)
    corners = np.array([(-0.3, 1, -0.7), (1.7, 1, 1.3)])
    (left, bottom), (right, top) = view.project(corners)[0]
    inside = np.zeros((30, 30), bool)
    inside[int(np.ceil(top)) : int(bottom), int(np.ceil(left)) : int(right)] = True
    assert (shown[inside] == 1).all() and inside.sum() > 100
    outside = np.ones((30, 30), bool)
    outside[int(top) : int(np.ceil(bottom)), int(left) : int(np.ceil(right))] = False
    assert (shown[outside] == 0).all() and outside.sum() > 100
