from pathlib import Path
from typing import Any

import numpy as np
import pytest

from periscopy_sim.calibration import prior
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scene import CALIBRATED, SceneDocument
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


def test_parameters_have_their_defaults_or_the_given_values() -> None:
    document = read_document(CHAIR, {"occluder_turn": "-1.5"})
    errors = {"occluder_turn": 2.0, "vertical_exponent": 0.03}
    held = prior.uncertain_parameters(document, ("occluder_dx",), errors)
    assert held.names == tuple(errors)
    np.testing.assert_array_equal(held.values, [-1.5, 18])
    np.testing.assert_array_equal(held.values, prior.start_values(document, held.names))
    np.testing.assert_array_equal(held.standard_errors, [2, 0.03])


def test_what_is_not_free_is_uncertain_as_calibrated_or_else_as_measured(tmp_path: Path) -> None:
    one, error = np.array([0.5]), np.array([[1e-6]])
    text = prior.SceneCovariance(("x",), one, error, True, one).text()
    errors = [(f"{name}_error", 0.01) for name in "xyz"]
    document = scene(tmp_path, *((n, 0.5) for n in "xyz"), *errors, (CALIBRATED, text))
    held = prior.uncertain_parameters(document, ("z",), None)
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
    assert prior.free_parameters(document) == {"dx": 0.01}  # of an error of 0 it stays
    assert prior.free_parameters(document, held=["dx"]) == {}
    given = scene(tmp_path, *defaults, given={"dx_error": "0", "dy_error": "0.5"})
    assert prior.free_parameters(given) == {"dy": 0.5}


def test_named_parameters_have_their_error_or_the_scenes(tmp_path: Path) -> None:
    document = scene(tmp_path, ("dx", 0), ("dx_error", 0.01), ("dz", 2))
    assert prior.free_parameters(document, ["dx"]) == {"dx": 0.01}
    assert prior.free_parameters(document, {"dz": 0.2, "dx": None}) == {"dz": 0.2, "dx": 0.01}


KNOWN = ("dx", 0), ("dx_error", 0.01), ("dy", 1), ("dy_error", 0), ("dz", 2), ("mesh", "a.ply")


@pytest.mark.parametrize(
    ("asked", "defaults", "wrong", "name"),
    [
        (prior.start_values, KNOWN, [], "scene"),
        (prior.start_values, KNOWN, ["dx", "sofa_dx"], "sofa_dx"),
        (prior.start_values, [("dx", "left")], ["dx"], "dx=left"),
        (prior.start_values, [("dx", "nan")], ["dx"], "dx=nan"),
        (prior.start_values, KNOWN, ["dx_error"], "dx_error"),
        (prior.start_values, KNOWN, ["mesh"], "mesh"),
        (prior.free_parameters, KNOWN, ["dy"], "dy"),  # its error is 0: it stays
        (prior.free_parameters, KNOWN, ["dz"], "dz"),  # of which no error is known
        (prior.free_parameters, KNOWN, {"dz": np.inf}, "dz"),
        (prior.free_parameters, KNOWN, {"dx": np.nan}, "dx"),
        (prior.free_parameters, KNOWN, {"dx": 0.0}, "dx"),
        (prior.free_parameters, KNOWN, "dy", "dy"),  # one name alone
        (prior.free_parameters, [("dx", 0), ("dz_error", 1)], None, "dz_error"),
        (prior.free_parameters, [("dx", 0), ("dx_error", -1)], None, "dx_error"),
        (prior.free_parameters, [("dx", 0), ("dx_error", "mm")], None, "dx_error"),
        (prior.free_parameters, [("dx", 0), ("dx_error", "nan")], None, "dx_error"),
    ],
)
def test_wrong_parameters_and_errors_are_named(
    tmp_path: Path, asked: Any, defaults: Any, wrong: Any, name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        asked(scene(tmp_path, *defaults), wrong)


@pytest.mark.parametrize("name", ["chair", "plate", "plant"])
def test_shipped_scenes_tell_how_well_a_ruler_knows_them(name: str) -> None:
    errors = prior.declared_errors(read_document(find_scene(name)))
    assert {"occluder", "monitor", "camera"} <= {error.split("_")[0] for error in errors}
    degrees = "turn", "pan", "tilt", "fov", "exponent"
    for parameter, error in errors.items():  # in metres, the stretch as a fraction
        least, most = (0.3, 2) if parameter.split("_")[1] in degrees else (0.0005, 0.01)
        assert least <= error <= most, parameter
