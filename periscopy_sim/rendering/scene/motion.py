"""How the shapes and sensors of a scene moved with its parameters, where all else stayed.

Most parameters move, turn or stretch: they change the ``to_world`` matrices of shapes and of the
camera from M to M'. The arrays of the loaded scene then move by M' M^-1.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene.placement import SceneLayout
from periscopy_sim.scene import Occluder
from periscopy_sim.view import moved_points

CAMERAS = "orthographic", "perspective"
"""Sensors whose rays through the picture's corners enclose all others."""


def motions_between(
    before: SceneLayout, after: SceneLayout, movable: Collection[str]
) -> dict[str, Array] | None:
    """Return the motion, (4, 4), of each thing that moved; None if more than these differs.

    What is movable are ids of shapes; the camera, and a wall that is a rectangle, are so, too.
    """
    is_profile = all(exponent >= 0 for exponent in after.exponents.values())
    if after.rest != before.rest or not is_profile:
        return None
    motions = {}
    for name, place in after.places.items():
        if not np.array_equal(place, before.places[name]):
            # Mitsuba computes in single precision; no comparison is true of NaN.
            is_finite = (np.abs(place) < np.finfo("f4").max).all()
            if not (is_finite and np.linalg.det(place) * np.linalg.det(before.places[name]) > 0):
                return None
            motions[name] = place @ np.linalg.inv(before.places[name])
    seen = {"camera", "wall"} if after.plugins["wall"] == "rectangle" else set()
    if motions and not (after.plugins["camera"] in CAMERAS and motions.keys() <= {*movable, *seen}):
        return None
    return motions


def moved_occluder(occluder: Occluder, motions: Mapping[str, Array]) -> Occluder:
    """Return an occluder, moved if there is a motion of its name."""
    if occluder.name not in motions or occluder.vertices is None:
        return occluder
    vertices = moved_points(occluder.vertices, motions[occluder.name])
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return replace(occluder, vertices=vertices, bounds=bounds)
