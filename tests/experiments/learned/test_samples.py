import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.evaluation.metrics import shifted
from periscopy_sim.rendering.scene_files import read_document

pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from experiments.learned.samples import as_displaced, ruler_values, solved  # noqa: E402


def test_ruler_values_are_off_by_declared_errors_from_the_true_ones():
    true = {"occluder_dx": 0.04, "seat_width": 0.08}
    errors = declared_errors(read_document(ps.find_scene("chair")))
    draws = [ruler_values(true, 0.5, np.random.default_rng(seed)) for seed in range(300)]
    assert all(draw.keys() == {*true, *errors} for draw in draws)
    for name, value in (("occluder_dx", 0.04), ("camera_dz", 0.0), ("seat_width", 0.08)):
        off = np.array([draw[name] - value for draw in draws]) / errors[name]
        # Clipped at two standard deviations, whose standard deviation then is 0.96.
        assert abs(off.mean()) < 4 * 0.5 / np.sqrt(300)
        assert off.std() == pytest.approx(0.48, abs=4 * 0.48 / np.sqrt(600))
        assert np.abs(off).max() <= 1 + 1e-9
    assert ruler_values(true, 0.0, np.random.default_rng(0))["occluder_dx"] == 0.04


@pytest.mark.parametrize("shift", [(0, 0), (1, -1.5), (-0.5, 2)])
def test_truth_is_moved_to_where_the_image_stands(shift):
    truth = ps.read_hidden_image(ps.find_image("mushroom"), (29, 36))
    image = shifted(truth, *shift)
    moved = as_displaced(truth, image)
    inner = slice(3, -3)
    assert moved[inner, inner] == pytest.approx(image[inner, inner], abs=0.15)
    assert np.mean((moved - image)[inner, inner] ** 2) < 0.1 * max(
        np.mean((truth - image)[inner, inner] ** 2), 1e-3
    )


@pytest.mark.usefixtures("jit")
def test_samples_are_of_the_scenes_own_patterns():
    scene = ps.load_scenario("chair", (4, 5), {"resolution": 21})
    rng = np.random.default_rng(0)
    image = rng.uniform(0.1, 1, (1, 4, 5, 3))
    light = scene.A @ image.reshape(20, 3)
    y = light + 1e-3 * light.mean() * rng.standard_normal(light.shape)
    samples = solved(scene, y.reshape(1, 21, 21, 3), image, np.ones(1), "train", False, seed=1)
    assert samples.rows.shape == (20, 20) and samples.curvatures.shape == (20,)
    assert samples.start.shape == (1, 3, 4, 5)
