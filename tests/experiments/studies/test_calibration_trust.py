"""The plate in closed form beside rays, and what is printed of calibrations."""

import numpy as np
import pytest

from experiments.studies import calibration_trust as study


def through(x, z, values, random, rays=20000):
    """Part of the light of each patch, (R, C), that rays find not blocked on the way to a point."""
    dx, dy, dz, stretch, monitor_dx, monitor_dz, _ = values
    rows, columns = study.HIDDEN
    part = np.empty(study.HIDDEN)
    side, depth = study.PLATE[2] * (1 + stretch), (study.PLATE[3] + dy) / study.DISTANCE
    left, foot = study.PLATE[0] + dx, study.PLATE[1] + dz
    for row in range(rows):
        for column in range(columns):
            across, up = random.random((2, rays))
            u = (
                study.MONITOR[0]
                + monitor_dx
                + study.MONITOR[2] * (columns - 1 - column + across) / columns
            )
            v = study.MONITOR[1] + monitor_dz + study.MONITOR[3] * (rows - 1 - row + up) / rows
            px, pz = u + depth * (x - u), v + depth * (z - v)
            plate = (abs(px - left - side / 2) < side / 2) & (abs(pz - foot - side / 2) < side / 2)
            stick = (abs(px - left - side / 2) < study.STICK / 2) & (pz < foot)
            part[row, column] = 1 - np.mean(plate | stick)
    return part


@pytest.mark.parametrize("pixel", [(5, 12), (14, 9), (20, 20)])
def test_the_plate_hides_what_rays_find_hidden(pixel):
    values = [0.01, -0.02, 0.005, 0.1, 0.004, -0.003, 0.0]
    centre = (np.array(pixel) + 0.5) / study.PIXELS * study.VIEW[2]
    x, z = study.VIEW[0] + centre[1], study.VIEW[1] + study.VIEW[2] - centre[0]
    found = through(x, z, values, np.random.default_rng(0))
    empty = study.transport([10.0, *values[1:]])  # a plate far aside
    row = pixel[0] * study.PIXELS + pixel[1]
    expected = (study.transport(values)[row] / empty[row]).reshape(study.HIDDEN)
    assert expected.min() < 0.9
    # 0.5 / sqrt(20000) is 0.0035 at most; chance passes five of them among 80 once in 10,000 seeds.
    np.testing.assert_allclose(found, expected, atol=0.018)


def test_lines_tell_of_determined_parameters_alone():
    outcomes = [
        study.Outcome(np.array([1.0, 9.0]), np.array([True, False]), True, True, 2.0, 10.0),
        study.Outcome(np.array([4.0, 0.5]), np.array([True, True]), False, False, 4.0, -1.0),
    ]
    line = study.told(outcomes)
    assert "determined    3 of 4, within 3 errors 2 (66.7 %), of all parameters 50.0 %" in line
    assert (
        "not trusted 1, left at the ruler's 1; overdispersion 3.0; image nearer by 4.5 dB" in line
    )
    assert line.endswith("-1.0 at worst")


@pytest.mark.thorough
def test_a_calibration_brings_the_image_nearer():
    found = study.outcome(study.TROUBLES[0], 1)
    assert found.trusted and found.moved and found.determined.any()
    assert found.gain > 10 and found.off[found.determined].max() < 5
