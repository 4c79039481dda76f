"""The GLB file of a scene, read back by trimesh."""

import numpy as np
import pytest
import trimesh

import periscopy_sim as ps
from periscopy_sim.storage.glb import write_glb
from periscopy_sim.storage.rasters import srgb_bytes
from tests.scenes.cards import SIZES, write_cards

pytestmark = pytest.mark.usefixtures("jit")


def test_surfaces_have_their_places_and_the_colours_of_their_patches(tmp_path):
    scenario = ps.load_scenario(write_cards(tmp_path), SIZES)
    rng = np.random.default_rng(0)
    images = {name: rng.random((*size, 3)) for name, size in SIZES.items()}
    write_glb(tmp_path / "hidden.glb", scenario, images, rng.random((24, 24, 3)), {"seed": "3"})
    world = trimesh.load(tmp_path / "hidden.glb")
    assert world.metadata["seed"] == "3"
    occluders = {occluder.name for occluder in scenario.scene.occluders}
    assert world.geometry.keys() == {*SIZES, "photograph"} | occluders
    for name, surface in scenario.hidden.items():
        motion, geometry = world.graph[name]
        mesh = world.geometry[geometry]
        material = mesh.visual.material
        texture = np.asarray(material.emissiveTexture.convert("RGB"))
        np.testing.assert_array_equal(texture, srgb_bytes(images[name]))
        assert material.emissiveFactor.tolist() == [1, 1, 1] and not material.doubleSided
        # The middle of each patch, by the texture's coordinates, is where the scene has it.
        rows, columns = surface.shape
        u, v = mesh.visual.uv.T
        corners = np.rint([(1 - v) * rows, u * columns]).astype(int)
        places = surface.vertices[*corners]
        np.testing.assert_allclose(mesh.vertices, places, atol=1e-6)
        # In the file the surface stands upright and faces the viewer, who is at +Z.
        assert motion[:3, :3] @ surface.up[0] @ [0, 1, 0] > 0.99 * np.linalg.norm(surface.up[0])
        normals = mesh.face_normals @ motion[:3, :3].T
        np.testing.assert_allclose(normals, np.tile([0, 0, 1], (len(normals), 1)), atol=1e-5)
