"""What a measured camera sees of the wall."""

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import PerspectiveCamera, RectifiedCamera
from periscopy_sim.scenario import Array


def corners_seen(camera: PerspectiveCamera | RectifiedCamera, distance: float) -> Array:
    """Return x and z of the wall's points in the corners of a camera's picture, (4, 2).

    They are top left, top right, bottom right, bottom left, as the camera sees them, on the wall y
    = `distance`. A `ConfigurationError` says that the picture does not end on the wall.
    """
    if isinstance(camera, RectifiedCamera):
        x, z = (each.value for each in camera.bottom_left)
        right, top = x + camera.width.value, z + camera.height.value
        return np.array([(x, top), (right, top), (right, z), (x, z)])
    position = np.array([each.value for each in camera.position])
    x, z = (each.value for each in camera.target)
    ahead = np.array([x, distance, z]) - position
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, ahead)
    c, s = np.cos(np.radians(camera.roll.value)), np.sin(np.radians(camera.roll.value))
    across, up = c * across - s * up, s * across + c * up  # a positive roll is clockwise
    half = np.tan(np.radians(camera.field_of_view.value) / 2)
    tall = half * camera.film[0] / camera.film[1]
    rays = ahead + np.array([[-half], [half], [half], [-half]]) * across
    rays += np.array([[tall], [tall], [-tall], [-tall]]) * up
    if rays[:, 1].min() <= 1e-3 * np.linalg.norm(rays, axis=1).max():
        raise ConfigurationError(
            "camera: a corner of its picture shows what is beyond the wall's horizon; turn it more "
            "towards the wall, or make its field of view smaller"
        )
    reach = (distance - position[1]) / rays[:, 1:2]
    return np.asarray((position + reach * rays)[:, [0, 2]])
