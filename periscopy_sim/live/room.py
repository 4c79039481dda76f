"""The laboratory in 3-D: the scene's wall, hidden surfaces and occluders."""

from base64 import b64encode
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from periscopy_sim.hidden import Surface
from periscopy_sim.live.movable import parts_of
from periscopy_sim.live.panels import Pixels, hidden_pixels, photograph_pixels
from periscopy_sim.live.pictures import LivePictures
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import Occluder
from periscopy_sim.view import View, WallFrame

COLOURS = {"wall": (236, 236, 232), "floor": (222, 222, 222)}

LINES = 17
"""Rows and columns of points, at most, by which a surface is drawn."""

MARGIN = 0.1
"""Over the size of everything: what wall and floor reach beyond, and the length of arrows."""


def room_of(scenario: Scenario) -> dict[str, Any]:
    """Return what stays: floor, wall, first view and arrows' length, as `page.js` draws them."""
    points, frame = _everything(scenario), scenario.view.frame
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    width, depth, _ = high - low + MARGIN * size
    floor = (*middle[:2], low[2]), (width, 0, 0), (0, depth, 0)
    # The wall is an image, which no lamp shades, just behind everything.
    local = _on_wall(points, frame)
    margin = MARGIN * size * np.array([1.0, 0.0])
    low, high = local.min(axis=0) - margin, local.max(axis=0) + MARGIN * size
    blank = np.full((1, 1, 3), COLOURS["wall"], np.uint8)
    # The first view: from beside the viewer of the wall, and from above.
    back = 0.7 * frame.normal + 0.6 * frame.across + np.array([0, 0, 0.35])
    return {
        "wall": _on_wall_image(blank, low, high, frame, -0.002),
        "floor": _image(np.full((1, 1, 3), COLOURS["floor"], np.uint8), *map(np.array, floor)),
        "arrow": MARGIN * size,
        "view": {"target": middle.tolist(), "eye": (middle + 0.8 * size * back).tolist()},
    }


def things_in(pictures: LivePictures) -> dict[str, Any]:
    """Return a scene's occluders, the photograph on its wall, the images on hidden surfaces."""
    scenario = pictures.scenario
    return {**images_in(pictures), "occluders": [_mesh(each) for each in scenario.view.occluders]}


def images_in(pictures: LivePictures) -> dict[str, Any]:
    """Return the photograph on a scene's wall, and the images on hidden surfaces."""
    scenario = pictures.scenario
    rectangle, images = _rectangle(scenario.view), hidden_pixels(pictures)
    shown = rectangle.shown(photograph_pixels(pictures))
    low, high, frame = rectangle.low, rectangle.high, scenario.view.frame
    return {
        "photograph": _on_wall_image(shown, low, high, frame, 0.002),
        "hidden": [_on_surface(images[name], each) for name, each in scenario.hidden.items()],
    }


def as_source(pixels: Pixels) -> str:
    """Return an image, (rows, columns, 3 or 4), as the address of an image in a page."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG", compress_level=1)  # of 30 a second
    return f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"


def _image(pixels: Pixels, center: Array, across: Array, up: Array) -> dict[str, Any]:
    """Return an image and its corners, (2, 2, 3), from the upper left."""
    corners = [[center + x * across + y * up for x in (-0.5, 0.5)] for y in (0.5, -0.5)]
    return {"source": as_source(pixels), "grid": np.array(corners).tolist()}


def _on_surface(pixels: Pixels, surface: Surface) -> dict[str, Any]:
    """Return an image and points of its surface, (rows, columns, 3), from the upper left."""
    lines = (np.linspace(0, n, min(n + 1, LINES)).round().astype(int) for n in surface.shape)
    return {"source": as_source(pixels), "grid": surface.vertices[np.ix_(*lines)].tolist()}


def _on_wall_image(
    pixels: Pixels, low: Array, high: Array, frame: WallFrame, ahead: float
) -> dict[str, Any]:
    """Return an image on the wall's rectangle from `low` to `high`, (2,) across and up."""
    (x, z), (width, height) = (low + high) / 2, high - low
    center = frame.center + x * frame.across + z * frame.up + ahead * frame.normal
    return _image(pixels, center, width * frame.across, height * frame.up)


def _mesh(occluder: Occluder) -> dict[str, Any]:
    """Return the triangles of an occluder, each vertex to 10 micrometres."""
    vertices, faces = occluder.vertices, occluder.faces
    if vertices is None or faces is None:  # no mesh: the box about it
        from trimesh.creation import box

        around = box(bounds=occluder.bounds)
        vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
    shown = np.round(np.asarray(vertices, float), 5)
    return {"vertices": shown.ravel().tolist(), "faces": faces.ravel().tolist()}


@dataclass(frozen=True, eq=False)
class Rectangle:
    """The rectangle about all pixels of a photograph on the wall, each place by the nearest pixel.

    `low` and `high` are its lower and upper corner, (2,) each, across and up, in metres. `nearest`,
    (rows, columns), are row-major numbers of pixels, -1 where the camera sees nothing.
    """

    low: Array
    high: Array
    nearest: NDArray[np.intp]

    @classmethod
    def about(cls, local: Array, shape: tuple[int, int]) -> "Rectangle":
        """Return that of a photograph of (rows, columns), whose pixels' centres are `local`."""
        rows, columns = shape
        low, high = local.min(axis=0), local.max(axis=0)
        half = (high - low) / np.maximum([columns - 1, rows - 1], 1) / 2
        low, high = low - half, high + half
        x = low[0] + (np.arange(columns) + 0.5) / columns * (high[0] - low[0])
        z = high[1] - (np.arange(rows) + 0.5) / rows * (high[1] - low[1])
        reach = float(2 * np.linalg.norm(half))
        places = np.stack(np.meshgrid(x, z), axis=-1)
        distances, nearest = KDTree(local).query(places, distance_upper_bound=reach)
        return cls(low, high, np.where(np.isfinite(distances), nearest, -1))

    def shown(self, pixels: Pixels) -> Pixels:
        """Return a photograph, (rows, columns, 3), on the rectangle, with opacity."""
        opaque = np.full((*pixels.shape[:2], 1), 255, np.uint8)
        flat = np.concatenate([pixels, opaque], axis=-1).reshape(-1, 4)
        return np.where(self.nearest[..., None] < 0, np.uint8(0), flat[self.nearest])


@lru_cache(maxsize=2)  # coarse and full; a scene at rest keeps its view
def _rectangle(view: View) -> Rectangle:
    return Rectangle.about(_on_wall(view.centers, view.frame), view.shape)


def _on_wall(points: Array, frame: WallFrame) -> Array:
    """Return points on the wall, (n, 2), across and up, in metres."""
    return np.asarray((points - frame.center) @ np.stack([frame.across, frame.up]).T)


def _everything(scenario: Scenario) -> Array:
    """Return the points, (n, 3), of all but far surroundings."""
    parts = parts_of(scenario)
    seen_and_hidden = np.concatenate([scenario.view.centers, scenario.hidden.centers])
    reach = np.linalg.norm(np.ptp(seen_and_hidden, axis=0))
    near = (p for p in parts.values() if np.linalg.norm(np.ptp(p, axis=0)) <= reach)
    return np.concatenate(list(near))
