"""A room with a wall, a monitor and nothing between them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import periscopy_sim as ps
from periscopy_sim.analytic import area_transport
from periscopy_sim.calibration import occluder, search
from periscopy_sim.rendering.scene_files import TriangleMesh

HIDDEN = (9, 12)
ROOM = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="orthographic" id="camera">
  <transform name="to_world">
    <scale x="0.45" y="0.45"/><lookat origin="0.67,1,0.5" target="0.67,1.08,0.5" up="0,0,1"/>
  </transform>
  <film type="hdrfilm">
    <integer name="width" value="28"/><integer name="height" value="28"/><rfilter type="box"/>
  </film>
</sensor>
<shape type="rectangle" id="wall">
  <transform name="to_world">
    <scale value="2"/><rotate x="1" angle="90"/><translate x="0.67" y="1.08" z="0.5"/>
  </transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
</shape>
<shape type="rectangle" id="monitor">
  <transform name="to_world">
    <scale x="0.2" y="0.15"/><rotate x="1" angle="90"/><rotate z="1" angle="180"/>
    <translate x="0.2" z="0.18"/>
  </transform>
  <emitter type="area"><rgb name="radiance" value="1"/></emitter>
</shape>
</scene>"""
BALL = {"piece_x": 0.45, "piece_y": 0.6, "piece_z": 0.32, "piece_radius": 0.06}
BOX = {"piece_x": 0.45, "piece_y": 0.6, "piece_z": 0.32, "piece_width": 0.1, "piece_depth": 0.08}
BOX |= {"piece_height": 0.06, "piece_turn": 20}


@pytest.fixture
def rough(monkeypatch):
    """Do far less than finds a piece for sure; a ball has 80 faces."""
    few = {"DRAWS": 128, "POPULATION": 16, "GENERATIONS": 4, "VALLEYS": 1}
    few |= {"LIKELY": 1, "MULTIPLES": (), "PATTERN": (), "RIDGE": (4.0,)}
    for name, value in few.items():
        monkeypatch.setattr(occluder, name, value)
    few = {"ROUNDS": 1, "PROPOSED": 3, "SHIFTS": (0.5,), "HOTTEST": 4.0}
    for name, value in few.items():
        monkeypatch.setattr(search, name, value)
    monkeypatch.setattr(area_transport, "PIXEL_POINTS", 28)
    sphere = trimesh.creation.icosphere(1)
    mesh = TriangleMesh(np.asarray(sphere.vertices), np.asarray(sphere.faces))
    ball = replace(occluder.KINDS["ball"], mesh=lambda: mesh)
    monkeypatch.setitem(occluder.KINDS, "ball", ball)


def photographed(path):
    """Return the light, (28, 28, 3), of a picture that fills the monitor, with noise of 0.1 %."""
    rng = np.random.default_rng(0)
    scene = ps.load_scenario(path, HIDDEN)
    picture = np.kron(rng.uniform(0.1, 1, (3, 4, 3)), np.ones((3, 3, 1)))
    y = (scene.A @ picture.reshape(-1, 3)).reshape(28, 28, 3)
    return y + y.mean() * (0.5 + 1e-3 * rng.standard_normal(y.shape))
