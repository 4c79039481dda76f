"""Refuse what the light transport matrix would get wrong in silence.

A holds the light that goes straight from the monitor to the wall and is then reflected to the
camera, past shapes that let nothing through. So does `render_photograph` with a single bounce, and
with it any path tracer that samples the emitters: only all bounces, or sampling by the BSDF alone,
show what is missed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.pointwise import map_points, surface_at

OPAQUE = {
    "diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "pplastic", "principled",
    "measured", "measured_polarized", "twosided", "blendbsdf", "bumpmap", "normalmap",
}  # fmt: skip
"""BSDF plugins that let no light through unless they are told to; of a ``twosided`` one Mitsuba
makes sure."""

SCATTERING = OPAQUE - {"conductor", "plastic"} | {"roughdielectric", "principledthin"}
"""BSDF plugins without a mirror's or a clear pane's part, unless they hold another that has one."""

SIZELESS = {"point", "spot", "projector", "directional", "directionalarea"}
"""Emitter plugins whose light comes from a point or in one direction: chance never finds them."""

GRID = 64
"""Points along each side of the monitor's UV square at which its surface is looked for."""

UV_ERROR = 1e-3
"""Error of UV coordinates in single precision, generously. `check_monitor` accepts five times it
of the monitor's surface, which the grid resolves about as well."""


def check_nodes(nodes: SceneNodes) -> None:
    """Refuse what light passes or is changed by on its way, and what is turned inside out."""
    check_media(nodes)
    check_opaque(nodes, "the light transport matrix would count it as opaque")
    _check_outside(nodes)


def check_media(nodes: SceneNodes) -> None:
    """Refuse participating media: no light is scattered or absorbed on its way."""
    for kind in ("Shape", "Sensor"):
        for props in nodes.of_type(kind):
            for _, medium in nodes.children(props, "Medium"):
                raise SceneError(
                    f"scene '{nodes.path}': {kind.lower()} '{props.id()}' holds a participating "
                    f"medium ({medium.plugin_name()}), and light is taken to travel through empty "
                    "space; remove the medium"
                )


def check_opaque(nodes: SceneNodes, else_wrong: str) -> None:
    """Refuse shapes that let light through, wherever they stand, and say what would be wrong."""
    for props in nodes.of_type("Shape"):
        for bsdf in _bsdfs(nodes, props, sealed="twosided"):
            if not _is_opaque(bsdf):
                raise SceneError(
                    f"scene '{nodes.path}': shape '{props.id()}' may let light through (bsdf "
                    f"'{bsdf.plugin_name()}'), and {else_wrong}; remove the shape, or give it an "
                    "opaque bsdf (a mask's opacity is a number, 1; a bsdf of your own goes into a "
                    "twosided one)"
                )


def check_lamps(nodes: SceneNodes) -> None:
    """Refuse lamps without a size where a shape is clear or a mirror: paths miss what it sends on.

    From a clear pane or a mirror a path goes on in one direction, which such a lamp never lies in,
    and a ray aimed at the lamp is blocked by panes. So it is in Mitsuba's own path tracer.
    """
    lamps = [props for props in nodes.of_type("Emitter") if props.plugin_name() in SIZELESS]
    for props in nodes.of_type("Shape") if lamps else ():
        for bsdf in _bsdfs(nodes, props):
            if not (bsdf.plugin_name() in SCATTERING or _is_opaque_mask(bsdf)):
                raise SceneError(
                    f"scene '{nodes.path}': emitter '{lamps[0].id()}' ({lamps[0].plugin_name()}) "
                    f"has no size, and its light by way of shape '{props.id()}' (bsdf "
                    f"'{bsdf.plugin_name()}') would be missing; give the lamp a size, such as a "
                    "small sphere with an area emitter, or the shape a rough, opaque bsdf"
                )


def check_monitor(monitor: Any, path: Path) -> None:
    """Refuse a monitor whose surface is not that of its UV square, once.

    What lies outside of the square, or under the same coordinates as another part, would shine in
    the scene but not in A. Mitsuba's own textured emitters miss it as well, and find no or another
    point at some coordinates, as on a turned sphere.
    """
    import drjit as dr

    def locate(uv: Any) -> tuple[Any, Any]:
        si = surface_at(monitor, uv)
        found = si.is_valid() & (dr.max(dr.abs(si.uv - uv)) < UV_ERROR)
        return found, dr.select(found, dr.norm(dr.cross(si.dp_du, si.dp_dv)), 0)

    if monitor.class_name() == "Rectangle":  # always right
        return
    row, column = np.divmod(np.arange(GRID**2), GRID)
    # Off the middle, where meshes have their edges.
    found, area = map_points(locate, np.stack([column + 0.45, row + 0.4], axis=1) / GRID)
    if not monitor.is_mesh() and not found.all():
        raise SceneError(
            f"scene '{path}': Mitsuba finds no point of the monitor, or a wrong one, at "
            f"{1 - found.mean():.1%} of its UV coordinates; turn it otherwise, or use a mesh with "
            "UV coordinates"
        )
    share = area.mean() / float(np.ravel(monitor.surface_area())[0])
    if not abs(share - 1) <= 5 * UV_ERROR:
        raise SceneError(
            f"scene '{path}': the monitor's patches would hold {share:.1%} of its surface; give "
            "each of its points UV coordinates of its own, from 0 to 1, and let other surfaces "
            "be shapes of their own (of a box, its front alone is the monitor)"
        )


def _check_outside(nodes: SceneNodes) -> None:
    """Refuse round monitors and boxes turned inside out.

    Such a monitor's light would stay within, and of a box with a negative size the front of a face
    is its other side.
    """
    import mitsuba as mi

    for props in nodes.of_type("Shape"):
        kind = props.plugin_name()
        mirrored = np.linalg.det(np.array(props.get("to_world", mi.ScalarTransform4f()).matrix)) < 0
        is_round = props.id() == "monitor" and kind in ("sphere", "cylinder")
        if (kind == "cube" and mirrored) or (
            is_round and (mirrored or props.get("flip_normals", False))
        ):
            raise SceneError(
                f"scene '{nodes.path}': shape '{props.id()}' is a {kind} turned inside out; give "
                "its sizes in to_world positive numbers, and no flip_normals"
            )


def _bsdfs(nodes: SceneNodes, props: Any, sealed: str = "") -> Iterator[Any]:
    """Return the BSDFs within a node, but for those within a BSDF of the sealed type."""
    for _, inner in nodes.children(props, "BSDF"):
        yield inner
        if inner.plugin_name() != sealed:
            yield from _bsdfs(nodes, inner, sealed)


def _is_opaque(bsdf: Any) -> bool:
    if bsdf.plugin_name() == "principled":
        return "spec_trans" not in bsdf or _numbers(bsdf["spec_trans"]).max() <= 0
    return bsdf.plugin_name() in OPAQUE or _is_opaque_mask(bsdf)


def _is_opaque_mask(bsdf: Any) -> bool:
    is_mask = bsdf.plugin_name() == "mask" and "opacity" in bsdf
    return bool(is_mask and _numbers(bsdf["opacity"]).min() >= 1)


def _numbers(value: Any) -> Any:
    """Values of a number, a colour or a spectrum; NaN, which no comparison passes, of a texture."""
    try:
        return np.array(getattr(value, "values", value), dtype=np.float64)
    except (TypeError, ValueError, RuntimeError):
        return np.array(np.nan)
