from pathlib import Path
from xml.dom import minidom

import numpy as np
import pytest

from periscopy_sim.calibration.calibrated_scene import with_defaults, write_copy, write_document
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import load_scenario
from periscopy_sim.scene import SceneDocument
from periscopy_sim.shipped import find_scene

SCENE = """<!-- <default name="dx" value="not this"/> -->
<scene version="3.0.0">
    <default  name = 'dx'  value = "0"/>  <!-- the ruler's -->
    <default name="mesh" value="chair"/>
    <shape type="ply"><string name="filename" value="meshes/chair &amp; co.ply"/></shape>
    <shape type="ply"><string name="filename" value="meshes/$mesh.ply"/></shape>
    <bsdf type="diffuse"><string name="note" value="a &gt; b"/></bsdf>
</scene>
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "chair & co.ply").touch()
    path = tmp_path / "scene.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def test_only_the_value_changes_beside_the_scene(scene: Path) -> None:
    copied = with_defaults(read_document(scene), {"dx": "0.25"}, scene.parent)
    expected = minidom.parseString(SCENE.replace("""value = "0\"""", """value = "0.25\""""))
    assert copied.toxml() == expected.toxml()
    copy = scene.with_name("copy.xml")
    write_document(copied, copy)
    assert '<!-- <default name="dx" value="not this"/> -->\n<scene' in copy.read_text()


@pytest.mark.usefixtures("scene")
def test_a_default_of_an_included_file_is_declared_before_it(tmp_path: Path) -> None:
    outer = tmp_path / "outer.xml"
    outer.write_text('<scene version="3.0.0">\n    <include filename="scene.xml"/>\n</scene>\n')
    copied = tmp_path / "copied.xml"
    write_copy(read_document(outer), {"dx": r"7\g<9>"}, copied)
    assert copied.read_text().index('name="dx"') < copied.read_text().index("include")
    assert 'filename="scene.xml"' in copied.read_text()
    assert read_document(outer).defaults["dx"] == "0"
    # As Mitsuba has it, the first one counts.
    assert read_document(copied).defaults["dx"] == r"7\g<9>"


OUTER = """<scene version="3.0.0">
    <default name="mesh" value="meshes/chair &amp; co.ply"/>
    <default name="part" value="parts/room"/>
    <path value="library"/>
    <include filename="$part.xml"/>
    <shape type="ply"><string name="filename" value="$mesh"/></shape>
    <shape type="ply"><string name="filename" value="sofa.ply"/></shape>
    <bsdf type="diffuse"><spectrum name="reflectance" filename="paint.spd"/></bsdf>
</scene>
"""
ROOM = """<scene version="3.0.0">
    <shape type="ply"><string name="filename" value="meshes/wall.ply"/></shape>
    <include filename="nook.xml"/>
</scene>
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A scene of many files, in a folder whose name needs care."""
    folder = tmp_path / "a $dollar & more"
    for name in ("meshes/chair & co.ply", "meshes/wall.ply", "library/sofa.ply", "other.ply",
                 "sofa.ply", "paint.spd"):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    (folder / "parts").mkdir()
    (folder / "parts" / "room.xml").write_text(ROOM)
    (folder / "parts" / "nook.xml").write_text('<scene version="3.0.0"></scene>')
    (folder / "outer.xml").write_text(OUTER)
    return folder / "outer.xml"


@pytest.mark.parametrize("place", [".", "..", "meshes", "../elsewhere", "library"])
@pytest.mark.parametrize("mesh", ["meshes/chair & co.ply", "other.ply", "/absolute"])
def test_a_copy_names_the_files_of_the_scene_wherever_it_lies(
    house: Path, place: str, mesh: str, tmp_path: Path
) -> None:
    copy = house.parent / place / "copied.xml"
    copy.parent.mkdir(exist_ok=True)
    mesh = f"{tmp_path}/mesh.ply" if mesh == "/absolute" else mesh
    (tmp_path / "mesh.ply").touch()
    (tmp_path / "sofa.ply").touch()  # beside a copy that lies above
    scene = read_document(house, {"mesh": mesh})
    write_copy(scene, {}, copy)
    theirs = [file.resolve() for file in scene.files]
    assert len(theirs) == 7
    assert [file.resolve() for file in read_document(copy).files[1:]] == theirs[1:]


def test_a_file_that_would_be_taken_for_the_scenes_is_refused(house: Path, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "room.xml").write_text(ROOM)
    with pytest.raises(SceneError, match=r"would take '.*/parts/room.xml' for a file of"):
        write_copy(read_document(house), {}, tmp_path / "copied.xml")


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_bytes(b"<scene>\xff</scene>")
    with pytest.raises(SceneError, match="UTF-8"):
        with_defaults(SceneDocument(path), {}, tmp_path)


def test_the_copy_of_a_shipped_scene_is_the_scene_at_those_values(tmp_path: Path) -> None:
    values = {"occluder_dx": "0.0123", "monitor_dz": "-0.004", "resolution": "20"}
    copied = tmp_path / "calibrated.xml"
    write_copy(read_document(find_scene("chair")), values, copied, "a---b-->\x01$width")
    ours, theirs = load_scenario(copied, (4, 5)), load_scenario("chair", (4, 5), values)
    assert ours.photograph_shape == (20, 20)
    np.testing.assert_array_equal(ours.hidden.centers, theirs.hidden.centers)
    np.testing.assert_array_equal(
        ours.scene.occluders[0].vertices, theirs.scene.occluders[0].vertices
    )
