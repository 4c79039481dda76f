import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from periscopy_sim import shipped
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.shipped import find_image, find_scene, scenes_folder

CHAIR = scenes_folder() / "chair.xml"


def refusal(find, name):
    with pytest.raises(PeriscopyError) as caught:
        find(name)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A working folder without a `scenes` of its own."""
    monkeypatch.chdir(tmp_path)


def test_shipped_scene_goes_by_name_or_by_its_path_in_a_checkout():
    for name in ["chair", "chair.xml", "scenes/chair.xml", Path("scenes/chair")]:
        assert find_scene(name) == CHAIR
        assert CHAIR.is_file()


def test_shipped_image_goes_by_name_or_by_its_path_in_a_checkout():
    for name in ["mushroom", "images/mushroom.png", "scenes/images/mushroom.png"]:
        assert find_image(name) == scenes_folder() / "images" / "mushroom.png"


def test_a_file_of_ones_own_comes_before_a_shipped_one(tmp_path):
    own = tmp_path / "chair.xml"
    own.write_text("<scene/>")
    assert find_scene("chair.xml") == Path("chair.xml")
    assert find_scene(own) == own
    assert find_scene("chair") == CHAIR
    picture = tmp_path / "photo.jpg"
    picture.write_bytes(b"")
    assert find_image(picture) == picture


def test_unknown_name_is_refused_with_the_names_there_are():
    message = refusal(find_scene, "sofa")
    assert message.startswith("scene 'sofa' does not exist; ")
    assert ": bright_room, chair, corner, doorway, plant, plate, ambient/" in message
    message = refusal(find_image, "sofa")
    assert message.startswith("image 'sofa' does not exist; ")
    assert "letters, mushroom" in message


@pytest.mark.parametrize("find", [find_scene, find_image])
def test_a_name_that_no_file_can_have_is_refused(find):
    assert "a" * 100 in refusal(find, "a" * 5000)


ELSEWHERE = (
    "mine/chair.xml",
    "../chair.xml",
    "ambient/../chair",
    "{}/chair.xml",
    "{}/scenes/own.xml",
)


def test_a_missing_file_is_not_taken_for_a_shipped_one(tmp_path):
    for name in ["", ".", "scenes", "images", "chair.obj", "chair.xml.bak", *ELSEWHERE]:
        (tmp_path / "own.xml").write_text("<scene/>")
        for find in (find_scene, find_image):
            refusal(find, name.format(tmp_path))


def place(folder):
    (folder / "scenes").mkdir(parents=True)
    (folder / "scenes" / "chair.xml").write_text("<scene/>")


def test_scenes_inside_the_package_come_before_those_beside_it(tmp_path, monkeypatch):
    package = tmp_path / "site" / "periscopy_sim"
    monkeypatch.setattr(shipped, "__file__", str(package / "shipped.py"))
    place(tmp_path / "site")
    assert scenes_folder() == tmp_path / "site" / "scenes"
    place(package)
    assert scenes_folder() == package / "scenes"


def test_an_installation_without_scenes_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(shipped, "__file__", str(tmp_path / "periscopy_sim" / "shipped.py"))
    assert "install" in refusal(find_scene, "chair")


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
