"""Photographs of every kind of array, and extreme ones: the same image, and no warnings."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.large_scale.iterative import IterativePeriscope
from periscopy_sim.reconstruction.preconditioned.still import Periscope
from periscopy_sim.reconstruction.preconditioned.video import Video

SHAPE, HIDDEN = (12, 10), (4, 5)
RNG = np.random.default_rng(0)
A = (RNG.random((120, 20)) + np.eye(120, 20)).astype(np.float32)
B = RNG.random((120, 5))
PHOTOGRAPH = (A @ RNG.random((20, 3))).reshape(*SHAPE, 3) + 0.01 * RNG.random((*SHAPE, 3))


def read_only(y):
    y = y.copy()
    y.setflags(write=False)
    return y


def spread(y):
    within = np.full((2 * y.shape[0], 3 * y.shape[1], 6), np.nan)
    within[::2, ::3, ::2] = y
    return within[::2, ::3, ::2]


def unaligned(y):
    return np.ndarray(y.shape, y.dtype, bytearray(b"\0" + y.tobytes()), 1)


KINDS = {
    "float32": lambda y: y.astype(np.float32),
    "float16": lambda y: y.astype(np.float16),
    "long double": lambda y: y.astype(np.longdouble),
    "big-endian": lambda y: y.astype(">f8"),
    "big-endian float32": lambda y: y.astype(">f4"),
    "8 bits": lambda y: (100 * y / y.max()).astype(np.uint8),
    "16 bits": lambda y: (60_000 * y / y.max()).astype(">u2"),
    "signed": lambda y: (-1e6 * y).astype(np.int32),
    "64 bits": lambda y: (1e18 * y / y.max()).astype(np.uint64),
    "truth values": lambda y: y > np.median(y),
    "Fortran order": np.asfortranarray,
    "read-only": read_only,
    "not contiguous": spread,
    "negative strides": lambda y: y[::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1],
    "not aligned": unaligned,
    "nested lists": lambda y: y.tolist(),
    "one row a pixel": lambda y: y.reshape(-1, 3),
}
METHODS = {
    "preconditioned": lambda: Periscope(A, B, hidden=HIDDEN).reconstruct,
    "iterative": lambda: IterativePeriscope(A, B, hidden=HIDDEN).reconstruct,
    "video": lambda: Video(Periscope(A, B, hidden=HIDDEN)).next_frame,
}


@pytest.mark.filterwarnings("ignore:the photograph is of 8-bit integers")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_array_gives_the_image_of_its_values(method, kind):
    photograph = KINDS[kind](PHOTOGRAPH)
    plain = np.array(photograph, np.float64, order="C")
    expected = METHODS[method]()(plain)
    found = METHODS[method]()(photograph)
    assert found.shape == (*HIDDEN, 3) and found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def hot(y):
    y = 0 * y
    y[3, 4, 1] = 1e6
    return y


EXTREMES = {
    "constant": np.ones_like,
    "one hot value": hot,
    "a hot pixel in light": lambda y: y + hot(y),
    "saturated": lambda y: np.minimum(y, np.quantile(y, 0.2)),
    "one channel dark": lambda y: y * [1, 0, 1],
    "dark": np.zeros_like,
    "negative": lambda y: -y,
    "of 2 levels": lambda y: np.round(y / y.max()),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("extreme", EXTREMES)
def test_extreme_photographs_give_finite_images_in_proportion(method, extreme):
    photograph = EXTREMES[extreme](PHOTOGRAPH)
    image = METHODS[method]()(photograph)
    assert np.isfinite(image).all()
    thousandfold = METHODS[method]()(1024 * photograph)
    np.testing.assert_allclose(thousandfold, 1024 * image, atol=1e-4 * np.abs(thousandfold).max())
