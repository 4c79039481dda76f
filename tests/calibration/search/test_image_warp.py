"""Warps of a hidden image, against geometry: a chair moves shadows as a pinhole does an image."""

from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.fisher_information import (
    Curvature,
    Jacobian,
    curvature,
    differences,
)
from periscopy_sim.calibration.search.image_warp import displacements, undone, warped

from periscopy_sim.calibration.prior import Prior

SHAPE = (5, 6)
EVERY = np.ones(3, bool)


def test_displacements_are_a_patch_in_the_root_mean_square_and_differ():
    fields = displacements(SHAPE)
    gram = np.einsum("kaij,laij->kl", fields, fields) / 30
    np.testing.assert_allclose(gram, np.eye(6), atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 6), (6, 1)])
def test_a_line_of_patches_is_not_displaced_out_of_it(shape):
    fields = displacements(shape)
    assert fields.shape == (2, 2, *shape)
    assert not fields[:, shape.index(1)].any()
    assert not len(displacements((1, 1)))


def test_warps_shift_by_patches_and_stretch_about_the_middle():
    images = np.random.default_rng(0).random((30, 3))
    laid = images.reshape(*SHAPE, 3)
    down, grown, *_ = displacements(SHAPE)
    found = warped(images, down).reshape(*SHAPE, 3)
    np.testing.assert_allclose(found[1:], laid[:-1])
    assert not found[0].any()
    middle = warped(images, grown).reshape(*SHAPE, 3)[2]
    np.testing.assert_allclose(middle, laid[2])


@pytest.mark.thorough
def test_a_chair_moves_as_a_pinhole_does_that_follows_the_image(chair_before_a_small_image):
    level, scenario = chair_before_a_small_image
    start, steps = np.zeros(3), np.array([0.004, 0.004, 1.0])
    here = level.explain(start)
    about = curvature(level, start, here, differences(level, start, np.diag(steps)))
    moves, warps = undone(here, about, level.hidden_shape, EVERY)
    assert moves.shape[1] >= 2
    patch = [np.linalg.norm(each[0]) for each in (scenario.patch_across, scenario.patch_up)]
    monitor, wall = scenario.patch_centers[:, 1].mean(), scenario.wall_points[:, 1].mean()
    chair = np.mean([part.vertices[:, 1].mean() for part in scenario.occluders])
    # A pinhole there would have to move by this part of the image's shift.
    part = (wall - chair) / (wall - monitor)
    down, across = warps[0], warps[len(warps) // 2]
    np.testing.assert_allclose(
        np.abs(moves[0]), part * patch[0] * np.abs(across), atol=0.25 * part * patch[0]
    )
    np.testing.assert_allclose(
        np.abs(moves[1]), part * patch[1] * np.abs(down), atol=0.25 * part * patch[1]
    )


def known(moved, precision=0.0):
    """What a photograph tells of parameters that move it so, (P, M, 3)."""
    count = len(moved)
    prior = Prior(np.zeros(count), np.full(count, precision**-0.5 if precision else np.inf))
    jacobian = Jacobian(np.zeros((1, count)), moved[None], moved[None])
    zero = np.zeros(count)
    return Curvature(jacobian, zero, np.zeros((count, count)), zero, zero, prior)


@pytest.fixture
def seen():
    """An image of which the photograph shows each patch by itself."""
    images = np.random.default_rng(1).random((30, 3))
    return SimpleNamespace(images=images, shown=lambda change: 100 * change)


def test_what_moves_the_photograph_as_a_stretch_undoes_it_alone(seen):
    field = displacements(SHAPE)[1]
    stretch = 100 * (warped(seen.images, field) - warped(seen.images, -field)) / 2
    other = np.random.default_rng(2).standard_normal(stretch.shape)
    moves, warps = undone(seen, known(np.stack([4 * stretch, other])), SHAPE, np.ones(2, bool))
    np.testing.assert_allclose(np.abs(warps[:, 0]), np.eye(6)[1], atol=1e-3)
    np.testing.assert_allclose(moves[:, 0] * np.sign(warps[1, 0]), [-0.25, 0], atol=1e-3)


def test_of_a_lone_patch_nothing_is_undone(seen):
    moved = np.ones((2, 30, 3))
    moves, warps = undone(seen, known(moved, 1.0), (1, 1), np.ones(2, bool))
    assert moves.shape == (2, 0) and warps.shape == (0, 0)


def test_warps_that_are_undone_alike_are_walked_along_the_grid(seen):
    """Any mixture of two would do as well, but dips lie by whole patches along either."""
    fields = displacements(SHAPE)[[0, 3]]
    shifts = [100 * (warped(seen.images, d) - warped(seen.images, -d)) / 2 for d in fields]
    moves, warps = undone(seen, known(np.array(shifts)), SHAPE, np.ones(2, bool))
    np.testing.assert_array_equal(warps, np.eye(6)[:, [0, 3]])
    np.testing.assert_allclose(moves, -np.eye(2), atol=1e-3)


def test_what_may_not_move_or_a_ruler_holds_undoes_nothing(seen):
    field = displacements(SHAPE)[1]
    stretch = 100 * (warped(seen.images, field) - warped(seen.images, -field)) / 2
    for about, free in ((known(stretch[None]), False), (known(stretch[None], 1e12), True)):
        moves, warps = undone(seen, about, SHAPE, np.array([free]))
        assert moves.shape == (1, 0) and warps.shape == (6, 0)


def test_a_black_image_and_a_parameter_that_nobody_knows_have_no_warps(seen):
    stretch = np.ones((1, 30, 3))
    black = SimpleNamespace(images=np.zeros((30, 3)), shown=seen.shown)
    assert not undone(black, known(stretch), SHAPE, np.ones(1, bool))[0].size
    assert not undone(seen, known(0 * stretch), SHAPE, np.ones(1, bool))[0].size
