"""Monitors as they are measured: where each patch is, and where it faces."""

import numpy as np
import pytest

from tests.laboratory.built.conftest import CAMERA, MONITOR, WALL, turned


@pytest.mark.parametrize("tilt", [0, 10])
@pytest.mark.parametrize("turn", [0, -20])
@pytest.mark.parametrize(
    ("place", "across", "up"),
    [("center", 0, 0), ("top_left", 1, -1), ("bottom_left", 1, 1), ("top_right", -1, -1),
     ("bottom_right", -1, 1)],
)  # fmt: skip
def test_monitor_stands_where_it_was_measured(built, place, across, up, turn, tilt):
    """A viewer's right is towards -x; `across` and `up` lead from the place to the centre."""
    monitor = f"""monitor: {{width: 40 cm, height: 30 cm, {place}: [5 cm, 1 cm, 31 cm],
          turn: {turn} deg, tilt: {tilt} deg}}
"""
    scenario = built(WALL, CAMERA, monitor)
    viewers_right = np.tile((np.arange(3) - 1) / 3 * 0.4, 2) + 0.2 * across
    height = np.repeat([0.075, -0.075], 3) + 0.15 * up
    flat = np.stack([-viewers_right, np.zeros(6), height], axis=1)
    expected = turned(flat, tilt, turn) + np.array([0.05, 0.01, 0.31])
    np.testing.assert_allclose(scenario.patch_centers, expected, atol=3e-6)
    normal = turned([(0, 1, 0)], tilt, turn)[0]
    np.testing.assert_allclose(scenario.patch_normals, np.tile(normal, (6, 1)), atol=3e-6)
    np.testing.assert_allclose(
        scenario.patch_across, np.tile(turned([(-0.4 / 3, 0, 0)], tilt, turn), (6, 1)), atol=3e-6
    )
    assert (normal[2] > 0) == (tilt > 0)  # tilted, it looks up


def test_falloff_is_the_monitors(built):
    plain, lcd = (built(WALL, CAMERA, MONITOR.replace("}", more)) for more in (
        "}", ", falloff: {vertical: 17 +- 2, horizontal: 1.5}}"
    ))  # fmt: skip
    assert (plain.emission.vertical, plain.emission.horizontal) == (0, 0)
    assert (lcd.emission.vertical, lcd.emission.horizontal) == (17, 1.5)
