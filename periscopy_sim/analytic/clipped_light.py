"""What a wall point sees of a hidden surface of any shape: patches clipped by occluders' faces.

A wall point and a triangle span a pyramid that is cut off at the triangle's plane; what lies within
it is hidden. On a patch, taken as its tangent parallelogram, each of the four planes is a straight
line, so that a triangle leaves convex pieces of a convex piece (Weiler, Atherton, SIGGRAPH 1977).
No projection is made: occluders may reach beside, behind and beyond the wall point.

Light is that of the surface's own Gauss points, and linear over the patch between them; the area
and the centroid of the pieces give how much of it is seen.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.patch_light import falloff
from periscopy_sim.hidden import GAUSS, Surface
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import compiled

BLOCK = 16
"""Patches for which faces are sorted out at once."""

CORNERS = 32
"""Most corners of a piece: further cuts are left out."""

GRAZE = 1e-4
"""Fraction of a wall point's distance from a face's plane, beyond which the face hides: so that a
frame in the plane of a monitor hides nothing of it."""

SOME = 64
"""Patches, at most, that `hides_itself` tests for being seen from the wall."""

NEAR = 0.05
"""Distance from a patch, over the surface's extent, within which its facets' roughness hides
nothing."""


class Patches(NamedTuple):  # which compiled functions take
    """The patches of a hidden surface, four Gauss points on each, and balls about blocks."""

    centers: Array  # (N, 3)
    across: Array  # (N, 3)
    up: Array  # (N, 3)
    points: Array  # (N, 4, 3) in order of rows and columns of the finer grid
    normals: Array  # (N, 4, 3) times the area that a Gauss point stands for
    axes: Array  # (N, 4, 2, 3) unit vectors up and across
    balls: Array  # (N / BLOCK, 4) center and radius of a ball about a block of patches


def patches_of(surface: Surface) -> Patches:
    """Return a surface as compiled functions take it."""
    rows, columns = surface.shape
    fine = surface.gauss

    def by_patch(values: Array) -> Array:
        grid = values.reshape(rows, 2, columns, 2, 3).swapaxes(1, 2)
        return np.ascontiguousarray(grid.reshape(-1, 4, 3))

    areas = np.linalg.norm(np.cross(fine.across, fine.up), axis=1, keepdims=True)
    axes = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in (fine.up, fine.across)]
    reach = (np.linalg.norm(surface.across, axis=1) + np.linalg.norm(surface.up, axis=1)) / 2
    starts = range(0, len(surface.centers), BLOCK)
    blocks = [slice(start, start + BLOCK) for start in starts]
    middles = [surface.centers[block].mean(axis=0) for block in blocks]
    radii = [
        np.max(np.linalg.norm(surface.centers[block] - middle, axis=1) + reach[block])
        for block, middle in zip(blocks, middles, strict=True)
    ]
    return Patches(
        np.ascontiguousarray(surface.centers),
        np.ascontiguousarray(surface.across),
        np.ascontiguousarray(surface.up),
        by_patch(fine.centers),
        by_patch(fine.normals * areas),
        np.stack([by_patch(each) for each in axes], axis=2),
        np.column_stack([middles, radii]),
    )


@lru_cache(maxsize=32)
def hides_itself(surface: Surface, corners: tuple[float, ...]) -> bool:
    """Return whether a surface stands between its own patches and corners on the wall, (4, 3).

    The test uses the surface's form, not the size of its image.
    """
    if surface.curved is None:
        return False
    surface, wall = surface.whole or surface, np.reshape(corners, (-1, 3))
    some = np.random.default_rng(0).permutation(len(surface.centers))[:SOME]
    starts = np.repeat(wall, len(some), axis=0)
    ways = np.tile(surface.centers[some], (len(wall), 1)) - starts
    ahead = np.sum(np.tile(surface.normals[some], (len(wall), 1)) * ways, axis=1) < 0
    starts, ways = starts[ahead], ways[ahead]
    corner = [
        surface.centers + s * surface.across + t * surface.up
        for s, t in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    ]
    faces = np.concatenate([np.stack([corner[0], *corner[k : k + 2]]) for k in (1, 2)], axis=1)
    near = NEAR * np.linalg.norm(np.ptp(faces, axis=(0, 1)))
    first, b, c = faces[0], faces[1] - faces[0], faces[2] - faces[0]
    n = np.cross(b, c)
    # Where a way meets a face's plane: its height above the face, and the face's own coordinates.
    axes = np.stack([n, np.cross(c, n), np.cross(n, b)])
    with np.errstate(divide="ignore", invalid="ignore"):
        axes /= np.sum(n**2, axis=1, keepdims=True)
        begin = starts @ axes.swapaxes(1, 2) - np.sum(axes * first, axis=2)[:, None]
        slopes = ways @ axes.swapaxes(1, 2)
        part = -begin[0] / slopes[0]
        _, s, t = begin + part * slopes
        is_between = (part > 0) & (part < 1 - near / np.linalg.norm(ways, axis=1)[:, None])
        return bool((is_between & (s >= 0) & (t >= 0) & (s + t <= 1)).any())


@compiled
def clipped_rows(
    points: Array,
    normals: Array,
    faces: Array,
    patches: Patches,
    exponents: Array,
    out: NDArray[np.float32],
) -> None:
    """Fill `out`, (m, N), with the light of each patch at each pixel's wall points, in ρ/π.

    Parameters
    ----------
    points, normals
        (m, K, 3) wall points in metres, and the wall's unit normals.
    faces
        (F, 3, 3) corners of the triangles that hide.
    patches
        The hidden surface.
    exponents
        (2,) of the cosines of the surface's vertical and horizontal angles.
    """
    planes, active = np.empty((len(faces), 4, 4)), np.empty(len(faces), np.int64)
    cuts = np.empty((len(faces), 4, 3))
    stack = np.empty((4 * len(faces) + 4, CORNERS + 1, 2))
    for i in range(len(points)):
        out[i] = 0
        for k in range(points.shape[1]):
            p = points[i, k]
            seen = _planes_from(p, faces, planes)
            for block in range(len(patches.balls)):
                count = _may_hide(p, planes[:seen], patches.balls[block], active)
                if count < 0:
                    continue
                for j in range(block * BLOCK, min((block + 1) * BLOCK, len(patches.centers))):
                    lit, aside, above = _lit(
                        p,
                        patches.centers[j],
                        patches.across[j],
                        patches.up[j],
                        planes,
                        active[:count],
                        cuts,
                        stack,
                    )
                    if lit > 0:
                        moments = lit, aside / GAUSS, above / GAUSS
                        light = _light(p, normals[i, k], patches, j, exponents, moments)
                        out[i, j] += light / points.shape[1]


@compiled
def _planes_from(p: Array, faces: Array, planes: Array) -> int:
    """Note the four planes, (a, d), within which each face hides q where a · (q - p) > d.

    Faces seen edge-on hide nothing; the number of the others is returned.
    """
    count, ends = 0, np.empty((5, 3))
    for f in range(len(faces)):
        for axis in range(3):
            for c in range(3):
                ends[c, axis] = faces[f, c, axis] - p[axis]
            ends[3, axis] = ends[1, axis] - ends[0, axis]
            ends[4, axis] = ends[2, axis] - ends[0, axis]
        a, plane = ends[0], planes[count]
        length = _cross(ends[3], ends[4], plane[3])
        height = length * (plane[3, 0] * a[0] + plane[3, 1] * a[1] + plane[3, 2] * a[2])
        if not abs(height) > 1e-12 * length * np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]):
            continue
        for side in range(3):
            _cross(ends[side], ends[(side + 1) % 3], plane[side])
            plane[side, 3] = 0.0
        plane[3, 3] = (1 + GRAZE) * abs(height) / length
        if height < 0:
            for side in range(4):
                for axis in range(3):
                    plane[side, axis] = -plane[side, axis]
        count += 1
    return count


@compiled
def _cross(a: Array, b: Array, unit: Array) -> float:
    """Begin `unit` with the unit vector of a cross product, whose length is returned."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    length = np.sqrt(x * x + y * y + z * z)
    unit[0], unit[1], unit[2] = x / length, y / length, z / length
    return float(length)


