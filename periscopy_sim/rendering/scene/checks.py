"""Reject what the light transport matrix would get wrong in silence.

A holds the light that goes straight from the monitor to the wall and is then reflected to the
camera, past shapes that let nothing through. So does `render_photograph` with a single bounce, and
with it any path tracer that samples the emitters: only all bounces, or sampling by the BSDF alone,
show what is missed.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.nodes import SceneNodes, numbers_of
from periscopy_sim.rendering.scene.wall import map_points, surface_at
from periscopy_sim.rendering.variant import dr

OPAQUE = {
    "diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "pplastic", "principled",
    "measured", "measured_polarized", "twosided", "blendbsdf", "bumpmap", "normalmap",
}  # fmt: skip
"""BSDF plugins that let no light through by default; of a ``twosided`` one Mitsuba
makes sure."""

GRID = 64
"""Points along each side of the monitor's UV square at which its surface is looked for."""

UV_ERROR = 1e-3
"""Error of UV coordinates in single precision, generously. `check_monitor` accepts five times it
of the monitor's surface, which the grid resolves about as well."""


def check_nodes(nodes: SceneNodes) -> None:
    """Reject what light passes, wherever it stands, or is changed by on its way."""
    check_media(nodes)
    for props in nodes.of_type("Shape"):
        for name in _see_through(nodes, props):
            raise nodes.error(
                f"shape '{props.id()}' may let light through (bsdf '{name}'), and A would count it "
                "as opaque; remove the shape, or give it an opaque bsdf (a mask's opacity is a "
                "number, 1; a bsdf of your own goes into a twosided one)"
            )


def check_media(nodes: SceneNodes) -> None:
    """Reject participating media: no light is scattered or absorbed on its way."""
    for kind in ("Shape", "Sensor"):
        for props in nodes.of_type(kind):
            for _, medium in nodes.children(props, "Medium"):
                raise nodes.error(
                    f"{kind.lower()} '{props.id()}' holds a participating medium "
                    f"({medium.plugin_name()}), where light would scatter; remove the medium"
                )


def check_monitor(monitor: Any, path: Path) -> None:
    """Reject a monitor whose surface is not that of its UV square, once.

    What lies outside of the square, or under the same coordinates as another part, would shine in
    the scene but not in A; Mitsuba's own textured emitters miss it as well.
    """

    def area_at(uv: Any) -> tuple[Any]:
        si = surface_at(monitor, uv)
        is_here = si.is_valid() & (dr.max(dr.abs(si.uv - uv)) < UV_ERROR)
        return (dr.select(is_here, dr.norm(dr.cross(si.dp_du, si.dp_dv)), 0),)

    if monitor.class_name() == "Rectangle":  # always right
        return
    if not monitor.is_mesh():
        raise SceneError(f"scene '{path}': the monitor is no rectangle, and no mesh; give one")
    row, column = np.divmod(np.arange(GRID**2), GRID)
    # Off the middle, where meshes have their edges.
    (area,) = map_points(area_at, np.stack([column + 0.45, row + 0.4], axis=1) / GRID)
    share = area.mean() / float(np.ravel(monitor.surface_area())[0])
    if not abs(share - 1) <= 5 * UV_ERROR:
        raise SceneError(
            f"scene '{path}': the monitor's patches would hold {share:.1%} of its surface; give "
            "each of its points UV coordinates of its own, from 0 to 1, and let other surfaces "
            "be shapes of their own (of a box, its front alone is the monitor)"
        )


def _see_through(nodes: SceneNodes, props: Any) -> Iterator[str]:
    """Return the names of the BSDFs within a node that may let light through."""
    for _, inner in nodes.children(props, "BSDF"):
        name = str(inner.plugin_name())
        if name == "principled":
            # No comparison is true of a texture's NaN.
            opaque = "spec_trans" not in inner or numbers_of(inner["spec_trans"]).max() <= 0
        elif name == "mask":
            opaque = "opacity" in inner and numbers_of(inner["opacity"]).min() >= 1
        else:
            opaque = name in OPAQUE
        if not opaque:
            yield name
        elif name != "twosided":
            yield from _see_through(nodes, inner)
