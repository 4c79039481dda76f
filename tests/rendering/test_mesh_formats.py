import json
import struct
import traceback

import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import analytic_transport, has_areas
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import check_mesh, read_mesh, write_ply
from periscopy_sim.rendering.shadow_rays import render_transport

VERTICES = np.array([(0.4, 0.5, 0.2), (0.5, 0.5, 0.2), (0.4, 0.6, 0.3), (0.45, 0.5, 0.4)], "f4")
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
CORNERS = VERTICES[FACES].astype(float)
FORMS = ["stl", "stl in text", "glb"]


def stl(corners=VERTICES[FACES], announced=None):
    head = b"made by hand".ljust(80) + struct.pack("<I", announced or len(corners))
    return head + b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(c), 0) for c in corners)


def stl_in_text(corners=VERTICES[FACES]):
    lines = ["solid tent"]
    for corner in corners:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += [f"      vertex {x!r} {y!r} {z!r}" for x, y, z in corner.tolist()]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid tent", ""]).encode()


def glb(vertices=VERTICES, faces=FACES, nodes=({"mesh": 0},), uv=None):
    """One mesh, shown by each of the nodes; indices of 32 bits."""
    arrays = [np.asarray(vertices, "<f4"), np.asarray(faces, "<u4").ravel()]
    attributes = {"POSITION": 0}
    if uv is not None:
        arrays.append(np.asarray(uv, "<f4"))
        attributes["TEXCOORD_0"] = 2  # which trimesh keeps beside a material
    starts = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    kinds = [(5126, "VEC3"), (5125, "SCALAR"), (5126, "VEC2")]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": list(nodes),
        "materials": [{}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "accessors": [
            {"bufferView": k, "componentType": kinds[k][0], "type": kinds[k][1], "count": len(a)}
            for k, a in enumerate(arrays)
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": array.nbytes}
            for start, array in zip(starts[:-1], arrays, strict=True)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(array.tobytes() for array in arrays)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


CONTENTS = {"stl": stl(), "stl in text": stl_in_text(), "glb": glb()}


@pytest.fixture
def mesh_file(tmp_path):
    def write(form, content):
        path = tmp_path / f"tent.{form.split()[0]}"
        path.write_bytes(content)
        return path

    return write


def refusal(path):
    with pytest.raises(ValueError) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("form", FORMS)
def test_triangles_are_those_of_the_file(mesh_file, form):
    mesh = read_mesh(mesh_file(form, CONTENTS[form]))
    np.testing.assert_allclose(mesh.vertices[mesh.faces], CORNERS, rtol=1e-6)


def test_obj_and_ply_are_read_as_well(mesh_file, tmp_path):
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (FACES + 1).tolist())
    first = read_mesh(mesh_file("obj", text.encode()))
    write_ply(tmp_path / "again.ply", first)
    for mesh in (first, read_mesh(tmp_path / "again.ply")):
        np.testing.assert_allclose(mesh.vertices[mesh.faces], CORNERS, rtol=1e-6)


def test_parts_of_a_glb_file_stand_where_its_nodes_say(mesh_file):
    """A quarter turn about y takes x to -z; a mirrored node keeps its outside outside."""
    turned = {"mesh": 0, "rotation": [0, 0.5**0.5, 0, 0.5**0.5], "translation": [1, 2, 3]}
    mirrored = {"mesh": 0, "scale": [-1, 1, 1]}
    mesh = read_mesh(mesh_file("glb", glb(nodes=({"mesh": 0}, turned, mirrored))))
    corners = mesh.vertices[mesh.faces].reshape(3, 4, 3, 3)
    corners = corners[np.argsort(corners.mean(axis=(1, 2))[:, 0])][[1, 2, 0]]
    x, y, z = np.moveaxis(CORNERS, 2, 0)
    np.testing.assert_allclose(corners[0], CORNERS, rtol=1e-6)
    np.testing.assert_allclose(corners[1], np.stack([1 + z, 2 + y, 3 - x], axis=2), rtol=1e-5)

    def volumes(corners):
        return np.linalg.det(corners).sum() / 6

    about = corners - corners.mean(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose([volumes(part) for part in about], volumes(about[0]), rtol=1e-4)
    assert abs(volumes(about[0])) > 1e-4


def test_texture_coordinates_of_a_glb_file_run_upwards(mesh_file):
    """Its own v runs down."""
    uv = np.array([(0, 0), (1, 0), (1, 1), (0.25, 0.75)])
    mesh = read_mesh(mesh_file("glb", glb(uv=uv)))
    np.testing.assert_allclose(mesh.texture_coordinates, [(0, 1), (1, 1), (1, 0), (0.25, 0.25)])
    assert read_mesh(mesh_file("glb", glb())).texture_coordinates is None


@pytest.mark.parametrize("form", FORMS)
def test_file_cut_short_anywhere_is_refused(mesh_file, form):
    content = CONTENTS[form]
    # Nobody misses a text's last line end, or the end of the name in its last line.
    for length in range(9 if form == "stl in text" else 1, len(content), 37):
        refusal(mesh_file(form, content[:-length]))


FAR = VERTICES.copy()
FAR[3, 1] = np.nan
WRONG = FACES.copy()
WRONG[2, 1] = 1 << 20
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def edited(change):
    """The GLB file with a changed document."""
    content = glb()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + content[20 + length :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def primitive(document):
    return document["meshes"][0]["primitives"][0]


@pytest.mark.parametrize(
    ("form", "content", "offender"),
    [
        ("stl", stl(FAR[FACES]), "no finite numbers"),
        ("stl in text", stl_in_text(FAR[FACES]), "no finite numbers"),
        ("glb", glb(FAR), "no finite numbers"),
        ("glb", glb(faces=WRONG), "vertex"),
        ("stl", stl([]), "no faces"),
        ("glb", glb(faces=np.zeros((0, 3))), "no faces"),
        ("obj", SQUARE.encode(), "no faces"),
        ("stl", stl(announced=10**9), ""),
        ("stl", stl_in_text().replace(b"vertex", b"vortex", 1), ""),
        ("glb", stl(), ""),
        ("glb", glb().replace(b'"count": 4', b'"count": 5'), ""),
        ("step", b"ISO-10303-21;", "GLB"),
        ("off", b"OFF", "no known format"),
        ("glb", edited(lambda d: primitive(d).update(mode=6)), "mode: 6"),
        ("glb", edited(lambda d: primitive(d).update(targets=[{}])), "targets"),
        ("glb", edited(lambda d: d["accessors"][0].update(normalized=True)), "normalized"),
        (
            "glb",
            edited(lambda d: d.update(extensionsUsed=["EXT_mesh_gpu_instancing"])),
            "EXT_mesh_gpu_instancing",
        ),
        ("glb", edited(lambda d: d.update(skins=[{"joints": [0]}])), "skins"),
        ("obj", f"{SQUARE}v 0.5 0.1 0\nf 2 5 3 4 1\n".encode(), "notch"),
        ("obj", f"{SQUARE}f 1 3 2 4\n".encode(), "crosses itself"),
        ("obj", f"{SQUARE}f 1 2 \\\n3\nf 1 3 4\n".encode(), "'3'"),
        ("obj", f"{SQUARE}f 1 2 3\ncall more.obj\n".encode(), "call"),
    ],
)
def test_what_would_be_read_wrong_is_refused(mesh_file, form, content, offender):
    assert offender in refusal(mesh_file(form, content))


@pytest.mark.parametrize(("polygon", "expected"), [("1 2 3 4", 1), ("6 7 3 4 1 5", 0.75)])
def test_polygons_that_a_fan_fills_are_its_triangles(mesh_file, polygon, expected):
    """The second has its notch at the first corner."""
    corners = f"{SQUARE}v 0.5 0 0\nv 0.5 0.5 0\nv 1 0.5 0\n"
    mesh = read_mesh(mesh_file("obj", f"{corners}f {polygon}\n".encode()))
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(expected)


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize("content", [f"{OBJ}f 1 2 5\n", OBJ, "f 0 1 2\n"])
def test_no_mesh_of_mitsubas_outlives_its_refusal(tmp_path, content):
    """Dr.Jit would trace it at the next virtual call, and fail at one without faces."""
    (tmp_path / "tent.obj").write_text(content)
    with pytest.raises((ValueError, RuntimeError)) as caught:
        check_mesh(tmp_path / "tent.obj", "obj")
    frames = [frame for frame, _ in traceback.walk_tb(caught.value.__traceback__)]
    held = [value for frame in frames for value in frame.f_locals.values()]
    assert not any(type(value).__module__.startswith("mitsuba") for value in held)


SHAPE = '<shape type="{}" id="tent"><string name="filename" value="{}"/></shape>'


@pytest.mark.parametrize("form", FORMS)
def test_scene_with_any_format_is_the_scene_with_its_triangles(room, mesh_file, tmp_path, form):
    """The type may name the format, or be ply or obj."""
    path = mesh_file(form, CONTENTS[form])
    write_ply(tmp_path / "same.ply", read_mesh(path))
    expected = room.load(SHAPE.format("ply", "same.ply"))
    assert render_transport(expected, samples=4).min() == 0  # it throws a shadow
    for kind in (form.split()[0], "ply", "obj"):
        scenario = room.load(SHAPE.format(kind, path.name))
        (tent,) = scenario.scene.occluders
        np.testing.assert_allclose(tent.vertices[tent.faces], CORNERS, rtol=1e-6)
        np.testing.assert_array_equal(
            render_transport(scenario, samples=4), render_transport(expected, samples=4)
        )


PLY = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
PLY += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n{}end_header\n"
PLY += "".join(f"{x} {y} {z}\n" for x, y, z in VERTICES.tolist())


def test_a_warning_of_mitsubas_appears_once(room, tmp_path, capfd):
    edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    (tmp_path / "tent.ply").write_text(PLY.format(edges) + "3 0 1 2\n0 1\n")
    render_transport(room.load(SHAPE.format("ply", "tent.ply")), samples=4)
    assert "".join(capfd.readouterr()).count("edge") == 1


def both(scenario):
    """The matrix, rendered, once the closed form, where there is one, has confirmed it."""
    rendered = render_transport(scenario, samples=1024, strata="midpoint")
    assert np.isfinite(rendered).all() and (rendered >= 0).all()
    if has_areas(scenario):
        # Of 1024 samples a shadow's edge crosses some 32, each half wrong.
        error = np.linalg.norm(rendered - analytic_transport(scenario))
        assert error < 0.03 * np.linalg.norm(rendered)
    return rendered


def test_monitor_within_a_box_lights_nothing(room):
    closed = room.load(room.cube((0, 0, 0), (1, 0.1, 1)))
    with pytest.raises(SceneError, match="no light of 'monitor' reaches the wall"):
        render_transport(closed)


@pytest.mark.parametrize("turn", [89.9999, 90.0001])
def test_monitor_turned_edge_on_lights_the_side_that_it_faces(room, turn):
    A = both(room.load(monitor=room.monitor(turn=turn)))
    assert (A > 0).all()
    with pytest.raises(SceneError, match="faces away from the wall"):
        room.load(monitor=room.monitor(turn=turn + 180))


@pytest.mark.parametrize(
    ("film", "hidden"), [((1, 1), (1, 1)), ((1, 9), (3, 3)), ((5, 6), (30, 1))]
)
def test_every_size_down_to_one_pixel_and_one_patch_is_rendered(room, film, hidden):
    # Of odd size: no ray of the few meets an edge, where rounding would decide.
    block = room.cube((0.455, 0.454, 0.276), (0.048, 0.043, 0.073))
    A = both(room.load(block, camera=room.camera(film), hidden=hidden))
    assert A.shape == (film[0] * film[1], hidden[0] * hidden[1])
