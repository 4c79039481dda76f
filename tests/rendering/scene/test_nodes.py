import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.scene.load import camera_of, load_scenario
from periscopy_sim.rendering.scene.nodes import SceneNodes, monitor_texture
from periscopy_sim.scenario import EmissionProfile

POINT = (
    '<emitter type="point"><point name="position" value="1, 0.2, 0.4"/>'
    '<rgb name="intensity" value="3"/></emitter>'
)


def refusal(path, *arguments, **options):
    """The message of the SceneError, of one line, that names the file."""
    with pytest.raises(SceneError) as caught:
        SceneNodes(path, *arguments, **options).instantiate()
    message = str(caught.value)
    assert "\n" not in message
    assert f"'{path}'" in message
    return message


def mesh(filename):
    return f'<shape type="ply" id="sofa"><string name="filename" value="{filename}"/></shape>'


# -- refusals ------------------------------------------------------------------------------------


def test_missing_file_is_refused(tmp_path):
    assert refusal(tmp_path / "none.xml") == f"no scene file at '{tmp_path / 'none.xml'}'"
    assert refusal(tmp_path).startswith("no scene file at")


@pytest.mark.parametrize("content", [b"<scene version='3.0.0'><shape></scene>", b"", b"\xff\xfe\0"])
def test_malformed_xml_is_refused(tmp_path, content):
    path = tmp_path / "bad.xml"
    path.write_bytes(content)
    assert "is not well-formed XML" in refusal(path)


@pytest.mark.parametrize("content", ["<foo/>", "<scene/>", '<scene version="3.0.0"><a/></scene>'])
def test_xml_that_is_no_scene_is_refused(tmp_path, content):
    path = tmp_path / "bad.xml"
    path.write_text(content)
    refusal(path)


def test_undeclared_parameter_is_refused_with_the_declared_ones(room):
    path = room.write()
    message = refusal(path, {"color": "1"})
    assert message.endswith("declares no parameter 'color'; it declares none")
    radius = '<default name="radius" value="0.25"/><default name="x" value="7"/>'
    path = room.write(radius, room.blocker(radius="$radius"), room.blocker("$x, 0, 0", 1))
    message = refusal(path, {"radius": "1", "color": "1"})
    assert message.endswith("'color'; it declares radius (default 0.25), x (default 7)")


def test_parameter_without_a_default_is_refused(room):
    assert "$radius" in refusal(room.write(room.blocker(radius="$radius")))


@pytest.mark.parametrize(
    ("missing", "kind", "others"),
    [
        ("wall", "shape", "its shapes: 'monitor', 'ball'"),
        ("monitor", "shape", "its shapes: 'wall', 'ball'"),
        ("camera", "sensor", "its sensors: none"),
    ],
)
def test_missing_part_of_the_contract_is_refused_with_what_there_is(room, missing, kind, others):
    message = refusal(room.write(room.blocker(), **{missing: ""}))
    assert message.endswith(f"has no {kind} with id '{missing}' ({others})")


def test_another_kind_of_node_does_not_serve_as_the_wall(room):
    lamp = POINT.replace("<emitter", '<emitter id="wall"')
    assert "has no shape with id 'wall'" in refusal(room.write(lamp, wall=""))


def test_only_what_is_required_must_be_there(room):
    required = {"wall": "Shape", "camera": "Sensor"}
    SceneNodes(room.write(monitor=""), required=required).instantiate()
    assert "'camera'" in refusal(room.write(monitor="", camera=""), required=required)


def test_missing_mesh_is_refused_by_its_resolved_path(room, tmp_path):
    message = refusal(room.write(mesh("meshes/sofa.ply")))
    assert f"ply 'sofa' names a missing file '{tmp_path / 'meshes' / 'sofa.ply'}'" in message


def test_missing_texture_is_refused(room):
    bitmap = '<texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/>'
    wall = room.wall(f'<bsdf type="diffuse">{bitmap}</texture></bsdf>')
    assert "names a missing file" in refusal(room.write(wall=wall))


def test_empty_mesh_is_refused(room, tmp_path):
    (tmp_path / "sofa.ply").write_bytes(b"")
    message = refusal(room.write(mesh("sofa.ply")))
    assert f"ply 'sofa' names an empty file '{tmp_path / 'sofa.ply'}'" in message


