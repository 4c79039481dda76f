import numpy as np
import pytest

from periscopy_sim.calibration.calibrated_scene import with_defaults
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import declared_defaults
from periscopy_sim.rendering.scene.load import load_scenario
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
def scene(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "chair & co.ply").touch()
    path = tmp_path / "scene.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def test_only_the_value_changes_beside_the_scene(scene):
    copied = with_defaults(scene, {"dx": "0.25"}, scene.parent)
    assert copied == SCENE.replace("""value = "0\"""", """value = "0.25\"""")


def test_elsewhere_files_are_found_as_before(scene, tmp_path):
    copied = with_defaults(scene, {}, tmp_path / "elsewhere")
    assert f'value="{tmp_path}/meshes/chair &amp; co.ply"' in copied
    assert f'value="{tmp_path}/meshes/$mesh.ply"' in copied
    assert 'value="a &gt; b"' in copied


@pytest.mark.usefixtures("scene")
def test_a_default_of_an_included_file_is_declared_before_it(tmp_path):
    outer = tmp_path / "outer.xml"
    outer.write_text('<scene version="3.0.0">\n    <include filename="scene.xml"/>\n</scene>\n')
    copied = tmp_path / "copied.xml"
    copied.write_text(with_defaults(outer, {"dx": r"7\g<9>"}, tmp_path))
    assert copied.read_text().index('name="dx"') < copied.read_text().index("include")
    assert 'filename="scene.xml"' in copied.read_text()
    assert declared_defaults(outer)["dx"] == "0"
    assert declared_defaults(copied)["dx"] == r"7\g<9>"  # as Mitsuba has it, the first one counts


CHOSEN = """<scene version="3.0.0">
    <default name='mesh' value='meshes/chair &amp; co.ply'/>
    <default name="kind" value="chair"/>
    <shape type="ply"><string name="filename" value="$mesh"/></shape>
    <bsdf type="diffuse"><string name="note" value="$kind"/></bsdf>
</scene>
"""


def test_file_that_a_parameter_names_is_found_from_elsewhere(scene, tmp_path):
    scene.write_text(CHOSEN, encoding="utf-8")
    (tmp_path / "other.ply").touch()
    copied = tmp_path / "elsewhere" / "copied.xml"
    copied.parent.mkdir()
    for values, name in [({}, "meshes/chair & co.ply"), ({"mesh": "other.ply"}, "other.ply")]:
        copied.write_text(with_defaults(scene, values, copied.parent), encoding="utf-8")
        assert declared_defaults(copied) == {"mesh": str(tmp_path / name), "kind": "chair"}
        assert 'value="$mesh"' in copied.read_text()
    assert with_defaults(scene, {}, tmp_path) == CHOSEN
    within = with_defaults(scene, {}, tmp_path / "meshes")
    assert "<default name='mesh' value=\"chair &amp; co.ply\"/>" in within


@pytest.mark.parametrize("value", ["absent.ply", "{folder}/meshes/chair &amp; co.ply", "meshes"])
def test_parameter_that_names_no_file_beside_the_scene_is_kept(value, scene, tmp_path):
    value = value.format(folder=tmp_path)
    text = CHOSEN.replace("meshes/chair &amp; co.ply", value)
    scene.write_text(text, encoding="utf-8")
    assert with_defaults(scene, {}, tmp_path / "elsewhere") == text


def test_text_too_long_for_a_files_name_is_kept(scene, tmp_path):
    text = SCENE.replace("a &gt; b", "long " * 1000)
    scene.write_text(text, encoding="utf-8")
    assert with_defaults(scene, {}, tmp_path) == text


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_bytes(b"<scene>\xff</scene>")
    with pytest.raises(SceneError, match="UTF-8"):
        with_defaults(path, {}, tmp_path)


def test_the_copy_of_a_shipped_scene_is_the_scene_at_those_values(tmp_path):
    values = {"occluder_dx": "0.0123", "monitor_dz": "-0.004", "resolution": "20"}
    copied = tmp_path / "calibrated.xml"
    copied.write_text(with_defaults(find_scene("chair"), values, tmp_path), encoding="utf-8")
    ours, theirs = load_scenario(copied, (4, 5)), load_scenario("chair", (4, 5), values)
    assert ours.photograph_shape == (20, 20)
    np.testing.assert_array_equal(ours.patch_centers, theirs.patch_centers)
    np.testing.assert_array_equal(ours.occluders[0].vertices, theirs.occluders[0].vertices)
