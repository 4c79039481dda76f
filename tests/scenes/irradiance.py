"""Lambert's contour formula, an oracle of the light that a rectangle sends."""

import numpy as np


def polygon_irradiance(point, normal, corners):
    """Irradiance by a Lambertian polygon of radiance 1 wholly above the horizon."""
    rays = corners - point
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    following = np.roll(rays, -1, axis=0)
    angle = np.arccos(np.sum(rays * following, axis=1))
    edge = np.cross(rays, following)
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    return abs(angle @ (edge @ normal)) / 2
