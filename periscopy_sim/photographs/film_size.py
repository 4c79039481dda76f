"""How many pixels a photograph needs: what shadows show, what memory and the marks allow.

A patch of the hidden image casts the occluder's shadow beside that of the next patch: by the
patches' distance times the occluder's distance from the wall over that from the monitor. Pixels
larger than this step mix what distinguishes patches; much smaller ones show nothing more.
"""

from __future__ import annotations

from math import gcd

import numpy as np

from periscopy_sim.numerics.memory import has_memory, transport_memory
from periscopy_sim.scenario import Array, Scenario, wall_frame

PIXELS_IN_STEP = 2.0
"""Pixels that a step of the shadows should have.

Photographs by the chair scene itself (15 x 18 patches, SBR 0.5) with 3.5, 1.7, 1.2 and 0.6 pixels
in a step give 25.0, 24.7, 24.5 and 22.9 dB at an SNR of 40 dB per fine pixel, 34.0, 32.9, 32.4 and
29.0 dB at 55 dB. Where paint or bounced light limits the image, less is lost, or nothing.
"""

PLACED = 0.5
"""Standard error, in pixels of the film, with which marks should place a photograph."""

SHARPEST = 10.0
"""Percentile of the occluders' edges whose step counts: a corner that touches the wall does not."""


def choose_film(
    scenario: Scenario, hidden: tuple[int, int], films: list[tuple[int, int]]
) -> tuple[int, int]:
    """Return the coarsest film that is fine enough and that memory allows, else the finest.

    `hidden` and `films` are (rows, columns), the latter of the proportions of the scene's own film.
    Where no shadow falls into the field of view, that nearest to the scene's own is enough.
    """
    shape = rows, columns = scenario.photograph_shape
    ordered, patches = sorted(films), hidden[0] * hidden[1]
    allowed = [f for f in ordered if has_memory(transport_memory(f[0] * f[1], patches))]
    allowed = allowed or ordered[:1]
    if (step := shadow_step(scenario, hidden)) is None:
        return min(allowed, key=lambda film: abs(film[0] - rows))
    grid = scenario.wall_points.reshape(rows, columns, 3)
    sides = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if shape[k] > 1]
    pixel = max((float(np.median(each)) for each in sides), default=0.0)
    fine = [film for film in allowed if step * film[0] >= PIXELS_IN_STEP * pixel * rows]
    return fine[0] if fine else allowed[-1]


def shadow_step(scenario: Scenario, hidden: tuple[int, int]) -> float | None:
    """Return by how many metres the sharpest shadow moves from a patch to the next one.

    The middle of the monitor, and a patch beside it, project each point of an occluder's edge on
    the wall's plane. The lesser of the moves across and up counts, at the `SHARPEST` percentile of
    the points whose shadow falls into the field of view. None where there is none.
    """
    frame = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
    axes = np.stack([frame.across, frame.up, frame.normal], axis=1)
    wall = (scenario.wall_points - frame.center) @ axes[:, :2]
    middle = (scenario.patch_centers.mean(axis=0) - frame.center) @ axes
    rows, columns = scenario.hidden_shape
    width = scenario.patch_across.mean(axis=0) @ axes * columns
    height = scenario.patch_up.mean(axis=0) @ axes * rows
    points = (_edge_points(scenario) - frame.center) @ axes
    points = points[(points[:, 2] > 0) & (points[:, 2] < middle[2])]

    def shadows(source: Array) -> Array:
        stretch = source[2] / (source[2] - points[:, 2:])
        return np.asarray(source[:2] + stretch * (points[:, :2] - source[:2]))

    with np.errstate(divide="ignore", invalid="ignore"):
        cast = shadows(middle)
        moves = [
            np.linalg.norm(shadows(middle + patch) - cast, axis=1)
            for patch in (width / hidden[1], height / hidden[0])
        ]
    in_view = ((cast >= wall.min(axis=0)) & (cast <= wall.max(axis=0))).all(axis=1)
    sharpest = np.minimum(*moves)[in_view]
    return float(np.percentile(sharpest, SHARPEST)) if sharpest.size else None


def _edge_points(scenario: Scenario, on_edge: int = 8) -> Array:
    """Return points along the edges of the occluders' triangles, (n, 3)."""
    part = (np.arange(on_edge) + 0.5)[:, np.newaxis] / on_edge
    points = [np.zeros((0, 3))]
    for occluder in scenario.occluders:
        if occluder.vertices is not None and occluder.faces is not None:
            start = occluder.vertices[occluder.faces][:, :, np.newaxis]
            points.append((start + part * (np.roll(start, -1, axis=1) - start)).reshape(-1, 3))
    return np.concatenate(points)


def films_of_blocks(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the films that whole square blocks of a (rows, columns) photograph average to."""
    common = gcd(*size)
    return [(size[0] // k, size[1] // k) for k in range(1, common + 1) if common % k == 0]


def films_of_shape(shape: tuple[int, int], finest: float) -> list[tuple[int, int]]:
    """Return films of the proportions of one, (rows, columns), up to `finest` times as fine."""
    common = gcd(*shape)
    most = max(int(common * finest), 1)
    return [(n * shape[0] // common, n * shape[1] // common) for n in range(1, most + 1)]


def films_of_marks(
    shape: tuple[int, int], coverage: float, placement: float
) -> list[tuple[int, int]]:
    """Return films of the proportions of one for a rectified photograph; see `PlacedFilm`.

    No film is finer than the photograph, nor, but for those up to the film itself, than the marks.
    """
    finest = max(1.0, PLACED / placement) if placement > 0 else np.inf
    return films_of_shape(shape, min(float(np.sqrt(coverage)), finest))
