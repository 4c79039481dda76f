from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.image_shift import ImageShift, shifts_image

from periscopy_sim.calibration.calibrated_scene import with_defaults
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.search import image_shift
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.shipped import find_scene

HIDDEN = (6, 7)
PATCHES = ("patch_centers", "patch_normals", "patch_across", "patch_up")


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
    across, up = (np.linalg.norm(edge[0]) for edge in (chair().patch_across, chair().patch_up))
    assert shift.alone.tolist() == [False, True, True, False]
    np.testing.assert_allclose(np.abs(shift.patches[:, 1]), [1 / across, 0], atol=1e-3)
    np.testing.assert_allclose(np.abs(shift.patches[:, 2]), [0, 1 / up], atol=1e-3)


def test_what_can_be_moved_to_one_side_alone_is_moved_there(monkeypatch):
    names, prior = ("monitor_dx", "monitor_dz"), Prior(np.zeros(2), np.array([0.005, 0.005]))
    given = find_scene("chair"), HIDDEN, {"resolution": "18"}, names, prior
    whole = ImageShift.of(*given)
    load = image_shift.load_scenario

    def bordered(path, hidden, parameters):
        if float(parameters.get("monitor_dx", 0)) > 0 or float(parameters.get("monitor_dz", 0)):
            raise SceneError("a pixel misses the wall")
        return load(path, hidden, parameters)

    monkeypatch.setattr(image_shift, "load_scenario", bordered)
    found = ImageShift.of(*given)
    np.testing.assert_allclose(found.patches[:, 0], whole.patches[:, 0], atol=1e-2)
    np.testing.assert_array_equal(found.patches[:, 1], 0)


@pytest.mark.parametrize(("ball", "alone"), [("0", True), ("$monitor_dx", False)])
def test_occluders_that_are_no_meshes_are_looked_at(tmp_path, ball, alone):
    scene, wall = tmp_path / "scene.xml", '<shape type="rectangle" id="wall">'
    sphere = (
        '<shape type="sphere" id="ball"><float name="radius" value="0.02"/><transform '
        f'name="to_world"><translate x="{ball}" y="0.5" z="0.3"/></transform></shape>'
    )
    scene.write_text(with_defaults(find_scene("chair"), {}, tmp_path).replace(wall, sphere + wall))
    size = {"resolution": "18"}
    here, moved = (load_scenario(scene, HIDDEN, size | m) for m in ({}, {"monitor_dx": "0.01"}))
    assert any(occluder.vertices is None for occluder in here.occluders)
    assert shifts_image(here, moved) == alone


def test_a_row_of_patches_that_grow_taller_is_no_shift():
    here, taller = chair(), chair(monitor_dz=0.01)
    rows = {name: getattr(here, name)[:7] for name in PATCHES}
    grown = {name: getattr(taller, name)[:7] for name in PATCHES}
    here, moved = replace(here, **rows), replace(taller, **grown)
    assert shifts_image(here, moved)
    assert not shifts_image(here, replace(moved, patch_up=1.01 * moved.patch_up))


@pytest.mark.parametrize("unit", [1e-3, 0.39, 777.0])
def test_places_are_compared_in_single_precision_whatever_the_unit(unit):
    def measured(scenario):
        places = ("wall_points", "patch_centers", "patch_across", "patch_up")
        return replace(scenario, occluders=(), **{
            name: (unit * getattr(scenario, name) + 30 * unit * (name in places[:2]))
            .astype(np.float32).astype(np.float64) for name in places
        })  # fmt: skip

    here = measured(chair())
    assert shifts_image(here, measured(chair(monitor_dx=0.0123)))
    assert not shifts_image(here, measured(chair(monitor_stretch=1.001, monitor_dx=0.0123)))


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


def test_what_shifts_the_image_obliquely_stays():
    """By a patch and a half of one across, no image on the grid would follow it."""
    slanted = ImageShift(np.array([[1.0], [0.5]]))
    np.testing.assert_array_equal(slanted.nearest(np.array([2.1]), np.zeros(1)), [2.1])


@pytest.mark.parametrize("up", [0.0, 1e-9, 1e-4])
def test_one_parameter_shifts_by_whole_patches_one_way_alone(up):
    by_patch = ImageShift(np.array([[100.0, 0.0], [up, 0.0]])).by_patch
    np.testing.assert_allclose(by_patch, [[0.01, 0.0], [0.0, 0.0]], atol=1e-8)
    assert not by_patch[:, 1].any()


@pytest.mark.parametrize(("worse", "moved"), [(-5.0, True), (30.0, True), (60.0, False)])
def test_a_photograph_that_tells_patches_apart_keeps_its_place(worse, moved):
    shift, values = ImageShift(np.array([[100.0], [0.0]])), np.array([0.021])
    there = SimpleNamespace(evidence=1000.0 + worse)
    level = SimpleNamespace(prior=Prior(np.zeros(1), np.full(1, 0.01)), judged=lambda _: there)
    found, seen = shift.settled(level, values, SimpleNamespace(evidence=1000.0))
    assert found == pytest.approx(0.001 if moved else 0.021)
    assert (seen is there) == moved
