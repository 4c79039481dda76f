"""Labels beside what they name, where they hide nothing and do not overlap."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from periscopy_sim.scenario import Array

FARTHER = 200.0
"""Pixels of a thing that a label may cover rather than stand farther from what it names."""

HOLLOW = 0.1
"""Weight of what is hollow, where a label would cover it."""

STEP = 8.0
"""Pixels between the places of a line that labels are kept off."""

GAP = 9.0
"""Pixels between a thing and its label."""


class Labels:
    """The labels of one panel; they are placed once everything is drawn."""

    def __init__(self, ax: Any) -> None:
        self._ax = ax
        self._asked: list[tuple[str, Array, str]] = []
        self._hollow: set[str] = set()
        self._avoided: list[Array] = []
        self._lines: list[Array] = []

    def add(self, text: str, points: Array, colour: str, *, hollow: bool = False) -> None:
        """Name what covers the points (n, 2), in the panel's coordinates, if it is in sight.

        Other labels may stand within what is hollow, but rather beside it; see `avoid_line`.
        """
        self._hollow |= {text} if hollow else set()
        (left, right), (bottom, top) = sorted(self._ax.get_xlim()), sorted(self._ax.get_ylim())
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        if (high > (left, bottom)).all() and (low < (right, top)).all():
            self._asked.append((text, np.asarray(points, float), colour))

    def avoid(self, points: Array) -> None:
        """Keep labels off what covers the points (n, 2), too."""
        self._avoided.append(np.asarray(points, float))

    def avoid_line(self, points: Array) -> None:
        """Keep labels off the line through the points (n, 2): one that it strikes is illegible."""
        self._lines.append(np.asarray(points, float))

    def place(self) -> None:
        """Place every label: beside its thing, off all others' boxes and within the panel."""
        figure = self._ax.figure
        renderer = figure.canvas.get_renderer()
        frame = self._ax.get_window_extent(renderer)
        boxes = [self._box(points, frame) for _, points, _ in self._asked]
        weights = [HOLLOW if name in self._hollow else 1.0 for name, _, _ in self._asked]
        things = list(zip(boxes, weights, strict=True))
        things += [(self._box(points, frame), 1.0) for points in self._avoided]
        lines = [box for points in self._lines for box in self._along(points)]
        taken: list[Array] = []
        for (text, _, colour), box in zip(self._asked, boxes, strict=True):
            paper = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
            label = self._ax.text(
                0, 0, text, transform=None, fontsize=8, color=colour, zorder=10, ha="left",
                va="bottom", bbox=paper,
            )  # fmt: skip
            extent = label.get_window_extent(renderer)
            size = np.array([extent.width, extent.height])
            places = _candidates(box, size)
            costs = [_cost(place, size, [*taken, *lines], things, frame) for place in places]
            best = places[int(np.argmin(costs + FARTHER * (np.arange(len(places)) // 8)))]
            label.set_position(tuple(best))
            taken.append(np.concatenate([best, best + size]))

    def _along(self, points: Array) -> list[Array]:
        """Return points along a line in pixels, every `STEP`, as boxes."""
        ends = self._ax.transData.transform(points)
        found = []
        for start, end in pairwise(ends):
            count = max(2, int(np.linalg.norm(end - start) / STEP) + 1)
            found += [np.tile(at, 2) for at in np.linspace(start, end, count)]
        return found

    def _box(self, points: Array, frame: Any) -> Array:
        """Return the box of points in pixels, left, bottom, right, top, cut to the panel."""
        pixels = self._ax.transData.transform(points)
        low, high = [frame.x0, frame.y0], [frame.x1, frame.y1]
        ends = [np.clip(end, low, high) for end in (pixels.min(axis=0), pixels.max(axis=0))]
        return np.concatenate(ends)


def _candidates(box: Array, size: Array) -> list[Array]:
    """Return lower left corners of a label about a box: beside, above and below, then farther."""
    found = []
    middle = (box[:2] + box[2:] - size) / 2
    for gap in (GAP, 4 * GAP, 8 * GAP):
        right, left = box[2] + gap, box[0] - gap - size[0]
        above, below = box[3] + gap, box[1] - gap - size[1]
        found += [
            (right, middle[1]), (left, middle[1]), (middle[0], above), (middle[0], below),
            (right, above), (left, above), (right, below), (left, below),
        ]  # fmt: skip
    return [np.array(corner) for corner in found]


def _cost(
    corner: Array, size: Array, taken: list[Array], things: list[tuple[Array, float]], frame: Any
) -> float:
    """Return how bad a place is: off the panel, over other labels, over things by their weights."""
    label = np.concatenate([corner, corner + size])
    edges = np.array([frame.x0 + 2, frame.y0 + 2, frame.x1 - 2, frame.y1 - 2])
    outside = np.maximum(edges - label, 0)[:2].sum() + np.maximum(label - edges, 0)[2:].sum()
    return (
        100 * float(outside)
        + 20 * sum(_overlap(label, other) for other in taken)
        + sum(weight * _overlap(label, box) for box, weight in things)
    )


def _overlap(a: Array, b: Array) -> float:
    """Return the area, in pixels, that two boxes share; a thin box counts as some pixels wide."""
    b = b + np.array([-2, -2, 2, 2])
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, float(width)) * max(0.0, float(height))
