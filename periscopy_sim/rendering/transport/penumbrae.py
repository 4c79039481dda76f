"""The transport matrix with its rays where shadows have edges: a few times faster for equal noise.

Between a pixel and a patch that see all of each other, or nothing, a few rays tell as much as many.
A few are traced everywhere, at Gauss and Legendre's points of the patch, by which an entry without
edges is as good as exact. Where they disagree, or with those of a neighbouring pixel or patch, an
edge passes: there all the rays are traced.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.transport.kernel import make_kernel
from periscopy_sim.rendering.transport.shadow_rays import LANES, RAYS, require_light
from periscopy_sim.rendering.variant import use_variant
from periscopy_sim.scenario import Scenario

PROBES = 4
"""Rays from a pixel's centre to a patch that look for edges."""

Mask = NDArray[np.bool_]


def render_penumbrae(
    scenario: Scenario, *, samples: int, pixel_samples: int, seed: int = 0
) -> NDArray[np.float32]:
    """Render A, (M, N), as `render_transport` does, with fewer rays where no shadow has an edge.

    For JIT variants, and walls without texture. Entries that an edge crosses are the same, byte for
    byte, as `render_transport` makes them.

    Raises
    ------
    SceneError
        If no light of the monitor reaches the wall.
    """
    use_variant()
    everywhere = np.arange(np.prod(scenario.transport_shape), dtype=np.uint32)
    probe = make_kernel(scenario, PROBES, "gauss", 1, visibility=True)
    A, visible = _evaluated(probe, 2, everywhere, scenario, PROBES, seed)
    lanes = everywhere[edges(visible.reshape(*scenario.photograph_shape, *scenario.hidden_shape))]
    kernel = make_kernel(scenario, samples, "jittered", pixel_samples)
    (A[lanes],) = _evaluated(kernel, 1, lanes, scenario, samples * pixel_samples, seed)
    require_light(A, scenario)
    return A.reshape(scenario.transport_shape)


def edges(visible: NDArray[np.floating[Any]]) -> Mask:
    """Return where shadows have edges, (M N,), of the part that is visible, (rows, columns, R, C).

    There some rays of an entry, or of its neighbours by pixel or by patch, pass and some do not.
    """
    some, not_all = visible > 0, visible < 1 - 0.5 / PROBES  # a division may round
    crossed = [_spread(some, axes) & _spread(not_all, axes) for axes in ((0, 1), (2, 3))]
    return np.asarray(crossed[0] | crossed[1]).ravel()


def _spread(where: Mask, axes: tuple[int, int]) -> Mask:
    """Return where a mask is true or a neighbour along two axes, diagonal ones too."""
    for axis in axes:
        moved = np.moveaxis(where, axis, 0)
        wider = moved.copy()
        wider[1:] |= moved[:-1]
        wider[:-1] |= moved[1:]
        where = np.moveaxis(wider, 0, axis)
    return where


def _evaluated(
    entries: Callable[[Any, Any, Any], Any],
    count: int,
    lanes: NDArray[np.uint32],
    scenario: Scenario,
    rays: int,
    seed: int,
) -> list[NDArray[np.float32]]:
    """Return what a kernel makes of some entries, by their row-major numbers: so many of each."""
    import drjit as dr
    import mitsuba as mi

    patches = scenario.transport_shape[1]
    found = [np.empty(len(lanes), np.float32) for _ in range(count)]
    at_once = max(1, min(LANES, RAYS // rays))
    for start in range(0, len(lanes), at_once):
        lane = mi.UInt32(lanes[start : start + at_once])
        values = entries(lane // patches, lane % patches, dr.opaque(mi.UInt32, seed))
        for each, value in zip(found, np.atleast_2d(np.array(values)), strict=True):
            each[start : start + at_once] = value
    return found
