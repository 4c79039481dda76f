"""Of a shadow each cell holds the area, and the middle, that clipped polygons have there."""

import numba
import numpy as np
import pytest

from periscopy_sim.analytic.patch_light import SHEAR, cut_by_cells, outline_of, shadow_within

SHAPE = np.array([5, 6])
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])


@numba.njit
def shadow_of(border, layers):
    pieces = outline_of(border, layers, SHAPE[0])
    return shadow_within(cut_by_cells(border, pieces, SHAPE), SHAPE)


def found(*polygons):
    """Return the area and the moments, (3, R, C), of polygons, (n, 2), together."""
    border, layers = [], []
    for polygon in polygons:
        askew = polygon + SHEAR * polygon[:, :1] * [0, 1]
        for a, b in zip(askew, np.roll(askew, -1, axis=0), strict=True):
            down = a[1] <= b[1]
            border.append([*a, *b] if down else [*b, *a])
            layers.append(1 if down else -1)
    return shadow_of(np.array(border), np.array(layers))


def clipped(polygon, convex):
    """Return what of a polygon lies within a convex one (Sutherland, Hodgman, 1974)."""
    for a, b in zip(convex, np.roll(convex, -1, axis=0), strict=True):
        (x, y), (du, dv) = (polygon - a).T, b - a
        inside = du * y - dv * x
        kept = []
        for k, corner in enumerate(polygon):
            last = inside[k - 1]
            if (last < 0) != (inside[k] < 0):
                part = last / (last - inside[k])
                kept.append(polygon[k - 1] + part * (corner - polygon[k - 1]))
            if inside[k] >= 0:
                kept.append(corner)
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def moments(polygon):
    """Return a polygon's area and its moments, by the shoelace."""
    if not len(polygon):
        return np.zeros(3)
    other = np.roll(polygon, -1, axis=0)
    twice = polygon[:, 0] * other[:, 1] - other[:, 0] * polygon[:, 1]
    return np.array([twice.sum() / 2, *(twice @ (polygon + other) / 6)])


def expected(polygon):
    cells = [(r, c) for r in range(SHAPE[0]) for c in range(SHAPE[1])]
    each = [moments(clipped(polygon - [c + 0.5, r + 0.5], SQUARE - 0.5)) for r, c in cells]
    return np.transpose(each).reshape(3, *SHAPE)


@pytest.mark.parametrize("seed", range(6))
def test_a_polygon_anywhere_is_cut_by_cells(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.random(7)) * 2 * np.pi
    radii = rng.uniform(0.5, 4, (7, 1))  # a star, part of it beside the monitor
    star = rng.uniform([0, 0], [6, 5]) + radii * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if np.diff(angles, append=angles[0] + 2 * np.pi).max() > np.pi:
        star = star[:3] if moments(star[:3])[0] > 0 else star[2::-1]  # it would cross itself
    np.testing.assert_allclose(found(star), expected(star), atol=1e-6)
    np.testing.assert_allclose(found(star[::-1]), expected(star), atol=1e-6)


@pytest.mark.parametrize("roll", [0, 1e-12, -SHEAR, 1e-6, 1e-4, -1e-4])
def test_an_edge_all_but_along_the_rows_takes_from_each_column_its_own(roll):
    middle = np.array([2.8, 2.1])
    plate = middle + (SQUARE - 0.5) @ np.array([[4, 4 * roll], [-2 * roll, 2]])
    unrolled = middle + (SQUARE - 0.5) * [4, 2]
    np.testing.assert_allclose(found(plate), expected(plate), atol=1e-7)
    change = (expected(plate) - expected(unrolled))[0, 3]  # the row of its lower edge
    assert abs(found(plate)[0, 3] - found(unrolled)[0, 3] - change).max() <= 1e-7 + 1e-3 * abs(roll)
