"""Parts of a laboratory's document, and the points of what they describe."""

from typing import get_args

import numpy as np

from periscopy_sim.laboratory.bodies import AnyBody

BODIES = get_args(get_args(AnyBody)[0])
KINDS = {get_args(body.model_fields["kind"].annotation)[0] for body in BODIES}

WALL = "errors: {length: 5 mm, angle: 1 deg}\nwall: {distance: 1.1 m +- 2 mm, reflectance: 0.6}\n"


CAMERA = """camera: {kind: rectified, film: 12x16, bottom_left: [30 cm, 12 cm], width: 48 cm,
         height: 30 cm}
"""


MONITOR = "monitor: {width: 40 cm, height: 30 cm, center: [5 cm, 1 cm, 31 cm]}\n"


HIDDEN = (2, 3)


PERSPECTIVE = """camera: {kind: perspective, film: 12x16, position: [1.2 m, 10 cm, 40 cm],
         field_of_view: 20 deg, %s}
"""


POSITION = np.array([0.2, 0.5, 0.05])


def turned(points, tilt=0.0, turn=0.0):
    """Tilt about x and then turn about z, in degrees, about the origin."""
    x, y, z = np.asarray(points, float).T
    a, b = np.radians([tilt, turn])
    y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
    return np.stack([x * np.cos(b) - y * np.sin(b), x * np.sin(b) + y * np.cos(b), z], axis=1)


def corners_of(low, high):
    """The eight corners of a box, (8, 3)."""
    return np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T


def same_points(found, expected):
    def order(points):
        return points[np.lexsort(np.round(points, 5).T)]

    found = np.unique(np.round(found, 6), axis=0)
    np.testing.assert_allclose(order(found), order(np.asarray(expected, float)), atol=3e-6)


def occluders(kind, more):
    place = "position: [20 cm, 50 cm, 5 cm], turn: 25 deg, tilt: -15 deg"
    return f"occluders: [{{kind: {kind}, name: thing, {place}, {more}}}]\n"
