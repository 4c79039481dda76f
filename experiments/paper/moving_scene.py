"""A hidden scene that moves: a ball bounces past a flag under a low sun."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OVERSAMPLING = 8
"""Points a patch across and down, averaged: a monitor's pixels within a patch."""

SKY, GROUND = np.array([0.02, 0.06, 0.22]), np.array([0.03, 0.20, 0.05])
SUN, BALL, STRIPE = np.array([1.0, 0.75, 0.15]), np.array([0.9, 0.06, 0.04]), np.ones(3)
HORIZON = 0.78
RADIUS = 0.13


def frame(shape: tuple[int, int], time: float) -> Array:
    """Show the scene at one moment.

    Parameters
    ----------
    shape
        (R, C) of the hidden image.
    time
        Seconds. The ball crosses the screen in 5 s, bouncing every 1.25 s, and comes back.

    Returns
    -------
    ndarray
        (R, C, 3) linear, in [0, 1].
    """
    rows, columns = (OVERSAMPLING * size for size in shape)
    aspect = shape[1] / shape[0]
    y = ((np.arange(rows) + 0.5) / rows)[:, None]
    x = (np.arange(columns) + 0.5) / columns * aspect  # in screen heights
    image = np.where((y < HORIZON)[..., None], SKY, GROUND) * np.ones((rows, columns, 3))

    def paint(where: NDArray[np.bool_], color: Array) -> None:
        image[where] = color

    paint(np.hypot(x - 0.82 * aspect, y - 0.24) < 0.12, SUN)
    # A flag of two stripes on a pole, waving.
    left, top = 0.16 * aspect, 0.2
    wave = 0.025 * np.sin(14 * (x - left) - 2 * np.pi * time)
    flag = (x > left) & (x < left + 0.3)
    for stripe, color in enumerate((STRIPE, 0.6 * SUN, BALL)):
        edge = top + 0.075 * stripe + wave
        paint(flag & (y > edge) & (y < edge + 0.075), color)
    paint((np.abs(x - left) < 0.015) & (y > top - 0.04) & (y < 0.86), 0.35 * STRIPE)
    path = np.abs((time / 5 + 1) % 2 - 1)
    height = 0.48 * np.abs(np.cos(np.pi * time / 1.25))
    center = RADIUS + (aspect - 2 * RADIUS) * path, 0.86 - RADIUS - height
    ball = np.hypot(x - center[0], y - center[1]) < RADIUS
    paint(ball, BALL)
    paint(ball & (np.abs(y - center[1]) < 0.035), STRIPE)
    patches = image.reshape(shape[0], OVERSAMPLING, shape[1], OVERSAMPLING, 3)
    return np.asarray(patches.mean(axis=(1, 3)))


def clip(shape: tuple[int, int], frames: int, rate: float = 16.0, start: float = 0.0) -> Array:
    """Show the scene at moments 1/rate seconds apart: (frames, R, C, 3)."""
    return np.stack([frame(shape, start + k / rate) for k in range(frames)])
