"""Labels beside the things they name, where they hide nothing and do not overlap."""

from itertools import pairwise
from typing import Any

import numpy as np

from periscopy_sim.scenario import Array

GAPS = 9.0, 36.0, 72.0
"""Pixels between a thing and its label, the nearest first."""


class Labels:
    """The labels of one panel; `place` them once everything is drawn."""

    def __init__(self, ax: Any) -> None:
        self._ax = ax
        self._labels: list[tuple[str, Array, str]] = []
        self._avoided: list[Array] = []

    def add(self, text: str, points: Array, colour: str, *, hollow: bool = False) -> None:
        """Name the thing at points (n, 2), in the panel's coordinates, if it is in sight.

        Other labels may stand within a hollow thing.
        """
        (left, right), (bottom, top) = sorted(self._ax.get_xlim()), sorted(self._ax.get_ylim())
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        if (high > (left, bottom)).all() and (low < (right, top)).all():
            self._labels.append((text, points, colour))
            if not hollow:
                self.avoid(points)

    def avoid(self, points: Array) -> None:
        """Keep labels off the box of points (n, 2)."""
        self._avoided.append(points)

    def avoid_line(self, points: Array) -> None:
        """Keep labels off the line through points (n, 2): a label that it strikes is illegible."""
        for start, end in pairwise(points):
            self._avoided += [place[None] for place in np.linspace(start, end, 80)]

    def place(self) -> None:
        """Place every label: beside its thing, off all others' boxes and within the panel."""
        renderer = self._ax.figure.canvas.get_renderer()
        frame = self._ax.get_window_extent(renderer)
        low, high = np.array([frame.x0, frame.y0]), np.array([frame.x1, frame.y1])

        def box(points: Array) -> Array:
            """Return the box of points in pixels, left, bottom, right, top, cut to the panel."""
            pixels = self._ax.transData.transform(points)
            ends = pixels.min(axis=0), pixels.max(axis=0)
            return np.concatenate([np.clip(end, low, high) for end in ends])

        boxes = [box(points) for points in self._avoided]
        paper = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
        for text, points, colour in self._labels:
            label = self._ax.text(
                0, 0, text, transform=None, color=colour, zorder=10, ha="left", va="bottom",
                bbox=paper,
            )  # fmt: skip
            extent = label.get_window_extent(renderer)
            places = _places(box(points), np.array([extent.width, extent.height]))
            outside = (places[:, :2] < low + 2).any(axis=1) | (places[:, 2:] > high - 2).any(axis=1)
            hidden = 1000 * outside + _overlaps(places, np.array(boxes)).sum(axis=1)
            best = places[np.argmin(hidden)]  # the nearest of the best
            label.set_position(tuple(best[:2]))
            boxes.append(best)


def _places(box: Array, size: Array) -> Array:
    """Return boxes, (n, 4), of a label about a thing's box: beside, above, below, then farther."""
    middle = (box[:2] + box[2:] - size) / 2
    corners = []
    for gap in GAPS:
        (left, below), (right, above) = box[:2] - gap - size, box[2:] + gap
        corners += [
            (right, middle[1]), (left, middle[1]), (middle[0], above), (middle[0], below),
            (right, above), (left, above), (right, below), (left, below),
        ]  # fmt: skip
    return np.hstack([corners, corners + size])


def _overlaps(a: Array, b: Array) -> Array:
    """Return whether boxes (n, 4) and (m, 4), or points, come within 2 pixels, (n, m)."""
    a, b = a[:, None], b + np.array([-2, -2, 2, 2])
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    return np.asarray((sides > 0).all(axis=2))
