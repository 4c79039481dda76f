"""Ambient light without a vectorized variant, each time in a process of its own."""

import json

import pytest

ROOM = """
import json, sys
import numpy as np
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.scene.load import load_scenario
scenario = load_scenario(sys.argv[1], (1, 1))
"""

POINT_LIGHT = """
found = render_background(sys.argv[2], scenario, target=1.0)
away = np.array([0.2, -0.5, 0.9]) - scenario.wall_points
expected = -away[:, 1] / np.sum(away**2, axis=1) ** 1.5
expected = 0.5 / np.pi * expected[:, None] * [1, 2, 3]
ratio = found.photograph.reshape(-1, 3) / expected
print(json.dumps([ratio.min(), ratio.max(), found.relative_error]))
"""

BRUTE_FORCE = """
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.scene.nodes import SceneNodes
nodes = SceneNodes(sys.argv[2], required={"wall": "Shape", "camera": "Sensor"})
nodes.average_pixels()
scene = nodes.instantiate()
found = [render_background(sys.argv[2], scenario, target=1.0, seed=seed) for seed in range(4)]
brute = [path_trace(scene, -1, samples=1024, seed=50 + seed) for seed in range(4)]
pictures = np.stack([[b.photograph for b in found], brute])
mean = pictures.mean(axis=1)
brightness = pictures.mean(axis=(2, 3, 4))
deviate = np.diff(brightness.mean(axis=1)) / np.sqrt(brightness.var(axis=1, ddof=1).sum() / 4)
scaled = mean / mean.mean(axis=(1, 2, 3), keepdims=True)
again = render_background(sys.argv[2], scenario, target=1.0, seed=0)
print(json.dumps({
    "deviate": abs(deviate[0]),
    "exactness": brightness.std() / brightness.mean(),
    "pixels": np.sqrt(np.mean((scaled[0] / scaled[1] - 1) ** 2)),
    "contrast": np.ptp(mean[1][..., 0]) / mean[1].mean(),
    "told": found[0].relative_error,
    "same": bool(np.array_equal(again.photograph, found[0].photograph)),
}))
"""

REFUSED = """
from periscopy_sim.errors import SceneError
try:
    render_background(sys.argv[2], scenario)
except SceneError as error:
    print(error)
"""

LIGHT = (
    '<emitter type="point"><point name="position" value="0.2, -0.5, 0.9"/>'
    '<rgb name="intensity" value="1, 2, 3"/></emitter>'
)


# A lone column's pixels are 0.4 m wide: the light's mean over them is not that at their centres.
@pytest.mark.parametrize(
    ("size", "within"), [((6, 8), 0.005), ((1, 5), 0.005), ((4, 1), 0.02), ((1, 1), 0.005)]
)
def test_light_that_does_not_bounce_is_the_direct_light_alone(size, within, room, scalar):
    camera = room.camera(size)
    place = room.write(LIGHT, monitor="", camera=camera)
    low, high, error = json.loads(scalar(ROOM + POINT_LIGHT, room.write(camera=camera), place))
    assert 1 - within < low <= high < 1 + within
    assert error < 0.01


def plane(name, scale, transform, color, inside=""):
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale value="{scale}"/>'
        f'{transform}</transform><bsdf type="diffuse"><rgb name="reflectance" value="{color}"/>'
        f"</bsdf>{inside}</shape>"
    )


@pytest.mark.thorough
def test_background_is_what_path_tracing_the_ambient_scene_gives(room, scalar):
    place = room.write(
        plane("floor", 0.8, '<translate x="0.7" y="0.2" z="-0.2"/>', "0.7, 0.5, 0.2"),
        plane(
            *("panel", 0.6, '<rotate x="1" angle="180"/><translate x="0.9" y="0.1" z="1.5"/>'),
            *("0", room.area),
        ),
        monitor="",
        camera=room.camera((12, 12)),
    )
    scene = room.write(camera=room.camera((12, 12)))
    found = json.loads(scalar(ROOM + BRUTE_FORCE, scene, place))
    assert found["exactness"] < 0.003
    assert found["deviate"] < 5
    assert found["pixels"] < 0.01
    assert found["contrast"] > 0.1
    assert 0 < found["told"] < 0.01
    assert found["same"]


def test_place_whose_own_wall_is_not_diffuse_or_black_is_refused(room, scalar):
    scene = room.write(camera=room.camera((4, 4)))
    refused = {
        '<bsdf type="roughconductor"/>': "the ambient scene's own wall must be diffuse",
        room.black: "the ambient scene's own wall must be black nowhere",
    }
    for bsdf, words in refused.items():
        place = room.write(LIGHT, monitor="", wall=room.wall(bsdf), camera=room.camera((4, 4)))
        assert words in scalar(ROOM + REFUSED, scene, place)


def test_own_wall_that_is_too_small_is_refused(room, scalar):
    small = room.wall().replace("<rotate", '<scale value="0.1"/><rotate')
    behind = room.wall().replace('id="wall"', 'id="behind"').replace('y="1"', 'y="1.6"')
    scene = room.write(camera=room.camera((4, 4)))
    for what in ("", behind):
        place = room.write(
            LIGHT,
            what,
            monitor="",
            wall=small,
            camera=room.camera((4, 4)).replace('"0.2"', '"0.05"'),
        )
        assert "as large as what the camera sees" in scalar(ROOM + REFUSED, scene, place)
