"""Calibration as it is called, and the search of both levels in a world in closed form."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import periscopy_sim as ps
from periscopy_sim.calibration import calibrate as calibration
from periscopy_sim.calibration import coarse_to_fine
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.errors import PhotographError
from periscopy_sim.rendering.scene.document import CALIBRATED
from periscopy_sim.shipped import find_scene
from tests.calibration.conftest import TRUTH, slat_level

NOTHING = UncertainParameters((), np.empty(0), np.empty(0))
NONE_SHIFTS = np.zeros(2, bool)


def searched(level, shifting=NONE_SHIFTS, progress=None):
    return coarse_to_fine.search(level, level, shifting, NOTHING, progress)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_numbers_are_found_within_their_errors(seed):
    told = []
    found = searched(
        slat_level(start=np.add(TRUTH, [0.02, -0.012]), seed=seed), progress=told.append
    )
    assert found.trusted and found.moved
    for parameter, truth in zip(found.parameters, TRUTH, strict=True):
        assert abs(parameter.value - truth) < 3 * parameter.standard_error
        assert parameter.standard_error < 0.2 * parameter.ruler_error
        assert parameter.determined
    assert found.unexplained[1] < found.unexplained[0]
    assert [level.values.shape[1] for level in found.path] == [2, 2]
    assert told == sorted(told) and told[-1] == 1


def test_values_that_are_right_stay_where_nothing_better_is_found():
    found = searched(slat_level(start=TRUTH, errors=(1e-4, 1e-4)))
    assert not found.moved
    np.testing.assert_array_equal(list(found.values.values()), TRUTH)


def test_a_parameter_that_no_ruler_knows_is_found_too():
    found = searched(slat_level(start=np.add(TRUTH, [0.03, 0.0]), errors=(np.inf, 0.01)))
    middle = found.parameters[0]
    assert abs(middle.value - TRUTH[0]) < 4 * middle.standard_error < 0.01


def test_what_leaves_the_ruler_far_behind_is_not_trusted():
    found = searched(slat_level(start=np.add(TRUTH, [0.02, 0.0]), errors=(0.002, 0.01)))
    assert not found.trusted
    assert any(doubt.startswith("middle") for doubt in found.doubts)
    assert not any(parameter.determined for parameter in found.parameters)


def test_what_only_shifts_the_image_is_no_better_known_than_by_the_ruler():
    level = slat_level(start=np.add(TRUTH, [0.005, 0.0]), errors=(0.01, 0.01))
    found = searched(level, shifting=np.array([True, False]))
    error = found.parameters[0].standard_error
    assert error == pytest.approx(np.hypot(0.01, found.parameters[0].ruler_errors_off * 0.01))


def test_a_photograph_that_shows_nothing_is_refused():
    level = slat_level()
    random = np.random.default_rng(0)
    level.averaged.light[:] = 1 + 0.01 * random.standard_normal(level.averaged.light.shape)
    with pytest.raises(PhotographError, match="shows no shadows"):
        searched(level)


def test_a_mirrored_photograph_is_doubted():
    level = slat_level(start=TRUTH, errors=(0.005, 0.005), noise=0.0005)
    light = level.averaged.picture(level.averaged.light)[:, ::-1].copy()
    level.averaged.light[:] = light.reshape(-1, 3)
    found = searched(level)
    assert any("mirrored" in doubt or "rotated" in doubt for doubt in found.doubts)


@pytest.mark.usefixtures("jit")
def test_linear_algebra_has_one_thread_as_long_as_the_search_lasts(monkeypatch):
    def threads(*_, **__):
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    monkeypatch.setattr(calibration, "search", threads)
    y, free = np.random.default_rng(0).random((32, 32, 3)), {"occluder_dx": 0.01}
    with threadpool_limits(2):
        found = calibration.calibrate(y, "chair", (6, 7), free, parameters={"resolution": 32})
        assert (found, threads()) == ({1}, {2})


@pytest.mark.usefixtures("jit")
def test_a_second_calibration_is_the_first_one_again(monkeypatch, tmp_path):
    """Where it begins, and which numbers only shift the image."""
    calls = []

    def search(coarse, fine, shifting, *_):
        assert coarse.prior is fine.prior
        calls.append((fine.prior.centers, fine.prior.errors, shifting))

    monkeypatch.setattr(calibration, "search", search)
    y, free = np.random.default_rng(0).random((32, 32, 3)), ["monitor_dx", "occluder_dz"]
    text = "trusted; monitor_dx = 0.02 from 0 +- 0.004: 1; occluder_dz = 0.01 from 0 +- 0.002: 0 1"
    found = {"monitor_dx": "0.02", "occluder_dz": "0.01", CALIBRATED: text}
    write_copy(find_scene("chair"), found, tmp_path / "found.xml")
    for scene in ("chair", tmp_path / "found.xml"):
        calibration.calibrate(y, scene, (6, 7), free, parameters={"resolution": 32})
    for one, other in zip(*calls, strict=True):
        np.testing.assert_array_equal(one, other)
    assert calls[0][2].tolist() == [True, False]


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
def test_a_chair_between_whole_patches_is_found_with_an_uncertain_monitor():
    """Half a patch aside, where an image of square patches has no minimum."""
    given = {"resolution": 32}
    moved = {"occluder_dx": 0.004, "occluder_dz": -0.003}
    scenario = ps.load_scenario("chair", (9, 11), {**given, **moved})
    image = ps.read_hidden_image(ps.find_image("mushroom"), (9, 11))
    A = ps.render_transport(scenario, samples=64, seed=9)
    light = (A @ image.reshape(-1, 3)).reshape(32, 32, 3)
    ambient = ps.point_light_backgrounds(scenario)[:, [40]].reshape(32, 32, 1)
    photograph = ps.add_noise(ps.composite(light, np.tile(ambient, 3), 1.0), 60, 3)
    found = ps.calibrate(
        photograph, "chair", (9, 11), list(moved), parameters=given,
        uncertain={"monitor_dx": 0.005},
    )  # fmt: skip
    assert found.trusted
    for parameter in found.parameters:
        assert parameter.value == pytest.approx(moved[parameter.name], abs=1e-3)
        assert parameter.standard_error > parameter.statistical_error
    # Were the monitor further to the right, the chair would be, too, by less.
    assert 1e-3 < found.moves[0, 0] < 5e-3
