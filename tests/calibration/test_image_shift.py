from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.calibration.image_shift import ImageShift, shifts_image
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.shipped import find_scene

HIDDEN = (6, 7)


def chair(**moves):
    given = {name: str(value) for name, value in moves.items()}
    return load_scenario(find_scene("chair"), HIDDEN, {"resolution": "18", **given})


@pytest.mark.parametrize(("name", "alone"), [
    ("monitor_dx", True),
    ("monitor_dz", True),
    ("monitor_dy", False),
    ("monitor_turn", False),
    ("monitor_stretch", False),
    ("occluder_dx", False),
    ("camera_dx", False),
])  # fmt: skip
def test_only_a_move_in_the_monitors_plane_shifts_the_image_alone(name, alone):
    here = chair()
    assert shifts_image(here, chair(**{name: 0.01})) == alone
    assert not shifts_image(here, here)


def test_a_chair_that_moves_along_is_no_shift_of_the_image():
    assert not shifts_image(chair(), chair(monitor_dx=0.01, occluder_dx=0.01))


def test_a_monitor_that_stands_askew_is_not_shifted_in_its_plane_by_its_depth():
    turned = {"monitor_turn": 10.0}
    assert shifts_image(chair(**turned), chair(**turned, monitor_dx=0.01))
    assert not shifts_image(chair(**turned), chair(**turned, monitor_dy=0.01))
    here, there = chair(**turned), chair(**turned, monitor_dx=0.01)
    out = np.abs(here.patch_normals @ (there.patch_centers - here.patch_centers)[0]).max()
    assert out == pytest.approx(0.01 * np.sin(np.radians(10)), rel=1e-6)


def test_parameters_that_shift_the_image_are_told_in_patches():
    names, path = ("occluder_dx", "monitor_dx", "monitor_dz", "monitor_turn"), find_scene("chair")
    prior = Prior(np.zeros(4), np.array([0.005, 0.005, np.inf, 1.0]))
    shift = ImageShift.of(path, HIDDEN, {"resolution": "18"}, names, prior)
    patch = np.linalg.norm(chair().patch_across[0])
    assert shift.alone.tolist() == [False, True, False, False]  # of dz no ruler knows
    np.testing.assert_allclose(np.abs(shift.patches[:, 1]), [1 / patch, 0], atol=1e-3)


@pytest.mark.parametrize("askew", [0.0, 0.2])
def test_values_move_by_whole_patches_to_where_the_ruler_has_them(askew):
    turned = np.array([[np.cos(askew), np.sin(askew)], [-np.sin(askew), np.cos(askew)]])
    shift = ImageShift(np.hstack([turned / 0.01, np.zeros((2, 1))]))
    start = np.array([1.0, 2.0, 3.0])
    near = start + np.array([0.002, -0.003, 0.4])
    far = near + np.linalg.pinv(shift.patches) @ [2, -1]
    np.testing.assert_allclose(shift.nearest(far, start), near, atol=1e-12)
    np.testing.assert_allclose(shift.nearest(near, start), near, atol=1e-12)
    assert ImageShift.none(3).nearest(far, start).tolist() == far.tolist()


@pytest.mark.parametrize(("worse", "moved"), [(-5.0, True), (5.0, True), (30.0, False)])
def test_a_photograph_that_tells_patches_apart_keeps_its_place(worse, moved):
    shift, values = ImageShift(np.array([[100.0], [0.0]])), np.array([0.021])
    there = SimpleNamespace(evidence=1000.0 + worse)
    level = SimpleNamespace(prior=Prior(np.zeros(1), np.full(1, 0.01)), explain=lambda _: there)
    found, seen = shift.settled(level, values, SimpleNamespace(evidence=1000.0))
    assert found == pytest.approx(0.001 if moved else 0.021)
    assert (seen is there) == moved
