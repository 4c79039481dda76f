"""Where the text of a scene puts its shapes and sensors, read as Mitsuba's parser reads it.

Mitsuba parses a scene once and confirms this reading (`SceneNodes.layout`); other values of the
scene's parameters then need no parser. What this module does not understand is NaN.

Most parameters move, turn or stretch: they change the ``to_world`` matrices of shapes and of the
camera from M to M'. The arrays of the loaded scene then move by M' M^-1.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from periscopy_sim.numerics import Array
from periscopy_sim.rendering.emitters.lcd import EXPONENTS
from periscopy_sim.rendering.emitters.lcd import PLUGIN as LCD
from periscopy_sim.rendering.scene.document import Element
from periscopy_sim.scene import EmissionProfile

NUMBERS = {"perspective": ("fov",), "cylinder": ("p0", "p1", "radius"), LCD: EXPONENTS}
"""Numbers of a plugin that a layout knows, beside ``to_world``."""

CAMERAS = "orthographic", "perspective"
"""Sensors whose rays through the picture's corners enclose all others."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""A number that Python and Mitsuba read alike."""


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """Where a scene has its shapes and sensors, and everything else that it says.

    `plugins` and `places`, matrices (4, 4) from a node's coordinates to the scene's, are by id; a
    perspective camera's matrix is scaled by its field of view, and a cylinder's is that of the
    cylinder of radius 1 about the z axis from z = 0 to 1. `emission` are the profiles of shapes
    that say their exponents, `rest` the other elements of the text; None if Mitsuba places
    something elsewhere.
    """

    plugins: dict[str, str] = field(default_factory=dict)
    places: dict[str, Array] = field(default_factory=dict)
    emission: dict[str, EmissionProfile] = field(default_factory=dict)
    rest: list[Element] | None = None


def written_layout(elements: Sequence[Element], names: Sequence[str]) -> SceneLayout:
    """Return the layout that a text describes; a shape or sensor without an id has its name."""
    rest: list[Element] = []
    layout = SceneLayout(rest=rest)
    nodes: dict[str, dict[str, Any]] = {}
    above: list[tuple[str, str, str | None]] = []  # about the present element
    for element in elements:
        level, tag, attributes = element
        name, plugin = attributes.get("name", ""), attributes.get("type", "")
        del above[level:]
        holder, kind, owner = above[-1] if above else ("", "", None)
        if tag in ("shape", "sensor"):
            owner = attributes.get("id") or "".join(names[len(nodes) : len(nodes) + 1])
            nodes[owner], layout.plugins[owner] = {"to_world": np.eye(4)}, plugin
        elif owner is not None and holder == "transform":
            step = _step(tag, tuple(attributes.items()))
            nodes[owner]["to_world"] = step @ nodes[owner]["to_world"]
            continue
        elif owner is not None and name in NUMBERS.get(kind, ()):
            is_point = tag == "point"
            nodes[owner][name] = _vector(attributes) if is_point else _number(attributes["value"])
            continue
        elif holder not in ("shape", "sensor") or not (
            tag == "emitter" or (tag, name) == ("transform", "to_world")
        ):
            owner = None
        above.append((tag, plugin, owner))
        rest.append(element)
    for owner, node in nodes.items():
        exponents = [node.pop(each, None) for each in EXPONENTS]
        if exponents != [None, None]:
            layout.emission[owner] = EmissionProfile(*(each or 0.0 for each in exponents))
        layout.places[owner] = place(layout.plugins[owner], **node)
    return layout


def only_motions(
    before: SceneLayout, after: SceneLayout, movable: Collection[str]
) -> dict[str, Array] | None:
    """Return the motion, (4, 4), of each thing whose place differs, by id; None if more differs.

    What is movable are ids.
    """
    exponents = [exponent for each in after.emission.values() for exponent in astuple(each)]
    if after.rest != before.rest or not all(exponent >= 0 for exponent in exponents):
        return None
    moved = {
        name: place @ np.linalg.inv(before.places[name])
        for name, place in after.places.items()
        if not np.array_equal(place, before.places[name])
    }
    if not moved.keys() <= {*movable}:
        return None
    for name, motion in moved.items():
        # Mitsuba renders in single precision. No comparison is true of NaN.
        is_finite = np.abs(after.places[name]).max() < np.finfo(np.float32).max
        if not (is_finite and np.linalg.det(motion) > 0):
            return None
    return moved


