"""Prototype backgrounds of a scene's emitters, against closed forms."""

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.ambient.emitter_backgrounds import emitter_backgrounds

LAMP = (
    '<emitter type="point"><point name="position" value="0.2, -0.5, 0.9"/>'
    '<rgb name="intensity" value="1, 2, 3"/></emitter>'
)


@pytest.fixture
def scenario(room):
    return room.load(camera=room.camera((12, 12)))


@pytest.fixture
def written(room):
    """Write a room without a monitor, and with what is said."""

    def write(*parts, **others):
        return room.write(*parts, monitor="", camera=room.camera((12, 12)), **others)

    return write


def panel(radiance='<rgb name="radiance" value="1, 1, 2"/>', *, y=0.4, size=(0.5, 0.25), turn=180):
    """A black panel that shines towards the wall, its middle 0.6 m before that of the view."""
    return (
        f'<shape type="rectangle" id="panel"><transform name="to_world"><scale x="{size[0] / 2}" '
        f'y="{size[1] / 2}"/><rotate x="1" angle="90"/><rotate z="1" angle="{turn}"/>'
        f'<translate x="0.7" y="{y}" z="0.3"/></transform><bsdf type="diffuse">'
        '<rgb name="reflectance" value="0"/></bsdf><emitter type="area">'
        f"{radiance}</emitter></shape>"
    )


def by_quadrature(points, low, high, y, steps=60):
    """Irradiance of a wall that faces -y by a panel of radiance 1 that faces it, by midpoints."""
    x, z = (low[k] + (high[k] - low[k]) * (np.arange(steps) + 0.5) / steps for k in range(2))
    x, z = (grid.ravel() for grid in np.meshgrid(x, z))
    away = np.stack([x, np.full_like(x, y), z], axis=1)[:, None] - points
    squared = np.sum(away**2, axis=-1)
    area = (high[0] - low[0]) * (high[1] - low[1]) / steps**2
    return (away[..., 1] ** 2 / squared**2).sum(axis=0) * area


def relative(values):
    return values / values.mean()


@pytest.mark.usefixtures("jit")
def test_a_lamp_is_one_column(written, scenario):
    (column,) = emitter_backgrounds(written(LAMP), scenario).T
    away = np.array([0.2, -0.5, 0.9]) - scenario.wall_points
    expected = -away[:, 1] / np.sum(away**2, axis=1) ** 1.5
    np.testing.assert_allclose(column, relative(expected), rtol=1e-3)


@pytest.mark.usefixtures("jit")
def test_each_pane_of_a_panel_is_a_column_of_its_own(written, scenario):
    """Four panes across and two down, from the panel's top as the wall sees it or the other way."""
    B = emitter_backgrounds(written(panel()), scenario, pane=0.125)
    assert B.shape == (144, 8)
    expected = [
        relative(by_quadrature(scenario.wall_points, (x, z), (x + 0.125, z + 0.125), 0.4))
        for z in (0.175, 0.3)
        for x in 0.45 + 0.125 * np.arange(4)
    ]
    for column in expected:
        nearest = np.abs(B - column[:, None]).max(axis=0)
        assert np.count_nonzero(nearest < 2e-3) == 1


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
def test_what_stands_before_a_lamp_casts_its_shadow(room, written, scenario):
    """Lamp and panel, each alone, against the path tracer."""
    ball = room.blocker("0.62, 0.8, 0.35", 0.05)
    for light in (LAMP, panel()):
        seen = render_background(written(light, ball), scenario, target=2e-2).photograph
        (column,) = emitter_backgrounds(written(light, ball), scenario, pane=1, target=5e-2).T
        grey = seen.mean(axis=2).ravel()
        np.testing.assert_allclose(column, relative(grey), atol=0.08)
        (bare,) = emitter_backgrounds(written(light), scenario, pane=1, target=5e-2).T
        assert np.abs(column - bare).max() > 0.3


@pytest.mark.usefixtures("jit")
def test_what_does_not_reach_the_wall_is_left_out(written, scenario):
    away = panel(turn=0).replace('"panel"', '"away"')
    assert emitter_backgrounds(written(panel() + away), scenario, target=1).shape == (144, 2)
    with pytest.raises(SceneError, match="none of its emitters reaches its wall straight"):
        emitter_backgrounds(written(away), scenario)


@pytest.mark.usefixtures("jit")
def test_panes_and_rooms_that_do_not_serve_are_refused(written, scenario):
    with pytest.raises(ValueError):
        emitter_backgrounds(written(panel()), scenario, pane=np.nan)
    with pytest.raises(SceneError, match="'panel'"):
        emitter_backgrounds(written(panel()), scenario, pane=0.01)
    with pytest.raises(SceneError, match="no emitter"):
        emitter_backgrounds(written(), scenario)
    with pytest.warns(RuntimeWarning, match="is known to"):
        emitter_backgrounds(written(panel()), scenario, target=1e-9, max_rounds=1)
