"""The meshes and hidden images under ``scenes`` are what their scripts and README say."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

SCENES = Path(__file__).parents[1] / "scenes"
MESH_PARTS = {"plant": 15}
IMAGE_NAMES = [
    "bars",
    "checker",
    "digits",
    "letters",
    "mushroom",
    "siemens",
    "still_life",
    "sunset",
]

Array = NDArray[np.float64]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def read_ply(name: str) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of a binary PLY file that holds nothing else."""
    header, body = (SCENES / "meshes" / f"{name}.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    assert "format binary_little_endian 1.0" in lines
    assert [line for line in lines if line.startswith("property")] == [
        "property float x",
        "property float y",
        "property float z",
        "property list uchar int vertex_indices",
    ]
    vertices = np.frombuffer(body, "<f4", 3 * counts["vertex"]).reshape(-1, 3)
    face = np.dtype([("corners", "u1"), ("index", "<i4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=vertices.nbytes)
    assert len(body) == vertices.nbytes + faces.nbytes
    assert (faces["corners"] == 3).all()
    return vertices.astype(np.float64), faces["index"].astype(np.int64)


def image(name: str) -> NDArray[np.uint8]:
    with Image.open(SCENES / "images" / f"{name}.png") as picture:
        assert picture.mode == "RGB"
        return np.asarray(picture)


def test_folders_hold_exactly_what_the_scripts_write_and_the_readme_lists() -> None:
    readme = (SCENES / "README.md").read_text()
    meshes = sorted(path.name for path in (SCENES / "meshes").iterdir())
    images = sorted(path.name for path in (SCENES / "images").iterdir())
    assert meshes == sorted(f"{name}.ply" for name in script("make_meshes").MESHES)
    assert meshes == [f"{name}.ply" for name in MESH_PARTS]
    assert images == sorted(f"{name}.png" for name in script("make_images").IMAGES)
    assert images == [f"{name}.png" for name in IMAGE_NAMES]
    assert all(f"`meshes/{name}`" in readme for name in meshes)
    assert all(f"`images/{name}`" in readme for name in images)


@pytest.mark.parametrize("name", MESH_PARTS)
def test_committed_mesh_is_what_the_script_builds(name: str) -> None:
    pytest.importorskip("trimesh")
    vertices, triangles = read_ply(name)
    built = script("make_meshes").build(name)
    np.testing.assert_allclose(vertices, built.vertices, rtol=0, atol=1.1e-6)
    np.testing.assert_array_equal(triangles, built.faces)


@pytest.mark.thorough
@pytest.mark.parametrize("name", IMAGE_NAMES)
def test_committed_image_is_what_the_script_draws(name: str) -> None:
    images = script("make_images")
    drawn = images.encode(images.IMAGES[name]())
    assert drawn.shape == (290, 360, 3)
    assert np.abs(drawn.astype(int) - image(name)).max() <= 1