@compiled
def _may_hide(p: Array, planes: Array, ball: Array, active: NDArray[np.int64]) -> int:
    """Note the faces that may hide some of a ball; return their number, -1 if one hides all."""
    x, y, z = ball[0] - p[0], ball[1] - p[1], ball[2] - p[2]
    count = 0
    for f in range(len(planes)):
        least = np.inf
        for side in range(4):
            plane = planes[f, side]
            inside = plane[0] * x + plane[1] * y + plane[2] * z - plane[3]
            least = min(least, inside)
            if least <= -ball[3]:
                break
        if least >= ball[3]:
            return -1
        if least > -ball[3]:
            active[count] = f
            count += 1
    return count


@compiled
def _lit(
    p: Array,
    center: Array,
    across: Array,
    up: Array,
    planes: Array,
    active: NDArray[np.int64],
    cuts: Array,
    stack: Array,
) -> tuple[float, float, float]:
    """Return the fraction of a patch that p sees, and its moments across and up."""
    x, y, z = center[0] - p[0], center[1] - p[1], center[2] - p[2]
    count = 0
    for f in active:
        hides, misses = True, False
        for side in range(4):
            plane = planes[f, side]
            middle = plane[0] * x + plane[1] * y + plane[2] * z - plane[3]
            aside = plane[0] * across[0] + plane[1] * across[1] + plane[2] * across[2]
            above = plane[0] * up[0] + plane[1] * up[1] + plane[2] * up[2]
            reach = (abs(aside) + abs(above)) / 2
            if middle + reach <= 0:
                misses = True
                break
            hides = hides and middle - reach >= 0
            cuts[count, side, 0], cuts[count, side, 1], cuts[count, side, 2] = middle, aside, above
        if misses:
            continue
        if hides:
            return 0.0, 0.0, 0.0
        count += 1
    if count == 0:
        return 1.0, 0.0, 0.0
    return _cut_square(cuts[:count], stack)