@pytest.mark.parametrize("content", [b"ply\nformat ascii 1.0\nnonsense\n", b"not a mesh"])
def test_damaged_mesh_is_refused_with_mitsubas_reason(room, tmp_path, content):
    (tmp_path / "sofa.ply").write_bytes(content)
    assert "sofa.ply" in refusal(room.write(mesh("sofa.ply")))


def test_unknown_plugin_and_unknown_property_are_refused_with_mitsubas_reason(room):
    message = refusal(room.write('<shape type="blob" id="ball"/>'))
    assert 'Plugin "blob" not found' in message
    assert "[plugin.cpp" not in message and not message.split("': ")[1].startswith("[")
    odd = '<shape type="sphere" id="ball"><float name="radiuss" value="1"/></shape>'
    assert '"radiuss"' in refusal(room.write(odd))


def test_two_nodes_of_one_id_are_refused(room):
    assert 'duplicate ID: "ball"' in refusal(room.write(room.blocker(), room.blocker()))


def test_monitor_without_emitter_is_refused(room):
    nodes = SceneNodes(room.write(monitor=room.monitor("")))
    for method in (nodes.emission_profile, lambda: nodes.show(None)):
        with pytest.raises(SceneError, match="'monitor' has no emitter; give it one"):
            method()


def test_emitter_without_radiance_is_refused(room):
    nodes = SceneNodes(room.write(monitor=room.monitor('<emitter type="area"/>')))
    with pytest.raises(SceneError, match="emitter 'area' has no 'radiance'"):
        nodes.show(None)


def test_film_that_is_not_an_hdrfilm_is_refused(room):
    nodes = SceneNodes(room.write(camera=room.camera(film="specfilm")))
    with pytest.raises(SceneError, match="sensor 'camera' has no film of type hdrfilm"):
        nodes.average_pixels()


# -- defaults ------------------------------------------------------------------------------------


def test_defaults_are_listed_with_those_of_included_files(tmp_path):
    deep = '<scene version="3.0.0"><default name="c" value="3"/></scene>'
    near = (
        '<scene version="3.0.0"><include filename="deep.xml"/><default name="b" value="2"/></scene>'
    )
    top = (
        '<scene version="3.0.0"><default name="a" value="1"/><include filename="near.xml"/></scene>'
    )
    for name, text in {"deep": deep, "near": near, "top": top}.items():
        (tmp_path / f"{name}.xml").write_text(text)
    assert read_document(tmp_path / "top.xml").defaults == {"a": "1", "b": "2", "c": "3"}


def test_default_of_an_included_file_can_be_set(room, tmp_path):
    default = '<default name="radius" value="0.06"/>'
    included = f'<scene version="3.0.0">{default}{room.blocker(radius="$radius")}</scene>'
    (tmp_path / "ball.xml").write_text(included)
    path = room.write('<include filename="ball.xml"/>')
    scene = SceneNodes(path, {"radius": "0.11"}).instantiate()
    ball = next(shape for shape in scene.shapes() if shape.id() == "ball")
    np.testing.assert_allclose(np.ravel(ball.bbox().max - ball.bbox().min), 0.22, atol=1e-6)


def test_files_that_include_each_other_are_refused(room, tmp_path):
    for name, other in ("ab", "ba"):
        roundabout = f"../{tmp_path.name}/{other}.xml"
        text = f'<scene version="3.0.0"><include filename="{roundabout}"/></scene>'
        (tmp_path / f"{name}.xml").write_text(text)
    assert "'a.xml' includes itself" in refusal(room.write('<include filename="a.xml"/>'))
    assert "'room2.xml' includes itself" in refusal(room.write('<include filename="room2.xml"/>'))


def test_missing_included_file_is_refused(room):
    assert '"none.xml" not found' in refusal(room.write('<include filename="none.xml"/>'))


# -- reading -------------------------------------------------------------------------------------


def test_shapes_are_named_in_the_order_of_the_file(room):
    nodes = SceneNodes(room.write(room.blocker()))
    assert [props.id() for props in nodes.of_type("Shape")] == ["wall", "monitor", "ball"]


@pytest.mark.parametrize(
    ("emitter", "profile"),
    [
        ('<emitter type="lcd"><rgb name="radiance" value="1"/></emitter>', EmissionProfile(0, 0)),
        ('<emitter type="directionalarea"><rgb name="radiance" value="1"/></emitter>', None),
        ('<emitter type="area"><rgb name="radiance" value="1"/></emitter>', EmissionProfile(0, 0)),
    ],
)
def test_profile_is_known_of_area_and_lcd_emitters_alone(room, emitter, profile):
    nodes = SceneNodes(room.write(monitor=room.monitor(emitter)))
    assert nodes.emission_profile() == profile


