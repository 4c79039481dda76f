"""Ambient scenes of one lamp, as Mitsuba has them, and the light of that lamp."""

import numpy as np

from periscopy_sim.rendering.nodes import SceneNodes

LIGHT = (
    '<emitter type="point"><point name="position" value="0.2, -0.5, 0.9"/>'
    '<rgb name="intensity" value="1, 2, 3"/></emitter>'
)


def point_light(points):
    """I cos θ / r² of `LIGHT` on a wall that faces -y."""
    away = np.array([0.2, -0.5, 0.9]) - points
    squared = np.sum(away**2, axis=-1)
    return (-away[..., 1] / squared**1.5)[..., None] * [1, 2, 3]


def scene_of(path):
    """Return Mitsuba's scene of a wall and a camera, whose pixels average over their areas."""
    nodes = SceneNodes(path, required={"wall": "Shape", "camera": "Sensor"})
    nodes.average_pixels()
    return nodes.instantiate()
