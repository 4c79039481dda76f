import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.masks import CellShadows
from periscopy_sim.scenario import load_scenario
from periscopy_sim.testing import adjoint_test
from tests.scenes.silhouette import FLAG, HIDDEN

ALL = np.ones((40, 40), bool)


@pytest.fixture(scope="module")
def shadows(empty, plane):
    return CellShadows.of(area_transport(empty), empty, plane, FLAG.shape, ALL)


def averaged(path):
    """A of a scene, by areas, averaged over the pixels that the cells' shadows are of."""
    return area_transport(load_scenario(path, HIDDEN).averaged(3))


def test_opaque_cells_cast_the_shadows_of_a_mesh_of_them(shadows, flagged):
    light = shadows.open - shadows.matrix(FLAG.ravel().astype(float))
    expected = shadows.open - averaged(flagged)
    assert np.linalg.norm(light - expected) < 0.05 * np.linalg.norm(expected)
    np.testing.assert_allclose(
        light.sum(axis=1), expected.sum(axis=1), atol=0.03 * expected.sum(axis=1).max()
    )


def test_a_mask_that_is_opaque_everywhere_hides_what_its_rectangle_does(shadows, scene):
    A = shadows.matrix(np.ones(FLAG.size))
    assert A.min() > -1e-5 * A.max()
    light = averaged(scene).sum(axis=1)
    np.testing.assert_allclose(A.sum(axis=1), light, atol=0.03 * light.max())


def test_light_is_linear_in_opacities_and_its_adjoint_agrees(shadows):
    random = np.random.default_rng(0)
    image, opacities = random.random((HIDDEN[0] * HIDDEN[1], 2)), random.random(FLAG.size)
    A = shadows.matrix(opacities)
    one_by_one = [shadows.open - shadows.matrix(unit) for unit in np.eye(FLAG.size)]
    blocked = np.tensordot(opacities, [each @ image for each in one_by_one], 1)
    np.testing.assert_allclose(shadows.open @ image - blocked, A @ image, rtol=1e-4)
    products = lambda o: shadows.open - shadows.matrix(o), shadows.along
    adjoint_test(products, (opacities.shape, A.shape), rtol=1e-5)


def test_pixels_that_are_not_used_have_no_rows(empty, plane, shadows):
    used = np.random.default_rng(1).random((40, 40)) < 0.5
    some = CellShadows.of(shadows.open[used.ravel()], empty, plane, FLAG.shape, used)
    light, whole = (each.matrix(FLAG.ravel().astype(float)).sum(axis=1) for each in (some, shadows))
    np.testing.assert_allclose(light, whole[used.ravel()], rtol=0.02)