def place(plugin: str, to_world: Array, fov: float = 90.0, **ruled: Any) -> Array:
    """Return the matrix of a shape or sensor as a `SceneLayout` has it, of its plugin's numbers.

    The matrix is NaN if a perspective camera has no view, or is stretched.
    """
    if plugin == "cylinder":
        return np.asarray(to_world @ _along(**ruled))
    if plugin != "perspective":
        return to_world
    is_turned = np.allclose(to_world[:3, :3] @ to_world[:3, :3].T, np.eye(3))
    wide = np.tan(np.radians(fov / 2)) if is_turned and 0 < fov < 180 else np.nan
    return np.asarray(to_world * [wide, wide, 1, 1])


def _along(p0: Any = (0, 0, 0), p1: Any = (0, 0, 1), radius: float = 1.0) -> Array:
    """Return the matrix (4, 4) from the unit cylinder on z = 0 to that of a plugin's points."""
    axis = np.subtract(p1, p0)
    length = float(np.linalg.norm(axis))
    # By way of a direction that no rod has, so that the turn changes smoothly with the axis.
    between = np.sqrt([1, 2, 3]) / np.sqrt(6)
    along = np.eye(4)
    for bisector in (axis / (length or 1) - between, between - [0, 0, 1]):
        along[:3, :3] @= np.eye(3) - 2 * np.outer(bisector, bisector) / (bisector @ bisector)
    along[:3, :3] *= [radius, radius, length]
    along[:3, 3] = p0
    return along


@lru_cache(maxsize=4096)
def _step(tag: str, items: tuple[tuple[str, str], ...]) -> Array:
    """Return the matrix (4, 4) of one tag within a ``<transform>``."""
    attributes, step = dict(items), np.eye(4)
    if tag == "translate":
        step[:3, 3] = _vector(attributes)
    elif tag == "scale":
        step[:3, :3] *= _vector(attributes, "1")
    elif tag == "rotate":
        axis, angle = _vector(attributes), np.radians(_number(attributes["angle"]))
        axis = axis if axis.any() else np.full(3, np.nan)
        # Rodrigues' formula, as Mitsuba takes it: an axis of another length than 1 stretches.
        step[:3, :3] *= np.cos(angle)
        step[:3, :3] += np.sin(angle) * np.cross(axis, np.eye(3)).T
        step[:3, :3] += (1 - np.cos(angle)) * np.outer(axis, axis)
    elif tag == "lookat":
        ends = (_numbers(attributes.get(name, ""), 3) for name in ("origin", "target", "up"))
        origin, target, up = ends
        ahead = _unit(target - origin)
        left = _unit(np.cross(up, ahead))
        step[:3] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    elif tag == "matrix":
        numbers = _numbers(attributes["value"], 9, 16)
        size = 4 if len(numbers) == 16 else 3
        step[:size, :size] = numbers.reshape(size, size)
    else:
        step[:] = np.nan
    return step


def _number(text: str) -> float:
    return float(_numbers(text, 1)[0])


def _vector(attributes: Mapping[str, str], default: str = "0") -> Array:
    """Return x, y and z of a tag, given one by one or as the one or three numbers of a value."""
    if "value" in attributes:
        return np.broadcast_to(_numbers(attributes["value"], 1, 3), 3)
    return np.array([_number(attributes.get(axis, default)) for axis in "xyz"])


def _numbers(text: str, *counts: int) -> Array:
    """Return the numbers of a text; NaN if a word is no number or their count is another."""
    words = re.findall("[^, ]+", text)
    is_known = len(words) in counts and all(map(_NUMBER.fullmatch, words))
    return np.array(words, float) if is_known else np.full(counts[0], np.nan)


def _unit(vector: Array) -> Array:
    """Return a vector of length 1; NaN if it has no direction."""
    return vector / (np.linalg.norm(vector) or np.nan)
