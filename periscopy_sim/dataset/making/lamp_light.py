"""Light of a few lamps on the wall, by Eq. 4, fast enough for every photograph to have its own."""

from __future__ import annotations

import math

import numpy as np

from periscopy_sim.numerics.compilation import compiled_reordered
from periscopy_sim.scenario import Array


def lamp_light(lamps: Array, powers: Array, points: Array, normals: Array) -> Array:
    """Return the wall's responses to point lights, each scaled to its mean over the wall, added.

    Σ_l p_l ψ(α_l) / mean ψ(α_l), (M, 3), with ψ of Eq. 4, see `point_light_response`: lamps α
    (L, 3) in metres, off the wall; powers p (L, 3) by channel; wall points (M, 3) in metres and
    their unit normals. Its mean is Σ p in each channel. A lamp behind the whole wall gives nothing.
    """
    light = np.zeros((3, len(points)))
    _add_lamps(
        lamps, powers, np.ascontiguousarray(points.T), np.ascontiguousarray(normals.T), light
    )
    return light.T


@compiled_reordered
def _add_lamps(lamps: Array, powers: Array, points: Array, normals: Array, light: Array) -> None:
    M = points.shape[1]
    x, y, z = points
    nx, ny, nz = normals
    response = np.empty(M)
    for lamp in range(len(lamps)):
        a, b, c = lamps[lamp]
        total = 0.0
        for m in range(M):
            dx, dy, dz = a - x[m], b - y[m], c - z[m]
            squared = dx * dx + dy * dy + dz * dz
            height = max(dx * nx[m] + dy * ny[m] + dz * nz[m], 0.0)
            response[m] = height / (squared * math.sqrt(squared))
            total += response[m]
        if total == 0:
            continue
        for channel in range(3):
            scale = powers[lamp, channel] * M / total
            row = light[channel]
            for m in range(M):
                row[m] += scale * response[m]
