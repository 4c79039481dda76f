"""A scene in space: the photograph on the wall, the occluders, the images on hidden surfaces."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.style import drawn
from periscopy_sim.hidden import Surface
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.rasters import srgb_encode

PIXELS, INCHES = 525, 7.0
"""Of the picture's longer side; its PNG has four times as many pixels."""

SHARPNESS = 2
"""Rays along each side of a pixel."""

DISTANCE = 3.0
"""Of the eye from the middle, over the radius of what the picture shows."""

ELEVATIONS, TURNS = (10, 20, 30), np.arange(-180, 180, 10)
"""Degrees by which the eye looks down, and turns about the vertical from the wall's normal."""

LOOK = np.linspace(-0.36, 0.36, 32)
"""Slopes of the rays, across and up, by which places of the eye are compared."""

LAYERS = 8
"""Surfaces that a ray meets at most."""

OPACITY = {"wall": 0.85, "occluder": 0.45}
"""What stands behind the photograph, or behind an occluder, stays in sight."""

STEP = 1e-4
"""Of a ray's way from the eye, by which it goes on beyond what it passed."""

PAPER, BACK, OCCLUDER = 0.93, 0.6, (0.25, 0.4)
"""Greys, as displayed, of nothing, of a hidden surface's back, of occluders at a grazing angle and
what those that face the eye have more."""


