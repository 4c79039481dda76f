"""The laboratory in 3-D: the scene's wall, hidden surfaces and occluders."""

from typing import Any

import numpy as np

from periscopy_sim.figures.panels import hatching
from periscopy_sim.live.movable import parts_of
from periscopy_sim.live.panels import Pixels, as_source, hidden_pixels, photograph_pixels
from periscopy_sim.live.pictures import LivePictures
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import Occluder
from periscopy_sim.view import View

LINES = 17
"""Rows and columns of points, at most, by which a surface is drawn."""

AHEAD = 0.002
"""Metres from the wall to the photograph in front of it, and to its picture behind it."""

MARGIN = 0.1
"""Over the size of everything: what wall and floor reach beyond, and the length of arrows."""


def room_of(scenario: Scenario) -> dict[str, Any]:
    """Return what stays: floor, wall, first view and arrows' length, as `page.js` draws them."""
    points, frame = _everything(scenario), scenario.view.frame
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    width, depth, _ = high - low + MARGIN * size
    # The wall is just behind everything.
    axes = np.stack([frame.across, frame.up])
    local = (points - frame.center) @ axes.T
    left, right = local.min(axis=0) - [MARGIN * size, 0], local.max(axis=0) + MARGIN * size
    center = frame.center + (left + right) / 2 @ axes - AHEAD * frame.normal
    # The first view, of the floor's middle: from beside the viewer of the wall, and from above.
    x, y, z = back = 0.7 * frame.normal + 0.6 * frame.across + np.array([0, 0, 0.35])
    length = float(np.linalg.norm(back))
    floor = np.array([*middle[:2], low[2]])
    return {
        "wall": _rectangle(center, *((right - left)[:, np.newaxis] * axes)),
        "floor": _rectangle(floor, *np.diag([width, depth, 0])[:2]),
        "hatching": as_source(hatching()),
        "arrow": MARGIN * size,
        "view": {
            "target": floor.tolist(), "distance": 0.95 * size * length,
            "azimuth": np.degrees(np.arctan2(y, x)), "elevation": np.degrees(np.arcsin(z / length)),
        },
    }  # fmt: skip


def occluders_in(pictures: LivePictures) -> dict[str, Any]:
    """Return a scene's occluders."""
    return {"occluders": [_mesh(each) for each in pictures.scenario.view.occluders]}


def images_in(pictures: LivePictures) -> dict[str, Any]:
    """Return the photograph on a scene's wall, and the images on hidden surfaces."""
    scenario, images = pictures.scenario, hidden_pixels(pictures)
    on_wall = pixel_corners(scenario.view) + AHEAD * scenario.view.frame.normal
    return {
        "photograph": _on_grid(photograph_pixels(pictures), on_wall),
        "hidden": [_on_grid(images[name], each.vertices) for name, each in scenario.hidden.items()],
    }


def pixel_corners(view: View) -> Array:
    """Return the corners of a photograph's pixels on the wall, (rows + 1, columns + 1, 3)."""
    centers = view.centers.reshape(*view.shape, 3)
    around = np.pad(centers, ((1, 1), (1, 1), (0, 0)), "reflect", reflect_type="odd")
    above, beneath = around[:-1, :-1] + around[:-1, 1:], around[1:, :-1] + around[1:, 1:]
    return np.asarray((above + beneath) / 4)


def _on_grid(pixels: Pixels, corners: Array) -> dict[str, Any]:
    """Return an image and some of its pixels' corners, (rows, columns, 3), from the upper left."""
    lines = (np.linspace(0, n - 1, min(n, LINES)).round().astype(int) for n in corners.shape[:2])
    return {"source": as_source(pixels), "grid": corners[np.ix_(*lines)].tolist()}


def _rectangle(center: Array, across: Array, up: Array) -> Any:
    """Return the corners of a rectangle, from the upper left."""
    return [[(center + x * across + y * up).tolist() for x in (-0.5, 0.5)] for y in (0.5, -0.5)]


def _mesh(occluder: Occluder) -> dict[str, Any]:
    """Return the triangles of an occluder, each vertex to 10 micrometres."""
    vertices, faces = occluder.vertices, occluder.faces
    if vertices is None or faces is None:  # no mesh: the box about it
        from trimesh.creation import box

        around = box(bounds=occluder.bounds)
        vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
    shown = np.round(np.asarray(vertices, float), 5)
    return {"vertices": shown.ravel().tolist(), "faces": faces.ravel().tolist()}


def _everything(scenario: Scenario) -> Array:
    """Return the points, (n, 3), of all but far surroundings."""
    parts = parts_of(scenario)
    seen_and_hidden = np.concatenate([scenario.view.centers, scenario.hidden.centers])
    reach = np.linalg.norm(np.ptp(seen_and_hidden, axis=0))
    near = (p for p in parts.values() if np.linalg.norm(np.ptp(p, axis=0)) <= reach)
    return np.concatenate(list(near))