def test_profile_has_the_files_exponents(room):
    nodes = SceneNodes(room.write(monitor=room.monitor(room.lcd(20, 0.5))))
    assert nodes.emission_profile() == EmissionProfile(20, 0.5)


def test_wall_material_is_named(room):
    assert SceneNodes(room.write()).wall_material() == "diffuse"
    assert SceneNodes(room.write(wall=room.wall(""))).wall_material() == "default"


# -- editing -------------------------------------------------------------------------------------


def seen_on_monitor(scene, uv_from_viewer):
    """Radiance towards the wall at places of the screen: (across, down) in [0, 1] for a viewer."""
    import mitsuba as mi

    radiance = []
    for across, down in uv_from_viewer:
        # The screen spans x = 0.4 (a viewer's left) to 0, z = 0.45 to 0.15, at y = 0.
        ray = mi.Ray3f([0.4 - 0.4 * across, 0.5, 0.45 - 0.3 * down], [0, -1, 0])
        si = scene.ray_intersect(ray)
        radiance.append(np.ravel(si.shape.emitter().eval(si)))
    return np.array(radiance)


def middles(rows, columns):
    return [((c + 0.5) / columns, (r + 0.5) / rows) for r in range(rows) for c in range(columns)]


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("width", [0.2, -0.2])
def test_image_appears_upright_and_unmirrored_on_any_rectangle(room, flip, width):
    image = np.random.default_rng(0).random((3, 4, 3)).astype(np.float32)
    monitor = room.monitor(scale=(width, 0.15), turn=0 if flip else 180, flip=flip)
    nodes = SceneNodes(room.write(monitor=monitor))
    nodes.show(image, mirrored=False)
    seen = seen_on_monitor(nodes.instantiate(), middles(3, 4))
    np.testing.assert_allclose(seen, image.reshape(-1, 3), rtol=1e-5)


def test_mirrored_image_is_turned_left_to_right(room):
    image = np.random.default_rng(0).random((2, 3, 3)).astype(np.float32)
    nodes = SceneNodes(room.write())
    nodes.show(image, mirrored=True)
    seen = seen_on_monitor(nodes.instantiate(), middles(2, 3))
    np.testing.assert_allclose(seen, image[:, ::-1].reshape(-1, 3), rtol=1e-5)


@pytest.mark.parametrize("hidden", [(1, 1), (1, 3), (3, 1), (2, 3)])
def test_texture_is_the_image_from_below_and_never_smaller_than_two_by_two(room, hidden):
    image = np.random.default_rng(0).random((*hidden, 3))
    texture = monitor_texture(image, mirrored=False)
    assert texture.shape[:2] == tuple(max(size, 2) for size in hidden)
    assert texture.flags.c_contiguous and min(texture.strides) > 0
    nodes = SceneNodes(room.write())
    nodes.show(image, mirrored=False)
    seen = seen_on_monitor(nodes.instantiate(), middles(*hidden))
    np.testing.assert_allclose(seen, image.reshape(-1, 3), rtol=1e-5)


def test_values_beyond_one_are_shown_as_they_are(room):
    nodes = SceneNodes(room.write())
    nodes.show(np.array([[[0.0, 3.5, 700.0]]]))
    np.testing.assert_allclose(
        seen_on_monitor(nodes.instantiate(), middles(1, 1)), [[0, 3.5, 700]], rtol=1e-5
    )


def test_white_replaces_the_files_radiance(room):
    emitter = '<emitter type="area"><rgb name="radiance" value="0.2, 5, 7"/></emitter>'
    nodes = SceneNodes(room.write(monitor=room.monitor(emitter)))
    nodes.show(None)
    np.testing.assert_allclose(seen_on_monitor(nodes.instantiate(), [(0.3, 0.3)]), 1, rtol=1e-5)


def test_plain_emitter_has_no_falloff(room):
    import mitsuba as mi

    nodes = SceneNodes(room.write())
    nodes.show(None)
    nodes.drop_angular_profile()
    scene = nodes.instantiate()
    si = scene.ray_intersect(mi.Ray3f([0.2, 1, 1.3], [0, -0.7071068, -0.7071068]))
    np.testing.assert_allclose(np.ravel(si.shape.emitter().eval(si)), 1, rtol=1e-5)


