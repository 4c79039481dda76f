"""Derivatives by what moves over a border are those of the areas, in double precision."""

import numpy as np
import pytest

from periscopy_sim.analytic import patch_light
from periscopy_sim.testing import derivative_test
from tests.scenes.boxes import Box

SHAPE = np.array([25, 24])
CUT = np.array([5, 4])
TO_CELLS = np.array([4, 5, 1])  # from patches of 7 by 5 cm
CELLS = np.array([0.07, 0.05]) / TO_CELLS[:2]
PATCHES = 30
EXPONENTS = np.array([3.0, 1.5])
NUDGE = 1e-7
CORNERS = 2.0 * np.indices((2, 2, 2)).reshape(3, 8).T - 1


def light(points, normals, cells, exponents, meshes):
    out = np.empty((len(points), PATCHES))
    lit = patch_light.Lighting(points, normals, cells, exponents)
    patch_light.light_rows(lit, patch_light.borders_of(meshes), SHAPE, CUT, out)
    return out


def derivatives(points, normals, meshes, moved):
    """Derivatives along one move of (points, normals, cells, exponents, vertices)."""
    out = np.empty((1, len(points), PATCHES), np.float32)
    borders = patch_light.borders_of(meshes)
    *still, vertices = (np.asarray(each)[None] for each in moved)
    lit = patch_light.Lighting(points, normals, CELLS, EXPONENTS)
    moved_vertices = vertices[:, borders.sources]
    patch_light.light_derivatives(
        lit, patch_light.Lighting(*still), moved_vertices, borders, SHAPE, CUT, out
    )
    return out[0]


def room(seed, turned):
    """Wall points before a monitor of 6 x 5 patches, and two boxes between; (u, v, h)."""
    random = np.random.default_rng(seed)
    points = random.uniform([-2, -2, 0.9], [8, 7, 1.1], (40, 2, 3))
    normals = np.array([0.1, -0.05, -1.0]) + 0.02 * random.standard_normal(points.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points *= TO_CELLS
    meshes = []
    for k in range(2):
        occluder = Box.random(random).occluder(f"box{k}")
        body = occluder.vertices - occluder.vertices.mean(axis=0) if turned else CORNERS
        size = np.array([0.75, 0.6, 0.15]) / np.abs(body).max()
        place = random.uniform([1, 1, 0.3], [5, 4, 0.6])
        meshes.append(((body * size + place) * TO_CELLS, occluder.faces))
    return points, normals, meshes, random


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("moves", ["boxes", "boxes down", "camera", "monitor", "falloff"])
def test_they_are_the_derivatives_of_the_areas(moves, turned):
    points, normals, meshes, random = room(0, turned)
    count = sum(len(vertices) for vertices, _ in meshes)
    moved = [np.zeros_like(points), np.zeros_like(normals), np.zeros(2), np.zeros(2)]
    vertices = np.zeros((count, 3))
    if moves == "boxes":
        vertices = random.standard_normal((count, 3)) * TO_CELLS
    elif moves == "boxes down":
        vertices[:, 1] = 5.0
    elif moves == "camera":
        moved[:2] = random.standard_normal((2, *points.shape)) * TO_CELLS
    elif moves == "monitor":
        moved[0] += [0.3, 0.4, 0.1] * TO_CELLS
        vertices += [0.3, 0.4, 0.1] * TO_CELLS
        moved[2] = CELLS
    else:
        moved[3] = np.array([0.7, -0.4])
    found = derivatives(points, normals, meshes, (*moved, vertices))

    def at(nudge):
        parts = np.split(vertices, np.cumsum([len(v) for v, _ in meshes])[:-1])
        nudged = [(v + nudge * part, f) for (v, f), part in zip(meshes, parts, strict=True)]
        ends = (points, normals, CELLS, EXPONENTS)
        return light(*(a + nudge * b for a, b in zip(ends, moved, strict=True)), nudged)

    assert np.linalg.norm(found) > 0.01
    # Within a cell the areas take light for linear.
    derivative_test(lambda nudge: at(nudge[0]), [found], [0.0], steps=NUDGE, rtol=1e-3)


@pytest.mark.parametrize("normal", [(0.1, -0.05, -1.0), (1.0, 0.3, 0.0)])  # the second clips
def test_gradient_is_that_of_the_light(normal):
    random = np.random.default_rng(4)
    shadow = random.uniform(0, 0.2, (3, 6, 5))
    point = np.array([3.3, -1.2, 0.9, *normal, *CELLS, *EXPONENTS])

    def lit(values):
        out = np.zeros((6, 5))
        patch_light.add_light(*np.split(values, [3, 6, 8]), shadow, out)
        return out

    found = np.empty((patch_light.NUMBERS, 6, 5))
    patch_light.light_gradient(*np.split(point, [3, 6, 8]), shadow, found)
    assert (lit(point) == 0).any() == (normal[0] == 1.0)
    derivative_test(lit, list(found), point, steps=1e-6, rtol=1e-6)
