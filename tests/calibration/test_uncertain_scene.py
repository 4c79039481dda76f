"""Changes of A by errors of the chair's parameters, against A elsewhere; coverage."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.prior import SceneCovariance
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Scenario

pytestmark = pytest.mark.usefixtures("jit")

HIDDEN, GIVEN = (4, 5), {"resolution": "24"}


@pytest.fixture
def chair(jit: None) -> Scenario:  # noqa: ARG001
    return ps.load_scenario("chair", HIDDEN, GIVEN)


@pytest.mark.parametrize(
    ("errors", "name"),
    [
        ({"occluder_x": 0.1}, "occluder_dx"),
        ({"occluder_dx": 0.0}, "occluder_dx"),
        ({"occluder_dx": float("inf")}, "occluder_dx"),
    ],
)
def test_errors_without_a_meaning_are_rejected(
    chair: Scenario, errors: dict[str, float], name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        ps.uncertain_transport(chair, errors)


def test_a_calibrated_scene_s_covariance_counts(chair: Scenario) -> None:
    covariance = np.array([[1e-6, 2e-5], [2e-5, 1e-2]])
    names, values = ("occluder_dx", "monitor_turn"), np.zeros(2)
    known = SceneCovariance(names, values, covariance, trusted=True, ruled=values)
    uncertain = ps.uncertain_transport(chair, known)
    image = np.ones((*HIDDEN, 3))
    errors = dict(zip(names, (1e-3, 0.1), strict=True))
    apart = ps.uncertain_transport(chair, errors).lights(image)
    lights = uncertain.lights(image).reshape(2, -1)
    expected = apart.reshape(2, -1)
    correlation = covariance / np.outer([1e-3, 0.1], [1e-3, 0.1])
    np.testing.assert_allclose(
        lights.T @ lights, expected.T @ correlation @ expected, atol=1e-3 * np.sum(expected**2)
    )


def test_an_error_of_the_monitor_s_place_displaces_the_image_as_far() -> None:
    hidden = (12, 15)
    chair = ps.load_scenario("chair", hidden, GIVEN)
    pitch = float(np.linalg.norm(chair.hidden.across[0]))
    A = ps.analytic_transport(chair)
    y, x = np.mgrid[:12, :15]
    blob = np.exp(-((y - 5.5) ** 2 + (x - 7) ** 2) / 8)[..., None] * np.array([1, 0.8, 0.5])
    photograph = ps.add_noise((A @ blob.reshape(-1, 3)).reshape(24, 24, 3), 60, 0)
    uncertain = ps.uncertain_transport(chair, {"monitor_dx": 0.8 * pitch})
    method = ps.NoiseAware.for_scene(chair, A, None, uncertain=uncertain)
    report = method.report(photograph, method.solve(photograph))
    down, across = report.numbers["place_standard_error"]
    assert across == pytest.approx(0.8, rel=0.15) and down < 0.05
    assert [note.code for note in report.notes] == ["place"]
