"""The meshes, images and textures under ``scenes`` are what their scripts and README say."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

SCENES = Path(__file__).parents[1] / "scenes"
MESHES = {"make_meshes": SCENES / "meshes", "make_ambient_meshes": SCENES / "ambient" / "meshes"}
IMAGES = [path.stem for path in sorted((SCENES / "images").iterdir())]


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SCENES))
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_readme_lists_the_meshes_and_the_images(monkeypatch: pytest.MonkeyPatch) -> None:
    readme = (SCENES / "README.md").read_text()
    files = [f"meshes/{path.name}" for path in MESHES["make_meshes"].iterdir()]
    files += [f"images/{name}.png" for name in script("make_images", monkeypatch).IMAGES]
    assert all(f"`{file}`" in readme and (SCENES / file).is_file() for file in files)
    assert len(IMAGES) + 1 == len(files)


@pytest.mark.parametrize("name", MESHES)
def test_committed_meshes_are_what_the_script_builds(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    trimesh = pytest.importorskip("trimesh")
    meshes = script(name, monkeypatch)
    files = {path.stem: path for path in MESHES[name].glob("*.ply")}
    assert set(files) == set(meshes.MESHES)
    for mesh, path in files.items():
        built = meshes.build(mesh)
        committed = trimesh.load(path, process=False)
        np.testing.assert_allclose(committed.vertices, built.vertices, atol=2e-6, err_msg=mesh)
        np.testing.assert_array_equal(committed.faces, built.faces, err_msg=mesh)


@pytest.mark.thorough
@pytest.mark.parametrize("name", IMAGES)
def test_committed_image_is_what_the_script_draws(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = script("make_images", monkeypatch)
    drawn = images.encode(images.IMAGES[name]()).astype(int)
    assert np.abs(drawn - np.asarray(Image.open(SCENES / "images" / f"{name}.png"))).max() <= 1


def test_committed_textures_are_what_the_script_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    textures = script("make_ambient_textures", monkeypatch)
    files = {path.stem: path for path in (SCENES / "ambient" / "textures").glob("*.png")}
    assert set(files) == set(textures.TEXTURES)
    for name, path in files.items():
        drawn = textures.encode(textures.TEXTURES[name]()).astype(int)
        assert np.abs(drawn - np.asarray(Image.open(path))).max() <= 1, name
