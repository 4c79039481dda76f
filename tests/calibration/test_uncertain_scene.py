"""Changes of A by errors of the chair's parameters, against A elsewhere; coverage."""

from __future__ import annotations

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration import uncertain_scene
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Scenario

pytestmark = pytest.mark.usefixtures("jit")

HIDDEN, GIVEN = (4, 5), {"resolution": "24"}


@pytest.fixture
def chair(jit: None) -> Scenario:  # noqa: ARG001
    return ps.load_scenario("chair", HIDDEN, GIVEN)


def moved(**values: float) -> Scenario:
    return ps.load_scenario("chair", HIDDEN, GIVEN | {k: str(v) for k, v in values.items()})


@pytest.mark.thorough
@pytest.mark.parametrize("by_area", [True, False])
def test_changes_are_half_the_difference_between_the_sides(
    chair: Scenario, by_area: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uncertain_scene, "has_areas", lambda _: by_area)
    fractions: list[float] = []
    found = ps.uncertain_transport(
        chair, {"occluder_dx": 0.004, "monitor_turn": 1.0}, samples=64, progress=fractions.append
    )
    assert (found.names, found.values.tolist()) == (("occluder_dx", "monitor_turn"), [0, 0])
    np.testing.assert_array_equal(found.directions, np.diag([0.004, 1.0]))
    assert found.changes.shape == (2, *chair.transport_shape) and fractions[-1] == 1
    for name, changed in zip(found.names, found.changes, strict=True):
        error = found.standard_errors[found.names.index(name)]
        sides = [
            ps.render_transport(moved(**{name: sign * error}), samples=1024, seed=5)
            for sign in (1, -1)
        ]
        change = (sides[0].astype(float) - sides[1]) / 2
        # Probes on patches this large overlook the shadows of thin legs here and there.
        assert np.linalg.norm(changed - change) < 0.3 * np.linalg.norm(change)


@pytest.mark.parametrize(
    ("errors", "name"),
    [
        ({"occluder_x": 0.1}, "occluder_dx"),
        ({"occluder_dx": 0.0}, "occluder_dx"),
        ({"occluder_dx": float("inf")}, "occluder_dx"),
        ({"resolution": 1.0}, "resolution"),  # another size of photograph
        ({"camera_dx": 1000.0}, "camera_dx"),
        ({"occluder_dy": 0.5}, "occluder_dy"),  # in the wall
    ],
)
def test_errors_without_a_meaning_are_rejected(
    chair: Scenario, errors: dict[str, float], name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        ps.uncertain_transport(chair, errors, samples=4)


def test_a_calibrated_scene_is_held_and_loses_what_nobody_sees(chair: Scenario) -> None:
    known = SceneCovariance(
        ("occluder_dx", "resolution"),
        np.array([0.0, 24.0]),
        np.diag([1e-6, 1.0]),
        trusted=True,
        ruled=np.zeros(2),
    )
    found = ps.uncertain_transport(chair, known, samples=4)
    assert found.changes.shape == (1, *chair.transport_shape)
    np.testing.assert_allclose(found.standard_errors, [1e-3, 0], atol=1e-12)
    unseen = SceneCovariance(
        ("resolution",), np.array([24.0]), np.eye(1), trusted=True, ruled=np.zeros(1)
    )
    with pytest.raises(SceneError, match="resolution"):
        ps.uncertain_transport(chair, unseen, samples=4)


@pytest.mark.slow
def test_intervals_cover_images_of_chairs_that_stand_elsewhere(jit: None) -> None:  # noqa: ARG001
    """Chairs, monitors and cameras drawn from their errors, before images that are known."""
    hidden, given = (12, 15), {"resolution": "63"}
    errors = {
        "occluder_dx": 1.5e-3, "occluder_dy": 1.5e-3, "occluder_dz": 1.5e-3, "monitor_dx": 1.5e-3,
        "monitor_dy": 1.5e-3, "monitor_dz": 1.5e-3, "occluder_turn": 0.6, "monitor_turn": 0.3,
    }  # fmt: skip
    scenario = ps.load_scenario("chair", hidden, given)
    A, B = ps.render_transport(scenario), ps.point_light_backgrounds(scenario)
    plain = ps.NoiseAware.for_scene(scenario, A, B)
    doubting = ps.NoiseAware.for_scene(
        scenario, A, B, uncertain=ps.uncertain_transport(scenario, errors)
    )
    random, covered, wrong = np.random.default_rng(11), np.zeros((8, 2)), np.zeros((8, 2))
    images = ("bars", "checker", "digits", "letters", "mushroom", "siemens", "still_life", "sunset")
    for draw, name in enumerate(images):
        image = ps.read_hidden_image(ps.find_image(name), hidden)
        there = {key: f"{error * random.standard_normal():.9g}" for key, error in errors.items()}
        elsewhere = ps.load_scenario("chair", hidden, given | there)
        signal = ps.render_transport(elsewhere, samples=64, seed=100 + draw) @ image.reshape(-1, 3)
        ambient = B @ random.random((B.shape[1], 1)) * np.array([1, 0.9, 0.8])
        shape = (63, 63, 3)
        light = ps.composite(signal.reshape(shape), ambient.reshape(shape), 10)
        y = ps.add_noise(light, 60, draw)
        truth = image / (signal.mean() * 1.1)  # a composite has mean 1, of which 1 in 11 is ambient
        for k, method in enumerate((plain, doubting)):
            found = method.solve(y)
            covered[draw, k] = np.mean(np.abs(found.image - truth) < method.standard_errors(found))
            wrong[draw, k] = ps.mean_squared_error(found.image, image)
    assert 0.6 < covered[:, 1].mean() < 0.85
    assert covered[:, 0].mean() < covered[:, 1].mean()
    assert wrong[:, 1].mean() < wrong[:, 0].mean() / 1.5
