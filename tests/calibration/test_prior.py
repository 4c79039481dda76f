from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.calibration.prior import (
    Free,
    SceneCovariance,
    declared_errors,
    free_parameters,
    start_values,
    uncertain_parameters,
)
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scene import CALIBRATED, SceneDocument
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


@pytest.mark.parametrize(
    ("free", "given", "name"),
    [
        ([], {}, "chair"),
        (["occluder_dx", "sofa_dx"], {}, "sofa_dx"),
        (["occluder_dx"], {"occluder_dx": "left"}, "occluder_dx=left"),
        (["occluder_dx"], {"occluder_dx": "nan"}, "occluder_dx=nan"),
        (["occluder_dx_error"], {}, "occluder_dx_error"),
    ],
)
def test_parameters_that_cannot_be_free_are_rejected(
    free: list[str], given: dict[str, str], name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        start_values(read_document(CHAIR, given), free)


def test_a_text_is_no_parameter(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="mesh"):
        start_values(scene(tmp_path, ("mesh", "chair.ply")), ["mesh"])


def test_parameters_have_their_defaults_or_the_given_values() -> None:
    document = read_document(CHAIR, {"occluder_turn": "-1.5"})
    errors = {"occluder_turn": 2.0, "vertical_exponent": 0.03}
    held = uncertain_parameters(document, ("occluder_dx",), errors)
    assert held.names == tuple(errors)
    np.testing.assert_array_equal(held.values, [-1.5, 18])
    np.testing.assert_array_equal(held.values, start_values(document, held.names))
    np.testing.assert_array_equal(held.standard_errors, [2, 0.03])


def test_what_is_not_free_is_uncertain_as_calibrated_or_else_as_measured(tmp_path: Path) -> None:
    one, error = np.array([0.5]), np.array([[1e-6]])
    text = SceneCovariance(("x",), one, error, True, one).text()
    errors = [(f"{name}_error", 0.01) for name in "xyz"]
    document = scene(tmp_path, *((n, 0.5) for n in "xyz"), *errors, (CALIBRATED, text))
    held = uncertain_parameters(document, ("z",), None)
    assert held.names == ("x", "y")
    np.testing.assert_allclose(held.standard_errors, [1e-3, 0.01])


def scene(
    tmp_path: Path, *defaults: tuple[str, float | str], given: dict[str, str] | None = None
) -> SceneDocument:
    path = tmp_path / "scene.xml"
    tags = "".join(f'<default name="{name}" value="{value}"/>' for name, value in defaults)
    path.write_text(f'<scene version="3.0.0">{tags}</scene>')
    return read_document(path, given)


def test_what_the_scene_declares_an_error_of_is_free(tmp_path: Path) -> None:
    defaults = ("dx", 0), ("dx_error", 0.01), ("dy", 1), ("dy_error", 0), ("dz", 2)
    document = scene(tmp_path, *defaults)
    assert free_parameters(document) == {"dx": 0.01}  # of an error of 0 it stays
    assert free_parameters(document, held=["dx"]) == {}
    given = scene(tmp_path, *defaults, given={"dx_error": "0", "dy_error": "0.5"})
    assert free_parameters(given) == {"dy": 0.5}


def test_named_parameters_have_their_error_or_the_scenes(tmp_path: Path) -> None:
    document = scene(tmp_path, ("dx", 0), ("dx_error", 0.01), ("dz", 2))
    assert free_parameters(document, ["dx"]) == {"dx": 0.01}
    assert free_parameters(document, {"dz": 0.2, "dx": None}) == {"dz": 0.2, "dx": 0.01}


@pytest.mark.parametrize(
    ("free", "name"),
    [
        (["dy"], "dy"),  # its error is 0: it stays
        (["dz"], "dz"),  # of which no error is known
        ({"dz": np.inf}, "dz"),
        ({"dx": np.nan}, "dx"),
        ({"dx": 0.0}, "dx"),
        ("dy", "dy"),  # one name alone
    ],
)
def test_errors_that_are_missing_or_not_positive_are_rejected(
    tmp_path: Path, free: Free, name: str
) -> None:
    defaults = ("dx", 0), ("dx_error", 0.01), ("dy", 1), ("dy_error", 0), ("dz", 2)
    with pytest.raises(SceneError, match=name):
        free_parameters(scene(tmp_path, *defaults), free)


@pytest.mark.parametrize(
    ("defaults", "given", "name"),
    [
        ((("dx", 0), ("dz_error", 1)), {}, "dz_error"),
        ((("dx", 0), ("dx_error", -1)), {}, "dx_error"),
        ((("dx", 0), ("dx_error", "mm")), {}, "dx_error"),
        ((("dx", 0), ("dx_error", 1)), {"dx_error": "nan"}, "dx_error"),
    ],
)
def test_declared_errors_that_are_none_are_rejected(
    tmp_path: Path, defaults: tuple[tuple[str, float | str], ...], given: dict[str, str], name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        declared_errors(scene(tmp_path, *defaults, given=given))


@pytest.mark.parametrize("name", ["chair", "plate", "plant"])
def test_shipped_scenes_tell_how_well_a_ruler_knows_them(name: str) -> None:
    errors = declared_errors(read_document(find_scene(name)))
    assert {"occluder", "monitor", "camera"} <= {error.split("_")[0] for error in errors}
    degrees = "turn", "pan", "tilt", "fov", "exponent"
    for parameter, error in errors.items():  # in metres, the stretch as a fraction
        least, most = (0.3, 2) if parameter.split("_")[1] in degrees else (0.0005, 0.01)
        assert least <= error <= most, parameter
