"""Where a scene has its shapes and sensors, and what moves them from there.

Most parameters move, turn or stretch: they change the ``to_world`` matrices of shapes and of the
camera from M to M'. The arrays of the loaded scene then move by M' M^-1.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from periscopy_sim.numerics import Array
from periscopy_sim.rendering.emitters.lcd import EXPONENTS
from periscopy_sim.rendering.emitters.lcd import PLUGIN as LCD
from periscopy_sim.scene import EmissionProfile

NUMBERS = {"perspective": ("fov",), "cylinder": ("p0", "p1", "radius"), LCD: EXPONENTS}
"""Numbers of a plugin that a layout knows, beside ``to_world``."""

CAMERAS = "orthographic", "perspective"
"""Sensors whose rays through the picture's corners enclose all others."""


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """Where a scene has its shapes and sensors, and everything else that it says.

    `plugins` and `places`, matrices (4, 4) from a node's coordinates to the scene's, are by id; a
    perspective camera's matrix is scaled by its field of view, and a cylinder's is that of the
    cylinder of radius 1 about the z axis from z = 0 to 1. `emission` has the profile of each hidden
    surface, `rest` what Mitsuba's nodes hold beside all this.
    """

    plugins: Mapping[str, str]
    places: Mapping[str, Array]
    emission: Mapping[str, EmissionProfile | None]
    rest: list[Any]


def only_motions(
    before: SceneLayout, after: SceneLayout, movable: Collection[str]
) -> dict[str, Array] | None:
    """Return the motion, (4, 4), of each moved part, by id; None if more than places differ.

    `movable` are ids.
    """
    if after.rest != before.rest:
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


def place(plugin: str, to_world: Array, fov: Any = 90.0, **ruled: Any) -> Array:
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
