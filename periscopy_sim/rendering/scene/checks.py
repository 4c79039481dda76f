"""Reject what the light transport matrix would get wrong in silence.

A holds the light that goes straight from the monitor to the wall and is then reflected to the
camera, past shapes that let nothing through. So does `render_photograph` with a single bounce, and
with it any path tracer that samples the emitters: only all bounces, or sampling by the BSDF alone,
show what is missed.
"""

from collections.abc import Iterator
from itertools import permutations
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.rendering.scene.nodes import SceneNodes, numbers_of
from periscopy_sim.rendering.scene.wall import map_points, surface_at
from periscopy_sim.rendering.variant import dr, mi

OPAQUE = {
    "diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "pplastic", "principled",
    "measured", "measured_polarized", "twosided", "blendbsdf", "bumpmap", "normalmap",
}  # fmt: skip
"""BSDF plugins that let no light through by default; of a ``twosided`` one Mitsuba
makes sure."""

GRID = 64
"""Points along each side of a hidden surface's UV square at which to look for its surface."""

ALONG = 0.9
"""Cosine of the angle between the normals of surfaces that coincide rather than cross, at least."""

UV_ERROR = 1e-3
"""Error of UV coordinates and areas in single precision, generously."""


def check_nodes(nodes: SceneNodes) -> None:
    """Reject what light passes or is changed by on its way, and boxes turned inside out."""
    check_media(nodes)
    transparent = nodes.transparent
    for props in nodes.of_type("Shape"):
        place = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix)
        if props.plugin_name() == "cube" and np.linalg.det(place) < 0:
            raise nodes.error(
                f"shape '{props.id()}' is a cube turned inside out: it would stand on the other "
                "side of a face; give its sizes, and factors of them, positive numbers"
            )
        if props.id() in transparent:
            continue
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


def check_surface(shape: Any, what: str) -> None:
    """Reject a hidden surface whose parts are not the points of its UV square, each once.

    What lies outside of the square, or under the same coordinates as another part, would shine in
    the scene but not in A; Mitsuba's own textured emitters miss it as well. `what` names the
    surface in messages.
    """
    if shape.class_name() == "Cylinder":  # Mitsuba misplaces its points, in pictures of it too
        raise SceneError(f"{what} is a cylinder, which cannot show an image; use a mesh of it")
    if shape.is_mesh():
        faces = np.array(shape.faces_buffer(), np.int64).reshape(-1, 3)
        uv = np.array(shape.vertex_texcoords_buffer(), np.float64).reshape(-1, 2)
        edges = np.diff(uv[faces], axis=1)  # (F, 2, 2)
        covered = float(np.abs(np.linalg.det(edges)).sum() / 2)
        inside = np.abs(uv[faces] - 0.5).max() <= 0.5 + UV_ERROR
        # Faces of the square's whole area that leave no hole do not overlap.
        is_right = inside and abs(covered - 1) <= UV_ERROR
    else:
        covered, is_right = 1.0, True

    def found(uv: Any) -> tuple[Any]:
        si = surface_at(shape, uv)
        return (si.is_valid() & (dr.max(dr.abs(si.uv - uv)) < UV_ERROR),)

    row, column = np.divmod(np.arange(GRID**2), GRID)
    # Off the middle, where meshes have their edges.
    (valid,) = map_points(found, np.stack([column + 0.45, row + 0.4], axis=1) / GRID)
    if not (is_right and valid.all()):
        raise SceneError(
            f"{what}: its faces cover {covered:.1%} of its UV square, {valid.mean():.1%} of it "
            "once; give each of its points UV coordinates of its own, from 0 to 1, and let other "
            "surfaces be shapes of their own (of a box, its front alone)"
        )


def check_apart(hidden: Hidden, where: str) -> None:
    """Reject hidden surfaces of which one lies in another: each would be counted as seen."""
    for (name, surface), (other, base) in permutations(hidden.items(), 2):
        side = np.sqrt(np.linalg.norm(np.cross(base.across, base.up), axis=1, keepdims=True))
        edges = np.stack([base.across, base.up, side * base.normals], axis=1)
        ways = surface.centers[:, None] - base.centers
        places = np.abs(np.einsum("mni,nij->mnj", ways, np.linalg.inv(edges)))
        along = np.abs(surface.normals @ base.normals.T) > ALONG
        if shared := ((places <= [0.5, 0.5, UV_ERROR]).all(axis=2) & along).any(axis=1).mean():
            raise SceneError(
                f"{where}: hidden surface '{name}' coincides with '{other}' in {shared:.0%} of its "
                "area; move one of them, or leave it out"
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
