"""How many pixels a photograph needs: what shadows show, what memory and the marks allow.

A patch of the hidden image that lies beside another casts the occluder's shadow beside the other's:
by the patches' distance times the occluder's distance from the wall over that from the monitor.
Pixels that are not finer than this step mix what distinguishes patches; much finer ones tell
nothing more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import gcd

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.memory import has_memory, transport_memory
from periscopy_sim.photographs.view.homography import Array
from periscopy_sim.scenario import Scenario, wall_frame

PIXELS_IN_STEP = 2.0
"""Pixels that a step of the shadows should have.

Of photographs by the chair scene itself (15 x 18 patches, SBR 0.5), 3.5, 1.7, 1.2 and 0.6 pixels in
a step give 25.0, 24.7, 24.5 and 22.9 dB at an SNR of 40 dB a fine pixel, 34.0, 32.9, 32.4 and 29.0
dB at 55 dB. Where paint or bounced light limits the picture, less is lost, or nothing.
"""

PLACED = 0.5
"""Standard error, in pixels of the film, to which marks should place a photograph."""

LOST = 10.0
"""The same, above which nobody knows where a pixel is."""

SHARPEST = 10.0
"""Percentile of the occluders' edges whose step counts: a corner that touches the wall does not."""

MOST_OUTSIDE = 0.5
"""Part of the film that may lie outside of the photograph without a word."""

_ON_EDGE = 8  # points looked at on each edge of a mesh
_MOST_POINTS = 200_000


@dataclass(frozen=True)
class FilmAdvice:
    """Which film shows what a photograph tells of the hidden image.

    Attributes
    ----------
    step
        Metres on the wall by which the shadow moves from one patch to the next, where it is
        sharpest; None where no mesh casts a shadow into the field of view.
    pixel
        Metres of the scene's own pixels on the wall, along their longer side.
    """

    step: float | None
    pixel: float
    shape: tuple[int, int]
    patches: int

    def pixels_in_step(self, shape: tuple[int, int]) -> float:
        """Return how many pixels a step has on a film of (rows, columns)."""
        assert self.step is not None
        return self.step / self.pixel * shape[0] / self.shape[0]

    def choose(self, shapes: list[tuple[int, int]]) -> tuple[int, int]:
        """Return the coarsest film that is fine enough, of those that memory allows.

        `shapes` are (rows, columns). If none is fine enough, that is the finest.
        """
        ordered = sorted(shapes)
        allowed = [shape for shape in ordered if self.fits(shape)] or ordered[:1]
        if self.step is None:
            return min(allowed, key=lambda shape: abs(shape[0] - self.shape[0]))
        enough = [each for each in allowed if self.pixels_in_step(each) >= PIXELS_IN_STEP]
        return enough[0] if enough else allowed[-1]

    def size(self, shape: tuple[int, int]) -> int:
        """Return the bytes of A in single precision."""
        return 4 * shape[0] * shape[1] * self.patches

    def fits(self, shape: tuple[int, int]) -> bool:
        """Return whether the default method has room for A and what it makes of it."""
        return has_memory(transport_memory(shape[0] * shape[1], self.patches))


def advise(scenario: Scenario, hidden: tuple[int, int] | None = None) -> FilmAdvice:
    """Return what a scene tells of the film that it needs for a hidden image of (rows, columns).

    None takes the scenario's own hidden size.
    """
    hidden = hidden or scenario.hidden_shape
    rows, columns = scenario.photograph_shape
    grid = scenario.wall_points.reshape(rows, columns, 3)
    sides = [
        np.median(np.linalg.norm(np.diff(grid, axis=axis), axis=2))
        for axis in (0, 1)
        if grid.shape[axis] > 1
    ]
    step, pixel = shadow_step(scenario, hidden), float(max(sides, default=0))
    return FilmAdvice(step, pixel, (rows, columns), hidden[0] * hidden[1])


def shadow_step(scenario: Scenario, hidden: tuple[int, int]) -> float | None:
    """Return by how many metres the sharpest shadow moves from a patch to the one beside it.

    Each point of an occluder's edge is projected on the wall's plane from the middle of the
    monitor, and from a patch beside it; the lesser of the moves for a patch across and a patch up
    counts, of the points whose shadow falls into the field of view, at their `SHARPEST` percentile.
    None where there is none.
    """
    frame = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
    axes = np.stack([frame.across, frame.up, frame.normal], axis=1)
    wall = (scenario.wall_points - frame.center) @ axes
    low, high = wall[:, :2].min(axis=0), wall[:, :2].max(axis=0)
    middle = (scenario.patch_centers.mean(axis=0) - frame.center) @ axes
    own = scenario.hidden_shape
    across = scenario.patch_across.mean(axis=0) * (own[1] / hidden[1])
    up = scenario.patch_up.mean(axis=0) * (own[0] / hidden[0])
    half_across = scenario.patch_across.mean(axis=0) @ axes * own[1] / 2
    half_up = scenario.patch_up.mean(axis=0) @ axes * own[0] / 2
    sources = [middle + i * half_across + j * half_up for i in (-1, 1) for j in (-1, 1)]
    steps = []
    for points in _edge_points(scenario):
        points = (points - frame.center) @ axes
        between = points[(points[:, 2] > 0) & (points[:, 2] < middle[2])]
        shadows = np.stack([_shadows(source, between) for source in (*sources, middle)])
        falls = ((shadows >= low) & (shadows <= high)).all(axis=2).any(axis=0)
        moves = [
            np.linalg.norm(_shadows(middle + step @ axes, between) - shadows[-1], axis=1)
            for step in (across, up)
        ]
        steps.append(np.minimum(*moves)[falls])
    found = np.concatenate(steps) if steps else np.zeros(0)
    return float(np.percentile(found, SHARPEST)) if found.size else None


