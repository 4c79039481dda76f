import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.search.mask_level import opaque, usual_opacity
from periscopy_sim.calibration.silhouette.search.mask_prior import improbability
from periscopy_sim.calibration.silhouette.search.opacity_descent import descend, smooth_mask


class Quadratic:
    """An evidence whose least is known: half of it is the squared distance from some opacities."""

    smoothness = np.eye(2)

    def __init__(self, goal):
        self.goal, self.allowances = goal, []

    def best_ratio(self, _, allowance):
        self.allowances.append(allowance)
        return 1.0

    def at(self, opacities, _, __, start):
        off = opacities - self.goal.ravel()
        return 2000 * off @ off, 4000 * off, start


def test_a_descent_ends_where_evidence_and_prior_are_least_together():
    goal = np.zeros((4, 5))
    goal[1:3, 1:4] = 0.8
    evidence = Quadratic(goal)
    found = descend(evidence, np.full((4, 5), 0.5), ((0.1, 30), (0.0, 60)))
    np.testing.assert_allclose(found.opacities, goal, atol=0.02)
    assert evidence.allowances == [0.1, 0.0]
    off = found.opacities - goal
    assert found.objective == pytest.approx(
        1000 * np.sum(off**2) + improbability(found.opacities)[0]
    )
    np.testing.assert_array_equal(found.opaque, goal > 0)


def test_opacities_stay_within_bounds():
    goal = np.linspace(-1, 2, 20).reshape(4, 5)
    found = descend(Quadratic(goal), np.full((4, 5), 0.5), ((0.0, 60),))
    assert found.opacities.min() >= 0
    assert found.opacities.max() <= 1


def test_random_masks_are_smooth_and_about_half_open():
    random = np.random.default_rng(0)
    masks = np.array([smooth_mask((16, 12), random) for _ in range(40)])
    assert ((masks > 0) & (masks < 1)).all()
    filled = (masks > 0.5).mean(axis=(1, 2))
    assert filled.min() > 0.25
    assert filled.max() < 0.65
    # Rough ones would differ from cell to cell as from mask to mask.
    assert np.abs(np.diff(masks, axis=2)).mean() < 0.4 * np.abs(np.diff(masks, axis=0)).mean()


def test_masks_of_one_cell_across_are_drawn_too():
    assert smooth_mask((6, 1), np.random.default_rng(0)).shape == (6, 1)


def test_a_fainter_mask_has_the_same_opaque_cells():
    mask = np.zeros((5, 5))
    mask[1:3, 1:4] = 1
    faint = 0.3 * mask + 0.05
    np.testing.assert_array_equal(opaque(faint), mask > 0)
    assert usual_opacity(0.3 * mask) == pytest.approx(0.3)
    assert not opaque(np.zeros((3, 3))).any()
