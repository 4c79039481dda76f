"""B rendered: prototype backgrounds of a scene file's own emitters, large ones cut into panes.

Eq. 4's point lights are everywhere about the wall and cast no shadow. Where it is known which lamps
and windows a room has, each of them is a prototype: its light straight on the wall, past all that
stands between them. What bounces is smooth over the wall, which Eq. 4's lights follow.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.background import Part, placed_in, refined
from periscopy_sim.rendering.ambient.irradiance import direct_irradiance
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.pointwise import map_points, surface_at
from periscopy_sim.rendering.scene.refusals import check_media, check_opaque
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.rendering.wall_polynomials import REPLICAS
from periscopy_sim.scenario import Array, Scenario, pixel_edges
from periscopy_sim.shipped import find_scene

PANE = 0.25
"""Largest side of a pane, in metres."""

MOST_PANES = 256
"""Of an emitter: each is a column of B."""

TARGET = 1e-3
"""Error of a prototype relative to its brightness, after the factor that scales the whole."""

SAMPLES = 16
"""Samples of each prototype and pixel in a round of a replica, a square number."""


def emitter_backgrounds(
    path: str | Path,
    scenario: Scenario,
    parameters: Mapping[str, str] | None = None,
    *,
    pane: float = PANE,
    target: float = TARGET,
    max_rounds: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Return B of a scene file's emitters: one column for each, or for each pane of a large one.

    A rectangle is cut into panes of at most `pane` along its sides; every other emitter, such as a
    lamp, a mesh, the sun or the sky, is one prototype. Those that do not reach the wall are left
    out. The scene is moved so that its own wall, as its own camera sees it, coincides with what the
    scenario's camera sees, as by `render_background`.

    Parameters
    ----------
    path
        A scene file, or the name of a shipped one such as ``ambient/window_left``, with shape
        ``wall`` and sensor ``camera``, without a monitor.
    scenario
        The scene whose camera photographs; of its wall, the shape and a texture matter.
    parameters
        Values for the scene file's ``<default>``s.
    pane
        Largest side of a pane, in metres.
    target
        Relative error of a prototype at which to stop, see `Background.relative_error`.
    max_rounds
        Most rounds of samples for each emitter.
    seed
        Seed of every sampler. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        B, (M, L) float64, the channels' mean of each relative to its mean over the wall.

    Raises
    ------
    SceneError
        If the scene file lacks wall, camera or light, has a monitor, or Mitsuba refuses it, its
        camera does not see its wall, no emitter reaches that, a shape lets light through, or an
        emitter would be cut into too many panes.
    ValueError
        If `pane` is not above 0.
    VariantError
        In scalar variants.

    Warns
    -----
    RuntimeWarning
        The target was not reached within `max_rounds`.
    """
    if not pane > 0:
        raise ValueError(f"panes of {pane:g} m: give a side above 0")
    require_vectorized("light of a scene's emitters")
    path = find_scene(path)
    scene, points, normals = placed_in(path, scenario, parameters, _check_shadows)
    if any(shape.id() == "monitor" for shape in scene.shapes()):
        raise SceneError(
            f"scene '{path}': its monitor is none of the lamps of a room, and its light would be "
            "taken for ambient; name a scene without one"
        )
    report = progress or (lambda _: None)
    shape = scenario.photograph_shape
    wall = points, normals, pixel_edges(points, normals, shape)
    everywhere = np.arange(len(points))
    parts = [
        Part(estimate, everywhere, shape)
        for emitter in scene.emitters()
        for estimate in _prototypes(scene, emitter, wall, pane, path)
    ]
    seeds = iter(np.random.SeedSequence(seed).generate_state(len(parts) * max_rounds * REPLICAS))
    columns, worst = [], 0.0
    for number, part in enumerate(parts):
        irradiance, errors = refined([part], target, max_rounds, map(int, seeds), lambda _: None)
        if irradiance.any():
            columns.append(irradiance.mean(axis=1))
            worst = max(worst, np.hypot(*errors))
        report((number + 1) / len(parts))
    if not columns:
        raise SceneError(
            f"scene '{path}': none of its emitters reaches its wall straight; move them or the wall"
        )
    if worst > target:
        warnings.warn(
            f"'{path.stem}': light of an emitter is known to {worst:.1e} of its brightness only, "
            f"above {target:.1e}; raise max_rounds, or take larger panes",
            RuntimeWarning,
            stacklevel=2,
        )
    B = np.stack([column / column.mean() for column in columns], axis=1)
    texture = scenario.wall_texture
    return B if texture is None else B * texture[:, np.newaxis]


def _check_shadows(nodes: SceneNodes) -> None:
    """Refuse media, and shapes that let light through: prototypes have full shadows of all."""
    check_media(nodes)
    check_opaque(nodes, "the light of emitters straight on the wall would not pass it")


def _prototypes(
    scene: Any, emitter: Any, wall: tuple[Array, Array, Array], pane: float, path: Path
) -> list[Callable[[int], Array]]:
    """Return for each prototype of an emitter what estimates its irradiance, (M, 3), by a seed."""
    shape = emitter.get_shape()
    if shape is None or shape.class_name() != "Rectangle":
        return [partial(direct_irradiance, scene, emitter, *wall, SAMPLES)]

    def sides(uv: Any) -> tuple[Any, Any]:
        si = surface_at(shape, uv)
        return si.dp_dv, si.dp_du

    lengths = (np.linalg.norm(side) for side in map_points(sides, np.array([[0.5, 0.5]])))
    down, across = (max(1, int(np.ceil(length / pane - 1e-6))) for length in lengths)
    if down * across > MOST_PANES:
        raise SceneError(
            f"scene '{path}': emitter '{shape.id()}' would be cut into {down}x{across} panes of "
            f"{pane:g} m, above {MOST_PANES} in all; give larger panes"
        )
    estimate = partial(direct_irradiance, scene, emitter, *wall, SAMPLES)
    corners = [(row / down, column / across) for row, column in np.ndindex(down, across)]
    return [partial(estimate, pane=((down, across), corner)) for corner in corners]