def _shadows(source: Array, points: Array) -> Array:
    """Return where points cast their shadows on the plane at height 0, (n, 2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = source[2] / (source[2] - points[:, 2:])
        return np.asarray(source[:2] + stretch * (points[:, :2] - source[:2]))


def _edge_points(scenario: Scenario) -> Iterator[Array]:
    """Yield points along the edges of each occluder's triangles, (n, 3)."""
    part = (np.arange(_ON_EDGE) + 0.5) / _ON_EDGE
    for occluder in scenario.occluders:
        if occluder.vertices is None or occluder.faces is None:
            continue
        faces = occluder.faces[:: 1 + 3 * _ON_EDGE * len(occluder.faces) // _MOST_POINTS]
        start, end = occluder.vertices[faces], occluder.vertices[np.roll(faces, -1, axis=1)]
        along = start[:, :, np.newaxis] + part[:, np.newaxis] * (end - start)[:, :, np.newaxis]
        yield along.reshape(-1, 3)


def films_of_blocks(size: tuple[int, int]) -> dict[int, tuple[int, int]]:
    """Return the films that whole square blocks of a photograph average to, by the blocks' side.

    `size` is the photograph's (rows, columns).
    """
    common = gcd(*size)
    return {k: (size[0] // k, size[1] // k) for k in range(1, common + 1) if common % k == 0}


def films_of_shape(shape: tuple[int, int], finest: float) -> list[tuple[int, int]]:
    """Return films of the proportions of one, (rows, columns), up to so many times as fine."""
    common = gcd(*shape)
    unit = shape[0] // common, shape[1] // common
    most = max(int(common * finest), 1)
    return [(n * unit[0], n * unit[1]) for n in range(1, most + 1)]


def films_of_marks(
    shape: tuple[int, int], coverage: float, placement: float
) -> list[tuple[int, int]]:
    """Return films of the proportions of one, (rows, columns), that a rectified photograph allows.

    They are no finer than the photograph, of which a pixel of the film covers `coverage`; nor, but
    for those up to the film itself, than the marks, which place its pixels to `placement` of one.
    """
    finest = max(1.0, PLACED / placement) if placement > 0 else np.inf
    return films_of_shape(shape, min(float(np.sqrt(coverage)), finest))


def film_doubts(placement: float, coverage: float, outside: float) -> list[str]:
    """Return lines of doubt about a rectified photograph.

    `outside` is the part of the film that lies outside of the photograph; see `films_of_marks`. A
    PhotographError says that the marks do not place it at all.
    """
    if placement > LOST:
        raise PhotographError(
            f"the marks place the photograph to {placement:.0f} of the scene's pixels only, where "
            "it is worst: nearly on one line, or close together; spread them over what is used"
        )
    doubts = []
    if outside > MOST_OUTSIDE:
        doubts.append(
            f"{outside:.0%} of the scene's film lie outside of the photograph: the scene's camera "
            "sees other wall; let it see what the photograph shows (in measurements: kind "
            "rectified, the range of the points' x and z), or check the points"
        )
    if placement > PLACED:
        doubts.append(
            f"the marks place the photograph to {placement:.1f} of the scene's pixels only, where "
            "it is worst; measure more of them, further apart"
        )
    if coverage < 1:
        doubts.append(
            f"the scene's pixels are finer than the photograph's ({coverage:.2f} in each); give "
            "its film fewer"
        )
    return doubts


def check_blocks(size: tuple[int, int], shape: tuple[int, int]) -> None:
    """Refuse a photograph of (rows, columns) that does not average to a film by square blocks."""
    films = films_of_blocks(size)
    if shape in films.values():
        return
    sizes = [f"{rows}x{columns}" for rows, columns in list(films.values())[:12]]
    raise PhotographError(
        f"{size[0]} x {size[1]} pixels (rows x columns) do not average to the {shape[0]} x "
        f"{shape[1]} of the scene's camera by whole square blocks; its film may have "
        f"{', '.join(sizes)}: change it in the scene, or crop the photograph; of another camera "
        "than the scene's, tell points of the wall by --points, or --tags"
    )