def test_darkened_room_keeps_the_monitor_alone(room):
    twin = room.monitor(room.area, y=-0.5).replace('id="monitor"', 'id="twin"')
    bulb = (
        '<shape type="sphere" id="bulb"><point name="center" value="1, 0, 2"/>'
        f'{room.lcd()}<ref id="paint"/></shape>'
    )
    paint = room.diffuse.replace("<bsdf", '<bsdf id="paint"')
    sky = '<emitter type="constant"><rgb name="radiance" value="1"/></emitter>'
    path = room.write(paint, POINT, twin, bulb, sky, monitor=room.monitor(room.area))
    assert len(SceneNodes(path).instantiate().emitters()) == 5
    for image in (None, np.ones((2, 2, 3))):
        nodes = SceneNodes(path)
        nodes.show(image)
        nodes.darken()
        scene = nodes.instantiate()
        assert len(scene.emitters()) == 1
        lit = [shape.id() for shape in scene.shapes() if shape.is_emitter()]
        assert lit == ["monitor"]


def test_pixels_are_averaged_whatever_film_filter_and_sampler_the_file_asks_for(room):
    odd = (
        '<rfilter type="gaussian"><float name="stddev" value="0.8"/></rfilter>'
        '<string name="pixel_format" value="luminance"/>'
        '<string name="component_format" value="float16"/>'
    )
    sampler = '<sampler type="independent"><integer name="sample_count" value="7"/></sampler>'
    asked = room.camera(inside_film=odd).replace("</sensor>", f"{sampler}</sensor>")
    pictures = []
    for camera in (room.camera(), asked):
        pictures.append(
            render(SceneNodes(room.write(monitor=room.monitor(room.area), camera=camera)))
        )
    assert pictures[0].shape == (5, 6, 3)
    assert pictures[0].dtype == np.float32
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_pixels_have_box_filters_and_stratified_samples(room):
    nodes = SceneNodes(room.write())
    nodes.average_pixels()
    camera = camera_of(nodes.instantiate())
    assert "Box" in str(camera.film().rfilter())
    assert "MultijitterSampler" in str(camera.sampler())


def render(nodes, film_size=None):
    import mitsuba as mi

    nodes.average_pixels(film_size)
    scene = nodes.instantiate()
    direct = mi.load_dict({"type": "direct"})
    return np.array(mi.render(scene, sensor=camera_of(scene), integrator=direct, spp=4, seed=1))


def test_film_can_be_resized(room):
    assert render(SceneNodes(room.write()), (3, 2)).shape == (3, 2, 3)


def test_files_are_found_beside_the_scene_whatever_the_working_folder(room, tmp_path, monkeypatch):
    (tmp_path / "meshes").mkdir()
    ply = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0.4 0.5 0.2\n0.5 0.5 0.2\n0.4 0.5 0.3\n3 0 1 2\n"
    )
    (tmp_path / "meshes" / "sofa.ply").write_text(ply)
    path = room.write(mesh("meshes/sofa.ply"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    (sofa,) = load_scenario(path, (1, 1)).occluders
    assert sofa.name == "sofa"
    np.testing.assert_allclose(sofa.vertices[1], [0.5, 0.5, 0.2], atol=1e-7)
    monkeypatch.chdir(tmp_path)
    assert len(load_scenario(path.relative_to(tmp_path), (1, 1)).occluders) == 1


def test_files_are_found_in_the_folders_that_the_scene_names(room, tmp_path):
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "sofa.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0.4 0.5 0.2\n0.5 0.5 0.2\n0.4 0.5 0.3\n3 0 1 2\n"
    )
    path = room.write('<path value="m"/>' + mesh("sofa.ply"))
    assert [shape.name for shape in load_scenario(path, (1, 1)).occluders] == ["sofa"]


def triangle(path, x):
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{x} 0.5 0.2\n0.5 0.5 0.2\n0.4 0.5 0.3\n3 0 1 2\n"
    )


def test_a_folder_that_the_scene_names_comes_before_its_own_as_in_mitsuba(room, tmp_path):
    import mitsuba as mi

    triangle(tmp_path / "sofa.ply", 0.41)
    triangle(tmp_path / "m" / "sofa.ply", 0.42)
    path = room.write(mesh("sofa.ply") + '<path value="m"/>')
    (sofa,) = load_scenario(path, (1, 1)).occluders
    assert sofa.vertices[0, 0] == pytest.approx(0.42)
    theirs = next(shape for shape in mi.load_file(str(path)).shapes() if shape.id() == "sofa")
    assert theirs.bbox().min.x == pytest.approx(0.4)


