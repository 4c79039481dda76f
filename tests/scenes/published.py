"""Captures in the layout of the published data."""

import numpy as np
import scipy.io

from periscopy_sim.storage.rasters import srgb_encode

COUNTS = 200.0  # for each unit of exposure, of the brightest photograph


NOISE = 2e-3  # of a photograph, over its mean, at an exposure of 20


def save_capture(path, light, truth, *, exposure=20.0, noise=NOISE, side=2, seed=0, **fields):
    """Write light, (rows, columns, 3), as the Bayer counts of a sensor with noise of its own.

    Each pixel becomes side x side colour pixels; the noise is that of their mean.
    """
    colour = np.repeat(np.repeat(light, side, axis=0), side, axis=1) * COUNTS * exposure
    # Both greens of a cell make the noise of its green smaller; red and blue are seen once.
    σ = noise * side * np.sqrt(20 / exposure) * colour.mean()
    draw = np.random.default_rng(seed).normal(0, σ, (4, *colour.shape[:2]))
    image = np.empty((2 * colour.shape[0], 2 * colour.shape[1]))
    image[0::2, 0::2] = colour[..., 0] + draw[0]
    image[0::2, 1::2] = colour[..., 1] + draw[1]
    image[1::2, 0::2] = colour[..., 1] + draw[2]
    image[1::2, 1::2] = colour[..., 2] + draw[3]
    saved = {"image": image, "shutter_speed": exposure / 4, "iterations": 4.0, **fields}
    if truth is not None:
        saved["ground_truth"] = np.rint(255 * srgb_encode(truth))
    path.parent.mkdir(parents=True, exist_ok=True)
    scipy.io.savemat(path, saved)
