import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.cells.cell_shadows import CellShadows

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.calibration.silhouette.conftest import FLAG, HIDDEN

pytestmark = pytest.mark.usefixtures("jit")
IMAGE = np.random.default_rng(3).random((HIDDEN[0] * HIDDEN[1], 3))


@pytest.fixture(scope="module")
def shadows(empty, plane):
    A = render_transport(empty, samples=64, pixel_samples=16, seed=1).astype(float)
    return CellShadows.of(A, empty, plane, FLAG.shape, np.ones((40, 40), bool))


@pytest.fixture(scope="module")
def noisy_shadows(empty, plane):
    """Of few rays in A."""
    A = render_transport(empty, samples=4, pixel_samples=4, seed=1).astype(float)
    return CellShadows.of(A, empty, plane, FLAG.shape, np.ones((40, 40), bool))


@pytest.mark.thorough
def test_opaque_cells_cast_the_shadows_of_a_mesh_of_them(shadows, flagged):
    A = shadows.matrix(FLAG.ravel().astype(float))
    rendered = [
        render_transport(load_scenario(flagged, HIDDEN), samples=64, pixel_samples=16, seed=seed)
        for seed in (2, 3)
    ]
    light = [each @ IMAGE for each in rendered]
    noise = np.linalg.norm(light[0] - light[1]) / np.sqrt(2)
    error = np.linalg.norm(A @ IMAGE - np.mean(light, axis=0))
    assert error < 1.5 * noise + 3e-4 * np.linalg.norm(light[0])
    shadow = np.linalg.norm((A - shadows.open) @ IMAGE)
    assert error < 0.02 * shadow


@pytest.mark.thorough
def test_a_mask_that_is_opaque_everywhere_hides_what_its_rectangle_does(shadows, scenario):
    A = shadows.matrix(np.ones(FLAG.size))
    rendered = render_transport(scenario, samples=64, pixel_samples=16, seed=4)
    np.testing.assert_allclose(A @ IMAGE, rendered @ IMAGE, rtol=0.03)
    assert (A > -1e-9).all()


def test_what_cells_hold_off_is_linear_and_its_adjoint_agrees(noisy_shadows):
    random = np.random.default_rng(0)
    opacities, gradient = random.random(FLAG.size), random.standard_normal(noisy_shadows.open.shape)
    A = noisy_shadows.matrix(opacities)
    held = np.tensordot(opacities, noisy_shadows.held_off(IMAGE), 1)
    np.testing.assert_allclose(noisy_shadows.open @ IMAGE - held, A @ IMAGE, rtol=1e-5)
    along = opacities @ noisy_shadows.along(gradient)
    assert along == pytest.approx(np.vdot(gradient, noisy_shadows.open - A), rel=1e-5)


def test_pixels_that_are_not_used_have_no_rows(empty, plane, noisy_shadows):
    used = np.random.default_rng(1).random((40, 40)) < 0.5
    some = CellShadows.of(noisy_shadows.open[used.ravel()], empty, plane, FLAG.shape, used)
    light, whole = (
        each.matrix(FLAG.ravel().astype(float)) @ IMAGE for each in (some, noisy_shadows)
    )
    np.testing.assert_allclose(light, whole[used.ravel()], rtol=0.01)  # each by rays of its own
