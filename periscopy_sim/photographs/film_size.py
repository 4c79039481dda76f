"""How many pixels a photograph needs: what shadows show, what memory and the marks allow.

A patch of the hidden image casts the occluder's shadow beside that of the next patch: by the
patches' distance times the occluder's distance from the wall over that from the monitor. Pixels
larger than this step mix what distinguishes patches; much smaller ones show nothing more.
"""

from __future__ import annotations

from dataclasses import dataclass
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

_ON_EDGE = 8  # points on each edge of a mesh
_MOST_POINTS = 200_000


@dataclass(frozen=True)
class FilmAdvice:
    """The film that shows what a photograph holds of the hidden image.

    `step` is the distance on the wall by which the sharpest shadow moves from one patch to the
    next; None where no mesh casts a shadow into the field of view.
    """

    step: float | None  # metres
    pixel: float  # metres of the scene's own pixels on the wall, along their longer side
    shape: tuple[int, int]  # (rows, columns) of the scene's own film
    patches: int  # of the hidden image

    def pixels_in_step(self, shape: tuple[int, int]) -> float:
        """Return how many pixels a step has on a film of (rows, columns)."""
        assert self.step is not None
        return self.step / self.pixel * shape[0] / self.shape[0]

    def choose(self, shapes: list[tuple[int, int]]) -> tuple[int, int]:
        """Return the coarsest film that is fine enough and that memory allows, else the finest."""
        ordered = sorted(shapes)
        allowed = [shape for shape in ordered if self.fits(shape)] or ordered[:1]
        if self.step is None:
            return min(allowed, key=lambda shape: abs(shape[0] - self.shape[0]))
        enough = [each for each in allowed if self.pixels_in_step(each) >= PIXELS_IN_STEP]
        return enough[0] if enough else allowed[-1]

    def fits(self, shape: tuple[int, int]) -> bool:
        """Return whether the default method has memory for A and its factors."""
        return has_memory(transport_memory(shape[0] * shape[1], self.patches))


def advise(scenario: Scenario, hidden: tuple[int, int] | None = None) -> FilmAdvice:
    """Return which film a scene needs for a hidden image of (rows, columns), None for its own."""
    hidden = hidden or scenario.hidden_shape
    shape = scenario.photograph_shape
    grid = scenario.wall_points.reshape(*shape, 3)
    sides = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if shape[k] > 1]
    pixel = max((float(np.median(each)) for each in sides), default=0.0)
    return FilmAdvice(shadow_step(scenario, hidden), pixel, shape, hidden[0] * hidden[1])


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
    corners = [middle + i * width / 2 + j * height / 2 for i in (-1, 1) for j in (-1, 1)]
    shadows = np.stack([_shadows(source, points) for source in (*corners, middle)])
    in_view = (
        ((shadows >= wall.min(axis=0)) & (shadows <= wall.max(axis=0))).all(axis=2).any(axis=0)
    )
    moves = [
        np.linalg.norm(_shadows(middle + patch, points) - shadows[-1], axis=1)[in_view]
        for patch in (width / hidden[1], height / hidden[0])
    ]
    return float(np.percentile(np.minimum(*moves), SHARPEST)) if in_view.any() else None


def _shadows(source: Array, points: Array) -> Array:
    """Return where points cast their shadows on the plane at height 0, (n, 2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = source[2] / (source[2] - points[:, 2:])
        return np.asarray(source[:2] + stretch * (points[:, :2] - source[:2]))


def _edge_points(scenario: Scenario) -> Array:
    """Return points along the edges of the occluders' triangles, (n, 3)."""
    part = (np.arange(_ON_EDGE) + 0.5)[:, np.newaxis] / _ON_EDGE
    points = [np.zeros((0, 3))]
    for occluder in scenario.occluders:
        if occluder.vertices is not None and occluder.faces is not None:
            faces = occluder.faces[:: 1 + 3 * _ON_EDGE * len(occluder.faces) // _MOST_POINTS]
            start = occluder.vertices[faces][:, :, np.newaxis]
            end = np.roll(start, -1, axis=1)
            points.append((start + part * (end - start)).reshape(-1, 3))
    return np.concatenate(points)


def films_of_blocks(size: tuple[int, int]) -> dict[int, tuple[int, int]]:
    """Return the films that whole blocks of a (rows, columns) photograph average to, by side."""
    common = gcd(*size)
    return {k: (size[0] // k, size[1] // k) for k in range(1, common + 1) if common % k == 0}


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
