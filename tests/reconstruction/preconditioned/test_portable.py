"""The portable method against `Periscope`, and what it refuses."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.preconditioned.portable import PortablePeriscope
from periscopy_sim.reconstruction.preconditioned.still import Periscope
from periscopy_sim.reconstruction.preconditioned.video import Video

HIDDEN = (5, 6)
PHOTOGRAPH = (20, 20)
RNG = np.random.default_rng(0)
A = RNG.random((400, 30))
B = RNG.random((400, 5))
TRUTH = RNG.random((4, 30, 3))
SIGNAL = np.stack([A @ f + 3 * B @ RNG.random((5, 3)) for f in TRUTH])
PHOTOGRAPHS = (SIGNAL + 1e-2 * RNG.standard_normal(SIGNAL.shape)).reshape(4, *PHOTOGRAPH, 3)


@pytest.fixture(
    params=["numpy", "array_api_strict", pytest.param("torch", marks=pytest.mark.torch)]
)
def xp(request):
    return pytest.importorskip(request.param)


def fitted(xp, **settings):
    return PortablePeriscope(xp.asarray(A), xp.asarray(B), hidden_shape=HIDDEN, **settings)


def relative_error(value, truth):
    return np.linalg.norm(value - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"channel_gain": [1.0, 0.5, 2.0]},
        {"tv_weight": 0.0, "repair_threshold": float("inf")},
        {"tv_weight": 3.0, "repair_threshold": 0.02},
        {"rank_tolerance": 1e-3},
    ],
)
def test_images_are_those_of_the_compiled_method(xp, settings):
    compiled = Periscope(A, B, hidden_shape=HIDDEN, **settings)
    images = fitted(xp, **settings).reconstruct_batch(xp.asarray(PHOTOGRAPHS))
    assert type(images) is type(xp.asarray(PHOTOGRAPHS)) and images.dtype == xp.float32
    for image, photograph in zip(np.asarray(images), PHOTOGRAPHS, strict=True):
        assert relative_error(image, compiled.reconstruct(photograph)) < 1e-3


def test_one_photograph_is_that_of_the_batch(xp):
    periscope = fitted(xp)
    images = np.asarray(periscope.reconstruct_batch(xp.asarray(PHOTOGRAPHS)))
    single = np.asarray(periscope.reconstruct(xp.asarray(PHOTOGRAPHS[2])))
    assert relative_error(single, images[2]) < 1e-3


def test_hidden_image_is_recovered_without_noise(xp):
    periscope = fitted(xp, repair_threshold=float("inf"))
    image = np.asarray(periscope.reconstruct(xp.asarray(SIGNAL[0])))
    assert relative_error(image.reshape(-1, 3), TRUTH[0]) < 1e-3


def test_no_background_model_is_the_pseudoinverse(xp):
    periscope = PortablePeriscope(
        xp.asarray(A), hidden_shape=HIDDEN, tv_weight=0, repair_threshold=float("inf")
    )
    image = np.asarray(periscope.reconstruct(xp.asarray(PHOTOGRAPHS[0])))
    expected = np.linalg.pinv(A) @ PHOTOGRAPHS[0].reshape(-1, 3)
    assert relative_error(image.reshape(-1, 3), expected) < 1e-5


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_photograph_that_is_not_finite_is_refused(xp, value):
    spoilt = PHOTOGRAPHS[0].copy()
    spoilt[3, 4, 1] = value
    with pytest.raises(ValueError, match="must be finite"):
        fitted(xp).reconstruct(xp.asarray(spoilt))


def test_sizes_that_do_not_fit_are_refused(xp):
    with pytest.raises(ValueError, match="5x7 patches"):
        PortablePeriscope(xp.asarray(A), hidden_shape=(5, 7))
    with pytest.raises(ValueError, match="rows must match the 400"):
        PortablePeriscope(xp.asarray(A), xp.asarray(B[1:]), hidden_shape=HIDDEN)
    with pytest.raises(ValueError, match="A has 400 rows"):
        fitted(xp).reconstruct(xp.asarray(PHOTOGRAPHS[0, 1:]))
    with pytest.raises(ValueError, match=r"40x10 pixels.*20x20"):
        fitted(xp, photograph_shape=PHOTOGRAPH).reconstruct(
            xp.asarray(PHOTOGRAPHS[0].reshape(40, 10, 3))
        )


def test_patches_that_cannot_be_told_apart_are_refused(xp):
    spoilt = A.copy()
    spoilt[:, 3] = spoilt[:, 5] + 0.5 * spoilt[:, 7]
    with pytest.raises(ValueError, match="not full column rank"):
        PortablePeriscope(xp.asarray(spoilt), xp.asarray(B), hidden_shape=HIDDEN)
    spoilt[:, 3] = 0
    with pytest.raises(ValueError, match="not full column rank"):
        PortablePeriscope(xp.asarray(spoilt), hidden_shape=HIDDEN)


@pytest.mark.parametrize(
    "settings",
    [
        {"tv_weight": -1.0},
        {"tv_weight": float("nan")},
        {"repair_threshold": -0.1},
        {"rank_tolerance": 0.0},
        {"rank_tolerance": 2.0},
        {"channel_gain": [1.0, 0.0, 1.0]},
        {"channel_gain": [1.0, 1.0]},
    ],
)
def test_numbers_out_of_range_are_refused(xp, settings):
    with pytest.raises(ValueError, match=r"must not be negative|three positive numbers"):
        fitted(xp, **settings)


def test_matrices_that_are_not_finite_are_refused(xp):
    for which in range(2):
        arrays = [A.copy(), B.copy()]
        arrays[which][3, 2] = np.nan
        with pytest.raises(ValueError, match=f"{'AB'[which]} must be finite"):
            PortablePeriscope(*(xp.asarray(part) for part in arrays), hidden_shape=HIDDEN)


@pytest.mark.parametrize("unit", [1e-22, 1e18])
def test_unit_of_the_photograph_does_not_matter(xp, unit):
    periscope = fitted(xp)
    expected = np.asarray(periscope.reconstruct(xp.asarray(PHOTOGRAPHS[0])), np.float64)
    found = np.asarray(periscope.reconstruct(xp.asarray(unit * PHOTOGRAPHS[0])), np.float64)
    assert relative_error(found / unit, expected) < 1e-3


@pytest.mark.parametrize("coupling", ["l1", "total-variation", "none"])
@pytest.mark.parametrize("threshold", [0.02, float("inf")])
def test_frames_of_a_video_are_those_of_the_compiled_method(xp, coupling, threshold):
    weights = {"coupling": coupling, "temporal_weight": 2.0, "l1_weight": 3.0}
    compiled = Video(Periscope(A, B, hidden_shape=HIDDEN, repair_threshold=threshold), **weights)
    periscope = fitted(xp, repair_threshold=threshold)
    previous = periscope.reconstruct(xp.asarray(PHOTOGRAPHS[0]))
    compiled.next_frame(PHOTOGRAPHS[0])
    for photograph in PHOTOGRAPHS[1:]:
        previous = periscope.reconstruct_next(xp.asarray(photograph), previous, **weights)
        assert type(previous) is type(xp.asarray(PHOTOGRAPHS)) and previous.dtype == xp.float32
        assert relative_error(np.asarray(previous), compiled.next_frame(photograph)) < 3e-3


def test_previous_frames_that_do_not_fit_are_refused(xp):
    periscope = fitted(xp)
    y = xp.asarray(PHOTOGRAPHS[0])
    for previous in (np.zeros((6, 5, 3)), np.full((5, 6, 3), np.nan)):
        with pytest.raises(ValueError, match="previous frame has shape"):
            periscope.reconstruct_next(y, xp.asarray(previous))
    with pytest.raises(ValueError, match="coupling 'flow' is not known"):
        periscope.reconstruct_next(y, periscope.reconstruct(y), coupling="flow")


def test_mask_of_either_library_leaves_pixels_out(xp):
    mask = np.random.default_rng(7).random(PHOTOGRAPH) > 0.2
    spoilt = np.where(mask[..., None], PHOTOGRAPHS[0], np.nan)
    by_hand = Periscope(A[mask.ravel()], B[mask.ravel()], hidden_shape=HIDDEN)
    expected = by_hand.reconstruct(PHOTOGRAPHS[0][mask])
    for given in (mask, xp.asarray(mask), mask.ravel()):
        image = np.asarray(fitted(xp, mask=given).reconstruct(xp.asarray(spoilt)))
        assert relative_error(image, expected) < 1e-3


def test_frames_of_a_video_leave_out_the_same(xp):
    mask = np.random.default_rng(7).random(PHOTOGRAPH) > 0.2
    spoilt = np.where(mask[..., None], PHOTOGRAPHS, np.inf)
    compiled = Video(Periscope(A, B, hidden_shape=HIDDEN, mask=mask))
    expected = compiled.frames(PHOTOGRAPHS[:2])
    periscope = fitted(xp, mask=mask)
    previous = periscope.reconstruct(xp.asarray(spoilt[0]))
    frame = np.asarray(periscope.reconstruct_next(xp.asarray(spoilt[1]), previous))
    assert relative_error(frame, expected[1]) < 3e-3


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros(PHOTOGRAPH, bool), "leaves out every pixel"),
        (np.arange(400) < 29, "leaves 29 pixels for 30 patches"),
        (np.ones((20, 21), bool), r"shape \(20, 21\)"),
        (np.ones(PHOTOGRAPH), "must be boolean"),
    ],
)
def test_mask_that_does_not_fit_is_refused(xp, mask, message):
    with pytest.raises(ValueError, match=message):
        fitted(xp, mask=xp.asarray(mask))
    with pytest.raises(ValueError, match=r"20x20 pixels, the scene's camera 40x10|40x10 pixels"):
        fitted(xp, mask=np.ones(PHOTOGRAPH, bool)).reconstruct(
            xp.asarray(PHOTOGRAPHS[0].reshape(40, 10, 3))
        )