def draw_space(
    path: Path,
    scenario: Scenario,
    images: Mapping[str, Image],
    photograph: Image,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a scene in space as a picture of its own, by `show_space`; none in a scalar variant."""
    if not is_vectorized():  # ray by ray it would take an hour
        return
    with drawn(path, metadata) as figure:
        figure.set_facecolor(str(PAPER))
        size = show_space(figure.subplots(), scenario, images, photograph)
        figure.set_size_inches(*(INCHES * size / size.max()))


def show_space(
    ax: Any, scenario: Scenario, images: Mapping[str, Image], photograph: Image
) -> Array:
    """Show a scene in perspective, from where the hidden surfaces and the photograph are seen best.

    The images, (R, C, 3) linear light in [0, 1], are by the surfaces' ids. The photograph,
    (rows, columns, 3) likewise, is a pane, of which the eye may see the back. Occluders are
    translucent. Return the picture's width and height, (2,), in any unit.
    """
    wall = scenario.view.wall
    colours = {n: srgb_encode(image) for n, image in {**images, wall: photograph}.items()}
    surfaces = {wall: scenario.view.surface, **scenario.hidden}  # the wall first
    points = np.concatenate([each.vertices.reshape(-1, 3) for each in surfaces.values()])
    survey = Survey(scenario)
    eye, axes = _eye(survey, surfaces, points)
    places = _project(points, eye, axes)
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.06 * (high - low).max() * np.array([1, 2])  # names stand above and below
    low, high = low - margin, high + margin
    wide, tall = high - low
    columns, rows = np.ceil(PIXELS * (high - low) / max(wide, tall)).astype(int)
    x = low[0] + (np.arange(SHARPNESS * columns) + 0.5) / (SHARPNESS * columns) * wide
    y = high[1] - (np.arange(SHARPNESS * rows) + 0.5) / (SHARPNESS * rows) * tall
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    light = np.full((len(grid), 3), PAPER)
    for met in _met(survey, surfaces, np.tile(eye, (len(grid), 1)), axes[2] + grid @ axes[:2]):
        grey = OCCLUDER[0] + OCCLUDER[1] * np.abs(met.facing)
        colour = np.repeat(grey[:, None], 3, axis=1)
        for name, image in colours.items():
            here = met.shapes == survey.names.index(name)
            colour[here] = image.reshape(-1, 3)[met.pixels[here]]
            if name != wall:
                colour[here & (met.facing > 0)] = BACK
        light[met.rays] += met.weights[:, None] * (colour - PAPER)
    picture = light.reshape(rows, SHARPNESS, columns, SHARPNESS, 3).mean(axis=(1, 3))
    ax.imshow(
        np.clip(picture, 0, 1), extent=(low[0], high[0], low[1], high[1])
    )  # rounding exceeds 1
    ax.set_axis_off()
    borders = {n: _project(each.vertices, eye, axes) for n, each in surfaces.items()}
    for name, border in borders.items():
        others = np.concatenate([b.reshape(-1, 2) for n, b in borders.items() if n != name])
        ends = border.reshape(-1, 2)[[np.argmin(border[..., 1]), np.argmax(border[..., 1])]]
        away = np.linalg.norm(ends[:, None] - others, axis=2).min(axis=1)
        above = int(np.argmax(away))  # or below, where less is near
        label = "photograph" if name == wall else name
        beside = np.sign(ends[above][0] - border[..., 0].mean())
        ax.annotate(
            label, tuple(ends[above]), (0, (-4, 4)[above]), textcoords="offset points",
            ha=("center", "right", "left")[int(beside)], va=("top", "bottom")[above],
        )  # fmt: skip
    return np.asarray(high - low)


def _project(points: Array, eye: Array, axes: Array) -> Array:
    """Return where points, (..., 3), lie in the picture, (..., 2)."""
    along = (points - eye) @ axes.T
    return np.asarray(along[..., :2] / along[..., 2:])


def _eye(survey: Survey, surfaces: Mapping[str, Surface], points: Array) -> tuple[Array, Array]:
    """Return the best of many places about the scene, (3,), and right, up and ahead there, (3, 3).

    From there what is seen worst is seen best: the photograph, from either side, and each hidden
    surface's front, by its area in the picture over its own.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    wall, first, *_ = surfaces.values()
    up = _unit(first.up.mean(axis=0))
    level = [axis - (axis @ up) * up for axis in (wall.across.mean(axis=0), wall.up.mean(axis=0))]
    side = _unit(max(level, key=lambda axis: float(axis @ axis)))  # the wall may be a floor
    front = np.cross(side, up)
    down, turn = (n.reshape(-1, 1) for n in np.meshgrid(np.radians(ELEVATIONS), np.radians(TURNS)))
    ways = np.cos(down) * (np.cos(turn) * front + np.sin(turn) * side) + np.sin(down) * up
    eyes = middle + DISTANCE * radius * ways
    right = np.cross(up, ways) / np.cos(down)
    axes = np.stack([right, np.cross(ways, right), -ways], axis=1)
    slopes = np.stack(np.meshgrid(LOOK, LOOK), axis=-1).reshape(-1, 2)
    rays = axes[:, None, 2] + slopes @ axes[:, :2]
    areas = np.zeros((len(survey.names), len(eyes)))
    places = [survey.names.index(name) for name in surfaces]
    for met in _met(survey, surfaces, np.repeat(eyes, len(slopes), axis=0), rays.reshape(-1, 3)):
        seen = met.weights * ((met.facing < 0) | (met.shapes == places[0]))
        np.add.at(areas, (met.shapes, met.rays // len(slopes)), seen)
    whole = [np.linalg.norm(np.cross(s.across, s.up), axis=1).sum() for s in surfaces.values()]
    best = np.argmax(np.min(areas[places] / np.array(whole)[:, None], axis=0))
    return eyes[best], axes[best]


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


class _Met(NamedTuple):
    """Surfaces that rays meet, one each."""

    rays: NDArray[np.intp]  # numbers of the rays
    shapes: NDArray[np.intp]  # numbers in the survey's names
    pixels: NDArray[np.intp]  # of the photograph or, of a hidden surface, the patches; else 0
    facing: Array  # the cosine of the ray and the normal, negative on the front
    weights: Array  # in what the ray sees


def _met(
    survey: Survey, surfaces: Mapping[str, Surface], eyes: Array, directions: Array
) -> Iterator[_Met]:
    """Yield what rays from eyes, (n, 3) each, meet first, then behind that, and so on."""
    through, rays, starts = np.ones(len(eyes)), np.arange(len(eyes)), eyes
    for _ in range(LAYERS):
        if not len(rays):
            return
        number, points, normals, uv = survey.seen(starts, directions[rays])
        met = number >= 0
        number, rays = number[met], rays[met]
        points, normals, uv = points[met], normals[met], uv[met]
        ahead = directions[rays] / np.linalg.norm(directions[rays], axis=1, keepdims=True)
        pixels, opacity = np.zeros(len(rays), int), np.full(len(rays), OPACITY["occluder"])
        for k, (name, surface) in enumerate(surfaces.items()):
            here = number == survey.names.index(name)
            if k == 0:
                pixels[here], inside = _pixels(surface, points[here])
                opacity[here] = OPACITY["wall"] * inside
            else:
                pixels[here], opacity[here] = surface.patches_at(uv[here]), 1
        facing = np.sum(normals * ahead, axis=1)
        yield _Met(rays, number, pixels, facing, through[rays] * opacity)
        through[rays] *= 1 - opacity
        goes_on = opacity < 1
        rays, points = rays[goes_on], points[goes_on]
        starts = points + STEP * (points - eyes[rays])


def _pixels(wall: Surface, points: Array) -> tuple[NDArray[np.intp], Mask]:
    """Return the nearest pixels to points of the wall, (n,), and whether these are inside."""
    from scipy.spatial import KDTree

    _, pixel = KDTree(wall.centers).query(points, workers=-1)
    aside, inside = points - wall.centers[pixel], np.ones(len(points), bool)
    for edge in (wall.across[pixel], wall.up[pixel]):
        inside &= np.abs(np.sum(aside * edge, axis=1)) < 0.51 * np.sum(edge**2, axis=1)
    return pixel, inside
