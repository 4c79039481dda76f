"""The wall's colour in the channels of a photograph."""

import numpy as np

from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.validation import InputError


def wall_colour(known: Image | None, channels: int, mask: Mask | None) -> Array:
    """Return a wall's colour in so many channels, (1, C), or of each pixel used, (M', C).

    It is known by channel, (C,), of each pixel, (M, C), or grey, None. A photograph of one channel
    shows a texture's mean over the channels, and no colour of an even wall. A ValueError says that
    the channels do not fit.
    """
    values = np.ones((1, channels)) if known is None else np.atleast_2d(np.asarray(known))
    is_even = known is None or np.ndim(known) == 1
    gain = np.asarray(values if is_even or mask is None else values[mask], np.float64)
    if gain.shape[1] == channels:
        return gain
    if channels == 1:
        return np.ones((1, 1)) if is_even else gain.mean(axis=1, keepdims=True)
    if np.allclose(gain, gain[:, :1], rtol=1e-6):
        return np.tile(gain[:, :1], channels)
    raise InputError(
        f"the photograph has {channels} channels, the wall's colour {gain.shape[1]}; make the wall "
        f"grey in the scene, or give {gain.shape[1]} channels, or one"
    )
