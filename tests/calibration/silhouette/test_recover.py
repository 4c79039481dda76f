import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.search.mask_moves import resized, shifted

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.silhouette import recover
from periscopy_sim.calibration.silhouette.recover import recover_silhouette
from periscopy_sim.calibration.silhouette.result import overlap
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.calibration.silhouette.conftest import FLAG, HIDDEN

pytestmark = pytest.mark.usefixtures("jit")


def image():
    """Colours that change from patch to patch, as strongly as a photograph's."""
    random = np.random.default_rng(7)
    return 0.1 + random.random((HIDDEN[0] * HIDDEN[1], 3)) ** 2


def photograph(scenario, sbr=1.0, snr=60):
    signal = render_transport(scenario, samples=36, pixel_samples=9, seed=11) @ image()
    ambient = point_light_backgrounds(scenario)[:, [40]]
    light = composite(signal.reshape(40, 40, 3), np.tile(ambient.reshape(40, 40, 1), 3), sbr)
    return add_noise(light, snr, 3)


@pytest.mark.thorough
def test_a_flag_is_found_cell_by_cell(scene, flagged):
    seen = []
    found = recover_silhouette(
        photograph(load_scenario(flagged, HIDDEN)), scene, HIDDEN, "card", FLAG.shape,
        progress=seen.append,
    )  # fmt: skip
    assert overlap(found.opaque, FLAG, 1) >= 0.85
    assert found.unexplained < 0.5 * found.unexplained_open
    assert found.told > 0.5 * FLAG.size
    assert not found.doubts
    assert seen == sorted(seen)
    assert seen[-1] == 1


@pytest.mark.thorough
def test_values_that_the_shape_alone_uses_may_be_given(scene, flagged, monkeypatch):
    monkeypatch.setattr(recover, "STARTS", 1)
    monkeypatch.setattr(recover, "FINALISTS", 1)
    given = {"size": 0.041, "shift": 0.0005}
    light = photograph(load_scenario(flagged, HIDDEN))
    found = recover_silhouette(light, scene, HIDDEN, "card", (4, 4), parameters=given)
    assert found.plane.sides == pytest.approx((0.082, 0.082))


def test_a_photograph_without_a_shadow_of_it_is_told_of(scene, empty, monkeypatch):
    monkeypatch.setattr(recover, "STARTS", 1)
    monkeypatch.setattr(recover, "FINALISTS", 1)
    with pytest.raises(PhotographError, match="shows no shadow of 'card'"):
        recover_silhouette(photograph(empty), scene, HIDDEN, "card", (4, 4))


@pytest.mark.thorough
def test_noise_that_hides_the_cells_is_told_of(scene, flagged, monkeypatch):
    monkeypatch.setattr(recover, "STARTS", 1)
    monkeypatch.setattr(recover, "FINALISTS", 1)
    noisy = photograph(load_scenario(flagged, HIDDEN), snr=42)
    with pytest.raises(SceneError, match=r"tells about \d+ numbers .* ask for fewer"):
        recover_silhouette(noisy, scene, HIDDEN, "card", (12, 12))


def test_shifts_keep_the_mask_within_its_rectangle():
    mask = np.zeros((8, 8))
    mask[3:5, 0:2] = 1
    places = shifted(mask, np.array([[1.0, 0.0], [0.0, 2.0]]))
    assert places[0] is mask
    assert len(places) == 7 * 4  # none to the left
    assert all(place.sum() == mask.sum() for place in places)


def test_masks_are_compared_wherever_they_are_shifted():
    moved = np.roll(FLAG, (1, -1), (0, 1))
    assert overlap(FLAG, moved, 1) == 1
    assert overlap(FLAG, moved, 0) < 0.8
    assert overlap(FLAG, np.zeros_like(FLAG)) == 0


def test_cells_of_another_grid_are_the_nearest():
    mask = np.arange(4.0).reshape(2, 2)
    np.testing.assert_array_equal(resized(mask, (4, 4)), np.kron(mask, np.ones((2, 2))))
    np.testing.assert_array_equal(resized(resized(mask, (6, 4)), (2, 2)), mask)
