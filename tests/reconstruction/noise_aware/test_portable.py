"""The portable method against `NoiseAware`, and what it refuses."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.portable import PortableNoiseAware

from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

HIDDEN = (5, 6)
PHOTOGRAPH = (20, 20)
RNG = np.random.default_rng(0)
A = RNG.random((400, 30))
B = RNG.random((400, 5))
EDGE = np.where(np.arange(6) < 3, 0.9, 0.1)[None, :, None] * np.array([1.0, 0.6, 0.3])
TRUTH = np.broadcast_to(EDGE, (*HIDDEN, 3)).reshape(30, 3)
LIGHT = np.stack([s * (A @ TRUTH) + 3 * B @ RNG.random((5, 3)) for s in (1.0, 5.0, 0.02, 40.0)])
PHOTOGRAPHS = (LIGHT + 5e-2 * RNG.standard_normal(LIGHT.shape)).reshape(4, *PHOTOGRAPH, 3)


@pytest.fixture(
    params=["numpy", "array_api_strict", pytest.param("torch", marks=pytest.mark.torch)]
)
def xp(request):
    return pytest.importorskip(request.param)


def fitted(**settings):
    return NoiseAware(A, B, hidden_shape=HIDDEN, **settings)


def portable(xp, **settings):
    return PortableNoiseAware(fitted(**settings), xp.zeros(1))


def recovered(xp, photographs, **settings):
    return portable(xp, **settings).reconstruct_batch(xp.asarray(photographs))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"channel_gain": np.array([1.0, 0.5, 2.0])},
        {"positive": False},
        {"regularization": 0.3},
        {"rank_tolerance": 0.1},
        {"max_iterations": 13},
        {"mask": RNG.random(PHOTOGRAPH) > 0.2, "wall_gain": False, "ambient_prior": False},
    ],
    ids=lambda settings: next(iter(settings), "defaults"),
)
@pytest.mark.filterwarnings("ignore:noise-aware recovery stopped")
def test_images_are_those_of_the_compiled_method(xp, settings):
    compiled = fitted(**settings)
    images = recovered(xp, PHOTOGRAPHS, **settings)
    assert type(images) is type(xp.asarray(PHOTOGRAPHS)) and images.dtype == xp.float32
    for image, photograph in zip(np.asarray(images), PHOTOGRAPHS, strict=True):
        expected = compiled.reconstruct(photograph)
        assert np.linalg.norm(image - expected) < 1e-3 * np.linalg.norm(expected)


def test_one_photograph_is_that_of_the_batch(xp):
    method = portable(xp)
    images = np.asarray(method.reconstruct_batch(xp.asarray(PHOTOGRAPHS)))
    single = np.asarray(method.reconstruct(xp.asarray(PHOTOGRAPHS[2])))
    assert np.linalg.norm(single - images[2]) < 1e-5 * np.linalg.norm(single)


def test_units_do_not_matter_and_black_stays_black(xp):
    images = np.asarray(recovered(xp, np.stack([PHOTOGRAPHS[0], 1e20 * PHOTOGRAPHS[0]])))
    np.testing.assert_allclose(images[1], 1e20 * images[0], rtol=1e-3, atol=1e15)
    black = np.asarray(recovered(xp, np.stack([0 * PHOTOGRAPHS[0], PHOTOGRAPHS[0]])))
    assert not black[0].any()
    np.testing.assert_allclose(black[1], images[0], rtol=1e-5, atol=1e-6)


def test_wrong_photographs_are_refused(xp):
    with pytest.raises(ValueError, match="A has 400 rows"):
        recovered(xp, np.ones((1, 19, 20, 3)))
    with pytest.raises(ValueError, match="20x20 pixels, the scene's camera 10x40"):
        recovered(xp, PHOTOGRAPHS, photograph_shape=(10, 40), wall_gain=False)
    with pytest.raises(ValueError, match="finite"):
        recovered(xp, np.full((1, 400, 3), np.nan))


@pytest.mark.parametrize("scale", [1e200, 1e-200])
def test_photographs_beyond_single_precision_are_refused(xp, scale):
    spoilt = np.stack([PHOTOGRAPHS[0], scale * PHOTOGRAPHS[1]])
    with pytest.raises(ValueError, match="scale it to between"):
        recovered(xp, spoilt)


def test_a_batch_short_of_the_tolerance_is_told(xp):
    batch = np.concatenate([PHOTOGRAPHS, 0 * PHOTOGRAPHS[:1]])  # the black one has converged
    with pytest.warns(RuntimeWarning, match="stopped after 13 iterations, before 4 of 5 images"):
        recovered(xp, batch, max_iterations=13)


def test_what_is_masked_may_be_anything(xp):
    mask = RNG.random(PHOTOGRAPH) > 0.2
    spoilt = np.where(mask[..., None], PHOTOGRAPHS, np.nan)
    settings = {"mask": mask, "wall_gain": False, "ambient_prior": False}
    images = (np.asarray(recovered(xp, each, **settings)) for each in (PHOTOGRAPHS, spoilt))
    np.testing.assert_array_equal(*images)
