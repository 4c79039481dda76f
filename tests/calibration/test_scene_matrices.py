import numpy as np
import pytest
from scipy import sparse

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.prior import InFront
from periscopy_sim.calibration.scene_matrices import FINER, SceneMatrices
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.shipped import find_scene

pytestmark = pytest.mark.usefixtures("jit")

CHAIR = find_scene("chair")
GIVEN = {"resolution": "24"}
NAMES = ("occluder_dx", "occluder_dz", "monitor_turn", "vertical_exponent")
VALUES = np.array([0.002, 0.0, 1.0, 17.0])


def chair(**changes):
    standard = {
        "path": CHAIR, "fixed": GIVEN, "names": NAMES, "steps": np.array([5e-3, 5e-3, 1.0, 2.0]),
        "photograph_shape": (24, 24), "hidden_shape": (5, 6),
    }  # fmt: skip
    return SceneMatrices(**{**standard, **changes})


def test_a_hat_is_a_sum_of_small_patches_and_all_hats_sum_to_the_monitor():
    """But for half of the outermost ones, which stand over the border."""
    hats, patches = chair(), chair(hats=False, hidden_shape=(10, 12))
    A, small = hats.matrix(VALUES), patches.matrix(VALUES)
    heights = np.zeros((5, 10))
    for k in range(5):
        for j, height in ((-1, 0.25), (0, 0.75), (1, 0.75), (2, 0.25)):
            if 0 <= 2 * k + j < 10:
                heights[k, 2 * k + j] = height
    along = np.zeros((6, 12))
    along[:5, :10] = heights
    along[5, 9:] = [0.25, 0.75, 0.75]
    along[4, 10] = 0.25
    expected = small @ sparse.kron(heights, along).toarray().T
    np.testing.assert_allclose(A, expected, rtol=1e-4, atol=1e-9)


def test_derivatives_are_those_by_finite_differences():
    matrices = chair()
    A, changes = matrices.linearized(VALUES)
    np.testing.assert_array_equal(A, matrices.matrix(VALUES))
    assert changes.shape == (1, 4, *A.shape)
    for k, h in enumerate((1e-4, 1e-4, 0.02, 0.05)):
        move = h * np.eye(4)[k]
        numeric = (matrices.matrix(VALUES + move) - matrices.matrix(VALUES - move)) / (2 * h)
        error = np.linalg.norm(changes[0, k] - numeric) / np.linalg.norm(numeric)
        assert error < 0.05, NAMES[k]


@pytest.mark.thorough
def test_rays_and_areas_agree():
    A, changes = chair().linearized(VALUES)
    by_rays, changes_by_rays = chair(samples=36).linearized(VALUES)
    assert np.linalg.norm(by_rays - A) < 0.02 * np.linalg.norm(A)
    assert changes_by_rays.shape == (2, 4, *A.shape)
    mean = changes_by_rays.mean(axis=0)
    for one, other in zip(mean, changes[0], strict=True):
        assert np.linalg.norm(one - other) < 0.3 * np.linalg.norm(other)


def test_point_lights_are_averaged_over_pixels():
    B = chair().point_lights(VALUES)
    finer = load_scenario(CHAIR, (5, 6), GIVEN, photograph=(24 * FINER, 24 * FINER))
    assert B.shape == (24 * 24, 512)
    whole = point_light_backgrounds(finer)
    assert B[:, 40].mean() == pytest.approx(whole[:, 40].mean(), rel=1e-6)


def test_a_scene_in_the_wall_is_not_physical():
    in_front = InFront(load_scenario(CHAIR, (5, 6), GIVEN))
    matrices = chair(names=("occluder_dy",), steps=np.array([0.01]), in_front=in_front)
    assert matrices.is_physical(np.array([0.0]))
    assert not matrices.is_physical(np.array([0.37]))
    with pytest.raises(SceneError, match="through the wall"):
        matrices.matrix(np.array([0.37]))


def test_at_the_border_derivatives_are_taken_to_the_other_side():
    matrices = chair(names=("seat_thickness",), steps=np.array([0.01]))
    thin = np.array([1e-4])
    _, changes = matrices.linearized(thin)
    assert np.isfinite(changes).all() and changes.any()
