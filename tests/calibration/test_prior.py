import numpy as np
import pytest

from periscopy_sim.calibration.prior import Prior, declared_errors, free_parameters, start_values
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


def test_penalty_and_slope_are_those_of_normal_distributions():
    prior = Prior(np.array([1.0, 2.0]), np.array([0.5, np.inf]))
    values = np.array([2.0, 7.0])
    assert prior.penalty(values) == 4.0
    h = 1e-6
    numeric = [
        (prior.penalty(values + step) - prior.penalty(values - step)) / (4 * h)
        for step in h * np.eye(2)
    ]
    np.testing.assert_allclose(prior.slope(values), numeric, atol=1e-8)
    np.testing.assert_array_equal(prior.precision, [4.0, 0.0])


def test_parameters_start_at_their_defaults_or_as_given():
    free = ["occluder_dx", "vertical_exponent"]
    np.testing.assert_array_equal(start_values(CHAIR, free, {"occluder_dx": "-0.05"}), [-0.05, 18])


@pytest.mark.parametrize(
    ("free", "given", "message"),
    [
        ([], {}, "no parameter is free"),
        (["occluder_dx", "sofa_dx"], {}, r"no parameter 'sofa_dx'; .*occluder_dx \(default 0\)"),
        (["occluder_dx", "occluder_dx"], {}, "free twice"),
        (["occluder_dx"], {"occluder_dx": "left"}, "-D occluder_dx=left"),
        (["occluder_dx"], {"occluder_dx": "nan"}, "-D occluder_dx=nan"),
    ],
)
def test_what_cannot_be_free_is_refused(free, given, message):
    with pytest.raises(SceneError, match=message):
        start_values(CHAIR, free, given)


def test_a_text_is_no_parameter(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text('<scene version="3.0.0"><default name="mesh" value="chair.ply"/></scene>')
    with pytest.raises(SceneError, match=r"'mesh' is no number .* declares none"):
        start_values(path, ["mesh"], {})


def scene(tmp_path, *defaults):
    path = tmp_path / "scene.xml"
    tags = "".join(f'<default name="{name}" value="{value}"/>' for name, value in defaults)
    path.write_text(f'<scene version="3.0.0">{tags}</scene>')
    return path


def test_what_the_scene_declares_an_error_of_is_free(tmp_path):
    path = scene(tmp_path, ("dx", 0), ("dx_error", 0.01), ("dy", 1), ("dy_error", 0), ("dz", 2))
    assert free_parameters(path, None, {}) == {"dx": 0.01}  # of an error of 0 it stays
    assert free_parameters(path, None, {"dy_error": "0.5"}) == {"dx": 0.01, "dy": 0.5}
    assert free_parameters(path, None, {"dx_error": "0"}) == {}
    assert free_parameters(path, None, {}, held=["dx"]) == {}


def test_named_parameters_have_their_error_or_the_scenes_or_none(tmp_path):
    path = scene(tmp_path, ("dx", 0), ("dx_error", 0.01), ("dy", 1), ("dy_error", 0), ("dz", 2))
    assert free_parameters(path, ["dz", "dx"], {}) == {"dz": np.inf, "dx": 0.01}
    assert free_parameters(path, {"dz": 0.2, "dx": None}, {}) == {"dz": 0.2, "dx": 0.01}
    assert free_parameters(path, {"dx": np.inf}, {}) == {"dx": np.inf}
    with pytest.raises(SceneError, match="ruler's error 0 of 'dy': give a positive number"):
        free_parameters(path, ["dy"], {})  # which stays
    with pytest.raises(SceneError, match="free is the text 'dx'; give a list"):
        free_parameters(path, "dx", {})


def test_an_error_is_no_parameter(tmp_path):
    path = scene(tmp_path, ("dx", 0), ("dx_error", 0.01))
    with pytest.raises(SceneError, match="'dx_error' is how well the ruler knows 'dx'"):
        start_values(path, ["dx_error"], {})


@pytest.mark.parametrize(
    ("defaults", "given", "message"),
    [
        ((("dx", 0), ("dz_error", 1)), {}, "declares 'dz_error', but no 'dz'"),
        ((("dx", 0), ("dx_error", -1)), {}, "'dx_error' is -1; give a standard deviation"),
        ((("dx", 0), ("dx_error", "mm")), {}, "'dx_error' is mm"),
        ((("dx", 0), ("dx_error", 1)), {"dx_error": "nan"}, "'dx_error' is nan"),
    ],
)
def test_errors_that_are_none_are_refused(tmp_path, defaults, given, message):
    with pytest.raises(SceneError, match=message):
        declared_errors(scene(tmp_path, *defaults), given)


@pytest.mark.parametrize(
    ("free", "message"),
    [
        ({"dx": 0.0}, "ruler's error 0 of 'dx'"),
        ({"dx": np.nan}, "ruler's error nan of 'dx'"),
        (["dx", "dx"], "'dx' is free twice"),
    ],
)
def test_named_errors_that_are_not_positive_are_refused(tmp_path, free, message):
    with pytest.raises(SceneError, match=message):
        free_parameters(scene(tmp_path, ("dx", 0)), free, {})


def test_a_scene_without_errors_asks_for_them(tmp_path):
    path = scene(tmp_path, ("dx", 0))
    assert free_parameters(path, None, {}) == {}
    with pytest.raises(SceneError, match=r"no parameter is free.*NAME_error.*declares dx \(0\)"):
        start_values(path, (), {})


@pytest.mark.parametrize("name", ["chair", "plate", "plant"])
def test_shipped_scenes_tell_how_well_a_ruler_knows_them(name):
    path = find_scene(name)
    errors = declared_errors(path, {})
    kinds = {error.split("_")[0] for error in errors}
    assert {"occluder", "monitor", "camera"} <= kinds
    likely = {
        **dict.fromkeys(("dx", "dy", "dz"), (0.005, 0.005)),  # metres
        **dict.fromkeys(("width", "depth", "height", "drop"), (0.0005, 0.001)),
        "thickness": (0.0005, 0.002),
        **dict.fromkeys(("turn", "pan", "tilt", "fov"), (0.3, 2)),  # degrees
        "stretch": (0.01, 0.01),
        "exponent": (0.5, 2),
    }
    for parameter, error in errors.items():
        least, most = likely[parameter.split("_")[1]]
        assert least <= error <= most, parameter


def test_the_chair_is_known_by_its_sizes():
    """A factor of its size, too, would be the same number again."""
    errors = declared_errors(CHAIR, {})
    assert len(errors) == 24
    assert not any(name.startswith("occluder_stretch") for name in errors)
    assert {errors[f"{name}_thickness"] for name in ("back", "crossbar")} == {0.002}  # assumed


def test_an_error_may_be_given_and_changes_nothing_that_is_seen():
    size = {"resolution": 8}
    plain, told = (
        load_scenario("chair", (2, 2), size | more) for more in ({}, {"occluder_dx_error": 0.1})
    )
    np.testing.assert_array_equal(plain.wall_points, told.wall_points)
    with pytest.raises(SceneError, match="declares no parameter 'sofa_error'"):
        load_scenario("chair", (2, 2), {"sofa_error": 0.1})
