"""A scene in space as a GLB file, which viewers of three-dimensional models open."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.hidden import Surface
from periscopy_sim.numerics import Image
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.storage import outputs, rasters
from periscopy_sim.view import Geometry

NEAREST, CLAMP = 9728, 33071
"""GL's numbers for a texture that shows its pixels, and ends at its edges."""

GREY = 0.5
"""Reflectance of occluders, and a fifth of it is light of their own: some viewers have no lamp."""

FINEST = 64
"""Cells of a mesh along a side at most, whatever its texture has."""


def write_glb(
    path: Path,
    scenario: Geometry,
    images: Mapping[str, Image],
    photograph: Image,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write hidden surfaces with their images, the photograph on the wall, and grey occluders.

    The images are (R, C, 3) linear light in [0, 1] by the surfaces' ids, the photograph (rows,
    columns, 3). They shine: a viewer shows their colours under any lamp, from the front alone, so
    that the view from behind the wall is free. A viewer begins there: the first surface's up is the
    file's, Y, and its normal points to the viewer, along Z. Lengths are metres.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    surfaces: dict[str, Surface] = {**scenario.hidden, "photograph": scenario.view.surface}
    colours = {**images, "photograph": photograph}
    world = trimesh.Scene(metadata=dict(metadata or {}))
    for name, surface in surfaces.items():
        world.add_geometry(_shining(surface, colours[name], name), name, name)
    for solid in Survey(scenario).solids:
        if solid.faces is None:
            with np.errstate(divide="ignore", invalid="ignore"):  # it may be flat
                mesh = trimesh.convex.convex_hull(solid.points)
        else:
            mesh = trimesh.Trimesh(solid.points, solid.faces, process=False)
        grey = _material(solid.name, GREY, emissiveFactor=[GREY / 5] * 3, doubleSided=True)
        mesh.visual = trimesh.visual.TextureVisuals(material=grey)
        world.add_geometry(mesh, solid.name, solid.name)
    first = next(iter(scenario.hidden.values()))
    up, normal = first.up.mean(axis=0), first.normals.mean(axis=0)
    axes = np.stack([np.cross(up, normal), up, np.cross(np.cross(up, normal), up)])
    motion = np.eye(4)
    motion[:3, :3] = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    world.apply_transform(motion)
    with outputs.staged_file(path) as staged:
        staged.write_bytes(export_glb(world, tree_postprocessor=_show_pixels))


def _shining(surface: Surface, image: Image, name: str) -> Any:
    """Return a surface as a mesh whose texture is an image, seen from the front."""
    import trimesh
    from PIL import Image as Pillow

    rows, columns = (
        np.linspace(0, n, min(n, FINEST) + 1).round().astype(int) for n in surface.shape
    )
    vertices = surface.vertices[np.ix_(rows, columns)]
    v, u = np.meshgrid(1 - rows / rows[-1], columns / columns[-1], indexing="ij")
    numbers = np.arange(v.size).reshape(v.shape)
    above, beneath = numbers[:-1], numbers[1:]
    a, b, c, d = (e.ravel() for e in (above[:, :-1], beneath[:, :-1], beneath[:, 1:], above[:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    texture = Pillow.fromarray(rasters.srgb_bytes(image))
    # Black metal reflects the light of no lamp.
    material = _material(
        name, emissiveTexture=texture, emissiveFactor=[1, 1, 1], metallicFactor=1.0
    )
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    visual = trimesh.visual.TextureVisuals(uv, material=material)
    return trimesh.Trimesh(vertices.reshape(-1, 3), faces, visual=visual, process=False)


def _material(name: str, grey: float = 0.0, **settings: Any) -> Any:
    """Return a rough material of a grey reflectance."""
    from trimesh.visual.material import PBRMaterial

    base = {"roughnessFactor": 1.0, "metallicFactor": 0.0, "doubleSided": False} | settings
    return PBRMaterial(name, baseColorFactor=[grey, grey, grey, 1.0], **base)


def _show_pixels(tree: Any) -> None:
    """Let textures show their pixels as squares."""
    sampler = dict.fromkeys(("magFilter", "minFilter"), NEAREST)
    tree["samplers"] = [sampler | dict.fromkeys(("wrapS", "wrapT"), CLAMP)]
    for texture in tree["textures"]:
        texture["sampler"] = 0
