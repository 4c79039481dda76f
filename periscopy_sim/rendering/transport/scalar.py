"""The transport matrix where nothing vectorizes: column by column with Mitsuba's own integrator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import build_scene, camera_of
from periscopy_sim.rendering.scene.nodes import monitor_texture
from periscopy_sim.rendering.variant import FIXED_BLOCKS
from periscopy_sim.scenario import Scenario


def render_columns(
    scenario: Scenario,
    A: NDArray[np.float32],
    *,
    samples: int,
    seed: int,
    progress: Callable[[float], None],
) -> NDArray[np.float32]:
    """Fill and return A, (M, N), by rendering the wall with one patch lit at a time.

    The C++ direct integrator sees a plain area emitter, one sample of it a camera sample; the
    angular profile, taken between the pixel's and the patch's centre, is multiplied in afterwards.
    That is exact up to the profile's curvature over a patch and a pixel. An emitter without a
    closed-form profile (others than ``area`` and ``lcd``) is a `SceneError`.
    """
    import mitsuba as mi

    if scenario.emission is None:
        raise SceneError(
            f"scene '{scenario.path}': in scalar variants the monitor's emitter must be an 'area' "
            "or 'lcd' emitter; use llvm_ad_rgb or cuda_ad_rgb for any other"
        )
    hidden = (*scenario.hidden_shape, 3)
    scene = build_scene(scenario, np.zeros(hidden), only_monitor=True, plain_emitter=True)
    integrator = mi.load_dict(
        {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, **FIXED_BLOCKS}
    )
    camera, lit = camera_of(scene), mi.traverse(scene)
    profile = profile_matrix(scenario)
    for patch in range(A.shape[1]):
        image = np.zeros((A.shape[1], 3), np.float32)
        image[patch] = 1
        lit["monitor.emitter.radiance.data"] = mi.TensorXf(
            monitor_texture(image.reshape(hidden), scenario.mirrored)
        )
        lit.update()
        # Seeds differ for every column, also those of neighbouring seeds.
        own_seed = (seed * A.shape[1] + patch) % 2**32
        column = np.array(
            mi.render(scene, sensor=camera, integrator=integrator, spp=samples, seed=own_seed)
        )
        A[:, patch] = column.mean(axis=2).ravel() * profile[:, patch]
        progress((patch + 1) / A.shape[1])
    return A


def profile_matrix(scenario: Scenario) -> NDArray[Any]:
    """Evaluate the profile, 1 along the normal, from each patch's centre to each point: (M, N)."""
    assert scenario.emission is not None
    axes = []
    for axis in (scenario.patch_across, scenario.patch_up, scenario.patch_normals):
        unit = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        offset = np.sum(unit * scenario.patch_centers, axis=1)
        axes.append(scenario.wall_points @ unit.T - offset)
    return scenario.emission(*axes)
