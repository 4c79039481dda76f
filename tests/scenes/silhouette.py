from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.mask_depth import Depth
from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.calibration.silhouette import Silhouette, write_masked_scene
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import Scenario, load_scenario

SCENE = """<scene version="3.0.0">
    <default name="shift" value="0"/>
    <default name="shift_error" value="0.005"/>
    <default name="turn" value="0"/>
    <default name="depth" value="0.57"/>
    <default name="depth_error" value="0"/>
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
    return MaskPlane.of(scenario, "card")


@pytest.fixture(scope="session")
def empty(scenario):
    """The scenario without the card."""
    view = replace(scenario.view, scene=scenario.scene.without("card"))
    return Scenario(view, scenario.hidden)


def silhouette(plane, opaque):
    seen, nothing = np.ones(opaque.shape, bool), np.zeros((1, 1, 3))
    depth = Depth(plane, np.array([0.228, 0.0, 0.29]), 0.55, np.zeros(3), {}, {}, 0.0)
    return Silhouette(
        "card", plane, depth, opaque.astype(float), seen, nothing, 0.0, 0.0, nothing, 0.0
    )


@pytest.fixture(scope="session")
def flagged(scene, plane):
    """The scene in which the card is a flag."""
    path, mesh = scene.with_name("flagged.xml"), scene.with_name("flag.ply")
    write_masked_scene(read_document(scene), silhouette(plane, FLAG), path, mesh, mesh.name)
    return path


@pytest.fixture(scope="session")
def images():
    """Two images whose colours change from patch to patch, as strongly as a photograph's."""
    random = np.random.default_rng(7)
    return [0.1 + random.random((*HIDDEN, 3)) ** 2 for _ in range(2)]


@pytest.fixture(scope="session")
def photographs(flagged, images):
    """Photographs of the images behind the flag, ambient light and noise added."""
    scenario = load_scenario(flagged, HIDDEN)
    return [photograph(scenario, image, seed) for seed, image in enumerate(images)]


def photograph(scenario, image, seed):
    signal = (area_transport(scenario) @ image.reshape(-1, 3)).reshape(40, 40, 3)
    ambient = point_light_backgrounds(scenario)[:, [40]].reshape(40, 40, 1)
    return add_noise(composite(signal, np.tile(ambient, 3), 1.0), 60, seed)