def test_folders_that_a_scene_names_are_its_own_alone(room, tmp_path):
    import mitsuba as mi

    before = [str(folder) for folder in mi.file_resolver()]
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "ball.xml").write_text(f'<scene version="3.0.0">{room.blocker()}</scene>')
    include = '<include filename="ball.xml"/>'
    *_, last = SceneNodes(room.write('<path value="m"/>', include)).of_type("Shape")
    assert last.id() == "ball"
    assert [str(folder) for folder in mi.file_resolver()] == before
    assert '"ball.xml" not found' in refusal(room.write(include))


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
    room, tmp_path, monkeypatch, tag
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


def test_spectrum_is_found_beside_the_scene(room, tmp_path, monkeypatch):
    (tmp_path / "paint.spd").write_text("300 0.25\n900 0.25\n")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    paint = '<bsdf type="diffuse"><spectrum name="reflectance" filename="paint.spd"/></bsdf>'
    scenario = load_scenario(room.write(wall=room.wall(paint)), (1, 1))
    np.testing.assert_allclose(scenario.wall_reflectance, 0.25, rtol=2e-3)


# -- the id contract -----------------------------------------------------------------------------


def test_an_alias_serves_as_the_wall(room):
    wall = room.wall().replace('id="wall"', 'id="board"') + '<alias id="board" as="wall"/>'
    aliased, plain = room.load(wall=wall), room.load()
    np.testing.assert_array_equal(aliased.wall_points, plain.wall_points)
    assert aliased.occluders == ()
    camera = room.camera().replace('id="camera"', 'id="eye"') + '<alias id="eye" as="camera"/>'
    np.testing.assert_array_equal(room.load(camera=camera).wall_points, plain.wall_points)


def test_one_shape_by_two_names_is_refused(room):
    path = room.write('<alias id="wall" as="monitor"/>', monitor="")
    assert "two of the ids wall, monitor, camera name one node" in refusal(path)


@pytest.mark.parametrize("part", ["wall", "monitor"])
@pytest.mark.parametrize("holder", ["shapegroup", "merge"])
def test_shape_within_another_is_refused_by_name(room, part, holder):
    inner = getattr(room, part)()
    group = f'<shape type="{holder}" id="group">{inner}</shape>'
    shown = '<shape type="instance" id="shown"><ref id="group"/></shape>'
    path = room.write(**{part: group + (shown if holder == "shapegroup" else "")})
    assert f"shape '{part}' lies within another shape; put it into" in refusal(path)


def test_instance_as_the_wall_is_refused_by_its_type(room):
    group = f'<shape type="shapegroup" id="group">{room.wall()}</shape>'.replace("wall", "board")
    wall = group + '<shape type="instance" id="wall"><ref id="group"/></shape>'
    assert "shape 'wall' is of type 'instance', which has no surface" in refusal(
        room.write(wall=wall)
    )


@pytest.mark.parametrize("size", [(-3, 6), (5, 0)])
def test_film_without_pixels_is_refused(room, size):
    nodes = SceneNodes(room.write(camera=room.camera(size)))
    name, wrong = ("height", -3) if size[0] < 1 else ("width", 0)
    with pytest.raises(SceneError, match=f"has {name} {wrong}; give it a whole number from 1 on"):
        nodes.average_pixels()


@pytest.mark.parametrize("crop", ["crop_width", "crop_height"])
def test_crop_without_pixels_is_refused(room, crop):
    camera = room.camera(inside_film=f'<integer name="{crop}" value="-1"/>')
    with pytest.raises(SceneError, match=f"has {crop} -1; give it a whole number from 1 on"):
        SceneNodes(room.write(camera=camera)).average_pixels()


def test_mesh_format_that_is_not_read_is_refused_with_what_to_do(room, tmp_path):
    (tmp_path / "sofa.gltf").write_bytes(b"{}")
    message = refusal(room.write(mesh("sofa.gltf").replace("ply", "gltf")))
    assert "gltf 'sofa': GLTF files are not read; save 'sofa.gltf' as STL, GLB, OFF" in message


def test_name_that_is_no_text_is_left_to_mitsuba(room):
    odd = '<shape type="ply" id="sofa"><float name="filename" value="1"/></shape>'
    assert "filename" in refusal(room.write(odd))
