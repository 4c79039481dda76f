"""What a scene file says and which files it names, as Mitsuba has it or in words that help."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.nodes import SceneNodes


def mesh(filename):
    return f'<shape type="ply" id="sofa"><string name="filename" value="{filename}"/></shape>'


# -- XML -----------------------------------------------------------------------------------------


def test_missing_file_is_refused(tmp_path, refusal):
    assert refusal(tmp_path / "none.xml") == f"no scene file at '{tmp_path / 'none.xml'}'"
    assert refusal(tmp_path).startswith("no scene file at")


def test_unknown_plugin_and_unknown_property_are_refused_with_mitsubas_reason(room, refusal):
    message = refusal(room.write('<shape type="blob" id="ball"/>'))
    assert 'Plugin "blob" not found' in message
    assert "[plugin.cpp" not in message and not message.split("': ")[1].startswith("[")
    odd = '<shape type="sphere" id="ball"><float name="radiuss" value="1"/></shape>'
    assert '"radiuss"' in refusal(room.write(odd))


# -- parameters ----------------------------------------------------------------------------------


def test_undeclared_parameter_is_refused_with_the_declared_ones(room, refusal):
    path = room.write()
    message = refusal(path, {"color": "1"})
    assert message.endswith("declares no parameter 'color'; it declares none")
    radius = '<default name="radius" value="0.25"/><default name="x" value="7"/>'
    path = room.write(radius, room.blocker(radius="$radius"), room.blocker("$x, 0, 0", 1))
    message = refusal(path, {"radius": "1", "color": "1"})
    assert message.endswith("'color'; it declares radius (default 0.25), x (default 7)")


@pytest.mark.parametrize("value", ["nan", "-inf", "1e999", "0.1, NaN, 0"])
def test_parameters_that_are_not_finite_are_refused_by_name(room, value, refusal):
    scene = ('<default name="radius" value="{}"/>', room.blocker(radius="$radius"))
    assert "'radius'" in refusal(room.write(scene[0].format("0.1"), scene[1]), {"radius": value})
    assert "'radius'" in refusal(room.write(scene[0].format(value), scene[1]))


def test_transforms_that_are_not_finite_are_refused_by_name(room, refusal):
    assert "'wall'" in refusal(room.write(wall=room.wall(x="1e39")))


def test_default_of_an_included_file_can_be_set(room, tmp_path):
    default = '<default name="radius" value="0.06"/>'
    included = f'<scene version="3.0.0">{default}{room.blocker(radius="$radius")}</scene>'
    (tmp_path / "ball.xml").write_text(included)
    path = room.write('<include filename="ball.xml"/>')
    scene = SceneNodes(path, {"radius": "0.11"}).instantiate()
    ball = next(shape for shape in scene.shapes() if shape.id() == "ball")
    np.testing.assert_allclose(np.ravel(ball.bbox().max - ball.bbox().min), 0.22, atol=1e-6)


# -- included files ------------------------------------------------------------------------------


def test_files_that_include_each_other_are_refused(room, tmp_path, refusal):
    for name, other in ("ab", "ba"):
        roundabout = f"../{tmp_path.name}/{other}.xml"
        text = f'<scene version="3.0.0"><include filename="{roundabout}"/></scene>'
        (tmp_path / f"{name}.xml").write_text(text)
    assert "'a.xml' includes itself" in refusal(room.write('<include filename="a.xml"/>'))
    assert "'room2.xml' includes itself" in refusal(room.write('<include filename="room2.xml"/>'))


# -- files that nodes name -----------------------------------------------------------------------


def test_missing_mesh_is_refused_by_its_resolved_path(room, tmp_path, refusal):
    message = refusal(room.write(mesh("meshes/sofa.ply")))
    assert f"ply 'sofa' names a missing file '{tmp_path / 'meshes' / 'sofa.ply'}'" in message


# -- where files are looked for ------------------------------------------------------------------


def triangle(path, x):
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{x} 0.5 0.2\n0.5 0.5 0.2\n0.4 0.5 0.3\n3 0 1 2\n"
    )


@pytest.mark.parametrize(
    "tag",
    [
        '<include filename="work.xml"/>',
        '<path value="folder"/>',
        '<bsdf type="diffuse"><spectrum name="reflectance" filename="paint.spd"/></bsdf>',
        mesh("sofa.ply"),
    ],
)
def test_no_file_is_taken_from_the_folder_that_the_process_started_in(
    room, tmp_path, monkeypatch, tag, refusal
):
    import mitsuba as mi

    work = tmp_path / "work"
    (work / "folder").mkdir(parents=True)
    (work / "work.xml").write_text(f'<scene version="3.0.0">{room.blocker()}</scene>')
    (work / "paint.spd").write_text("300 0.25\n900 0.25\n")
    triangle(work / "sofa.ply", 0.4)
    monkeypatch.chdir(work)
    path = room.write(tag)
    assert len(mi.load_file(str(path)).shapes()) >= 2
    assert "names a missing file" in refusal(path)
