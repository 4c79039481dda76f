"""A square rectangle before the wall, to be cut into cells, and the same scene without it."""

import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.cells.mask_plane import mask_plane
from periscopy_sim.calibration.silhouette.masked_scene import write_masked_scene
from periscopy_sim.calibration.silhouette.replaced_shape import with_mesh

from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.rendering.scene.load import load_scenario

SCENE = """<scene version="3.0.0">
    <default name="shift" value="0"/>
    <default name="shift_error" value="0.005"/>
    <default name="turn" value="0"/>
    <default name="depth" value="0.57"/>
    <default name="size" value="0.04"/>
    <integrator type="path"/>
    <sensor type="orthographic" id="camera">
        <transform name="to_world">
            <scale x="0.22" y="0.22"/>
            <lookat origin="0.74, 0.98, 0.27" target="0.74, 1.03, 0.27" up="0, 0, 1"/>
        </transform>
        <float name="near_clip" value="0.001"/>
        <film type="hdrfilm">
            <integer name="width" value="40"/>
            <integer name="height" value="40"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle" id="wall">
        <transform name="to_world">
            <rotate x="1" angle="90"/>
            <translate x="0.74" y="1.03" z="0.27"/>
        </transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
    </shape>
    <shape type="rectangle" id="monitor">
        <transform name="to_world">
            <scale x="0.2" y="0.15"/>
            <rotate x="1" angle="90"/>
            <rotate z="1" angle="180"/>
            <translate x="0.228" z="0.29"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>
    <!-- <shape id="card"> in a comment is none -->
    <shape type="rectangle" id="card">
        <transform name="to_world">
            <scale value="$size"/>
            <rotate x="1" angle="90"/>
            <rotate z="1" angle="$turn"/>
            <translate x="0.51" y="$depth" z="0.27"/>
            <translate x="$shift"/>
        </transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf>
    </shape>
    <shape type="sphere" id="ball">
        <point name="center" x="0.9" y="0.3" z="0.6"/>
        <float name="radius" value="0.01"/>
    </shape>
</scene>
"""
HIDDEN = (6, 7)

FLAG = np.array([[cell == "#" for cell in row] for row in (
    "........",
    ".######.",
    ".######.",
    ".##.....",
    ".####...",
    ".##.....",
    ".##.....",
    "........",
)])  # fmt: skip


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("silhouette") / "scene.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def scenario(scene):
    return load_scenario(scene, HIDDEN)


@pytest.fixture(scope="session")
def plane(scenario):
    return mask_plane(scenario, "card")


@pytest.fixture(scope="session")
def empty(scene):
    """The scenario without the card."""
    path = scene.with_name("empty.xml")
    path.write_text(with_mesh(scene, "card", None, {}, scene.parent), encoding="utf-8")
    return load_scenario(path, HIDDEN)


def silhouette(plane, opaque):
    nothing = np.zeros((1, 1, 3))
    return Silhouette(
        "card",
        plane,
        opaque,
        np.ones_like(opaque),
        0.0,
        nothing,
        0.0,
        0.0,
        0.0,
        1.0,
        nothing,
        1.0,
        0.0,
    )


@pytest.fixture(scope="session")
def flagged(scene, plane):
    """The scene in which the card is a flag."""
    path, mesh = scene.with_name("flagged.xml"), scene.with_name("flagged.ply")
    write_masked_scene(scene, silhouette(plane, FLAG), {}, path, mesh, mesh.name)
    return path
