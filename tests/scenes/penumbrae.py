"""A small scene by formulas: a wall, a monitor, three discs halfway and distant lamps."""

import numpy as np


def grid(rows, columns, center, size):
    """Positions (x, y, z) over an upright rectangle, row by row from the top."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    across, up = (column + 0.5) / columns - 0.5, 0.5 - (row + 0.5) / rows
    return np.array(center) + np.stack([size[0] * across, 0 * up, size[1] * up], axis=1)


def wall(photograph):
    return grid(*photograph, (0.6, 1.0, 0.25), (0.4, 0.4))


def transport(photograph, hidden, opacity):
    """Unoccluded light times the shadows of three discs."""
    points, patches = wall(photograph), grid(*hidden, (0.2, 0.0, 0.3), (0.4, 0.3))
    towards = points[:, None] - patches
    kernel = towards[..., 1] ** 2 / np.sum(towards**2, axis=2) ** 2
    crossing = (points[:, None] + patches) / 2
    shadow = np.zeros(kernel.shape, bool)
    for x, z, radius in [(0.36, 0.29, 0.05), (0.44, 0.23, 0.04), (0.42, 0.33, 0.03)]:
        shadow |= np.hypot(crossing[..., 0] - x, crossing[..., 2] - z) < radius
    return kernel * (1 - opacity * shadow)


def backgrounds(photograph, count):
    """Point lights in front of the wall: smooth fields, numerically of low rank."""
    lights = np.random.default_rng(1).uniform([-3, -6, -3], [3, 0, 3], (count, 3))
    away = lights - wall(photograph)[:, None]
    return -away[..., 1] / np.sum(away**2, axis=2) ** 1.5


def kept_basis(B, tolerance):
    """The rank rule by NumPy's SVD."""
    U, σ, _ = np.linalg.svd(B / np.linalg.norm(B, axis=0), full_matrices=False)
    return U[:, σ > tolerance * σ[0]]


def relative_error(value, truth):
    return np.linalg.norm(value - truth) / np.linalg.norm(truth)


def two_halves(hidden):
    """A coloured image of two flat halves, whose edge no median moves."""
    image = np.empty((*hidden, 3))
    image[:, : hidden[1] // 2] = [0.9, 0.3, 0.2]
    image[:, hidden[1] // 2 :] = [0.1, 0.4, 0.6]
    return image