@compiled
def _cut_square(cuts: Array, stack: Array) -> tuple[float, float, float]:
    """Return area and moments of what faces leave of the unit square about 0.

    Each face hides where the lines of its `cuts`, (F, 4, 3), are positive: c0 + c1 s + c2 t.
    """
    corners, following = np.empty(len(stack), np.int64), np.empty(len(stack), np.int64)
    inside, values = np.empty((CORNERS + 1, 2)), np.empty(CORNERS + 1)
    for v in range(4):
        stack[0, v, 0] = 0.5 if 0 < v < 3 else -0.5
        stack[0, v, 1] = 0.5 if v > 1 else -0.5
    corners[0], following[0], top = 4, 0, 1
    total = aside = above = 0.0
    while top > 0:
        top -= 1
        n, f = corners[top], following[top]
        if f == len(cuts):
            area, s, t = _moments(stack[top], n)
            total, aside, above = total + area, aside + s, above + t
            continue
        _copy(stack[top], n, inside)
        for side in range(4):
            c0, c1, c2 = cuts[f, side]
            most, least = -np.inf, np.inf
            for v in range(n):
                values[v] = c0 + c1 * inside[v, 0] + c2 * inside[v, 1]
                most, least = max(most, values[v]), min(least, values[v])
            if least >= 0:
                continue
            # What lies outside of one plane is seen past this face; the rest goes on.
            outside = stack[top]
            if most <= 0 or n + 1 > CORNERS:
                _copy(inside, n, outside)
                corners[top], following[top] = n, f + 1
                top += 1
                n = 0
                break
            corners[top] = _half(inside, values, n, -1.0, outside)
            following[top] = f + 1
            top += 1
            spare = stack[top]
            n = _half(inside, values, n, 1.0, spare)
            _copy(spare, n, inside)
    return total, aside, above


@compiled
def _copy(polygon: Array, n: int, out: Array) -> None:
    """Fill `out` with a polygon's corners; Numba compiles slices ten times as long."""
    for v in range(n):
        out[v, 0], out[v, 1] = polygon[v, 0], polygon[v, 1]


@compiled
def _half(polygon: Array, values: Array, n: int, sign: float, out: Array) -> int:
    """Fill `out` with the part of a convex polygon where values have a sign; return its corners."""
    count = 0
    for v in range(n):
        w = v + 1 if v + 1 < n else 0
        here, there = sign * values[v], sign * values[w]
        if here >= 0:
            out[count, 0], out[count, 1] = polygon[v, 0], polygon[v, 1]
            count += 1
        if (here > 0 and there < 0) or (here < 0 and there > 0):
            way = here / (here - there)
            out[count, 0] = polygon[v, 0] + way * (polygon[w, 0] - polygon[v, 0])
            out[count, 1] = polygon[v, 1] + way * (polygon[w, 1] - polygon[v, 1])
            count += 1
    return count


@compiled
def _moments(polygon: Array, n: int) -> tuple[float, float, float]:
    """Return the area of a polygon and its first moments."""
    area = s = t = 0.0
    for v in range(n):
        w = v + 1 if v + 1 < n else 0
        twice = polygon[v, 0] * polygon[w, 1] - polygon[w, 0] * polygon[v, 1]
        area += twice / 2
        s += twice * (polygon[v, 0] + polygon[w, 0]) / 6
        t += twice * (polygon[v, 1] + polygon[w, 1]) / 6
    return area, s, t


@compiled
def _light(
    p: Array,
    normal: Array,
    patches: Patches,
    j: int,
    exponents: Array,
    moments: tuple[float, float, float],
) -> float:
    """Return the light of the seen part of a patch, of area and moments over GAUSS."""
    total = 0.0
    lit, aside, above = moments
    for g in range(4):
        q, n = patches.points[j, g], patches.normals[j, g]
        x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        towards = normal[0] * x + normal[1] * y + normal[2] * z
        ahead = -(n[0] * x + n[1] * y + n[2] * z)
        if towards <= 0 or ahead <= 0:
            continue
        squared = x * x + y * y + z * z
        value = towards * ahead / (squared * squared)
        if exponents[0] != 0 or exponents[1] != 0:
            height = ahead / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            for axis in range(2):
                way = patches.axes[j, g, axis]
                along = way[0] * x + way[1] * y + way[2] * z
                value *= falloff(along, height, exponents[axis])
        value *= lit + (aside if g % 2 else -aside) + (-above if g >= 2 else above)
        total += value
    return total
