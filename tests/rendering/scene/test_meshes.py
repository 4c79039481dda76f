import re
import traceback

import numpy as np
import pytest

from periscopy_sim.rendering.scene.meshes import check_mesh

VERTICES = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float64)
FACES = np.array([(0, 1, 2), (0, 1, 3), (1, 2, 3)])
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = """ply
format {form} 1.0
comment made by hand
element vertex {vertices}
property {number} x
property {number} y
property {number} z
element face {faces}
property list {length} {index} vertex_indices
end_header
"""


def ply(
    form, vertices=VERTICES, faces=FACES, *, corners=3, length="uchar", index="int", number="float"
):
    sizes = {"uchar": "u1", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"}
    head = HEADER.format(
        form=form,
        vertices=len(vertices),
        faces=len(faces),
        length=length,
        index=index,
        number=number,
    ).encode()
    if form == "ascii":
        rows = [" ".join(map(repr, map(float, vertex))) for vertex in vertices]
        rows += [" ".join(map(str, (corners, *face))) for face in faces]
        return head + "\n".join([*rows, ""]).encode()
    order = ORDERS[form]
    rows = np.zeros(
        len(faces), [("n", order + sizes[length]), ("face", order + sizes[index], (3,))]
    )
    rows["n"], rows["face"] = corners, faces
    return head + np.asarray(vertices).astype(order + sizes[number]).tobytes() + rows.tobytes()


def reason(path, content, plugin="ply"):
    path.write_bytes(content)
    with pytest.raises((ValueError, RuntimeError)) as caught:
        check_mesh(path, plugin)
    return str(caught.value)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "mesh"


FORMS = ["ascii", *ORDERS]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "types",
    [{}, {"length": "int", "index": "uint", "number": "double"}],
)
def test_sound_mesh_passes(path, form, types):
    path.write_bytes(ply(form, **types))
    check_mesh(path, "ply")
    path.write_bytes(ply(form, **types).replace(b"\n", b"\r\n", 10))
    check_mesh(path, "ply")


def with_columns(content, *names):
    columns = "".join(f"property float {name}\n" for name in names)
    return content.replace(b"float z\n", b"float z\n" + columns.encode())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("names", ["uv", ("quality",), ("nx", "ny", "nz", "u", "v")])
def test_columns_that_are_not_needed_are_passed_over(path, form, names):
    content = ply(form, np.hstack([VERTICES, np.ones((4, len(names)))]))
    path.write_bytes(with_columns(content, *names))
    check_mesh(path, "ply")


@pytest.mark.parametrize("form", FORMS)
def test_elements_that_are_not_needed_are_refused_by_mitsuba(path, form):
    content = ply(form).replace(b"end_header", b"element edge 1\nproperty int a\nend_header")
    assert "Error while loading PLY file" in reason(path, content)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("column", ["nx", "u"])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_normals_and_texture_coordinates_that_are_not_finite_are_refused(
    path, form, column, number
):
    names = ("nx", "ny", "nz", "u", "v")
    vertices = np.hstack([VERTICES, np.ones((4, 5))])
    vertices[3, 3 + names.index(column)] = number
    message = reason(path, with_columns(ply(form, vertices), *names))
    said = "has normals or texture coordinates that are no finite numbers"
    assert "could not parse" in message or message == said


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("column", [b"uchar flags", b"float quality"])
@pytest.mark.parametrize("first", [True, False])
def test_negative_index_is_found_beside_other_columns_of_a_face(path, form, column, first):
    """Mitsuba takes it for 0."""
    properties = [b"property list uchar int vertex_indices\n", b"property " + column + b"\n"]
    header = ply(form).partition(b"property list")[0]
    header += b"".join(reversed(properties) if first else properties)
    order = ORDERS.get(form, "<")
    fields = [("other", order + ("u1" if b"uchar" in column else "f4"))]
    fields.insert(1 if first else 0, ("n", order + "u1"))
    fields.insert(2 if first else 1, ("face", order + "i4", (3,)))
    for index, sound in [(2, True), (-1, False)]:
        rows = np.zeros(3, fields)
        rows["n"], rows["face"], rows["other"] = 3, FACES, 200
        rows["face"][1, 2] = index
        if form == "ascii":
            body = "\n".join(" ".join(map(str, vertex)) for vertex in VERTICES.tolist())
            for row in rows.tolist():
                body += "\n" + " ".join(str(number) for part in row for number in np.ravel(part))
            content = header + b"end_header\n" + body.encode() + b"\n"
        else:
            vertices = VERTICES.astype(order + "f4").tobytes()
            content = header + b"end_header\n" + vertices + rows.tobytes()
        if sound:
            path.write_bytes(content)
            check_mesh(path, "ply")
        else:
            assert reason(path, content) == "has a face of vertex -1, of 4 from 0 on"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("index", [4, 2**30, -1])
def test_index_of_no_vertex_is_refused(path, form, index):
    faces = FACES.copy()
    faces[2, 1] = index
    assert reason(path, ply(form, faces=faces)) == f"has a face of vertex {index}, of 4 from 0 on"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_vertex_that_is_nowhere_is_refused(path, form, number):
    vertices = VERTICES.copy()
    vertices[3, 1] = number
    message = reason(path, ply(form, vertices))
    assert "could not parse" in message or "invalid vertex position data" in message


@pytest.mark.parametrize("form", FORMS)
def test_number_too_large_for_single_precision_is_refused(path, form):
    content = ply(form, 1e39 * VERTICES, number="double")
    assert "invalid vertex position data" in reason(path, content)


@pytest.mark.parametrize("form", FORMS)
def test_faces_of_other_than_three_corners_are_refused(path, form):
    assert "is this a triangle mesh?" in reason(path, ply(form, corners=4))


@pytest.mark.parametrize("form", FORMS)
def test_file_cut_short_is_refused(path, form):
    content = ply(form)
    lines = content.splitlines(keepends=True) if form == "ascii" else []
    cuts = [content[:-k] for k in (1, 13, 40)] if not lines else [b"".join(lines[:-1])]
    for cut in cuts:
        assert re.search("is cut short|could not parse|read [0-9]+ out of", reason(path, cut))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("count", [10**9, 2**32, 10**9 + 1])
@pytest.mark.parametrize("element", [b"vertex 4", b"face 3"])
def test_counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated(
    path, form, count, element
):
    name = element.split()[0]
    content = ply(form).replace(element, name + f" {count}".encode())
    assert reason(path, content) == f"is cut short: it should hold {count} x {name.decode()}"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"ply\n", b"obj\n", 'unknown token "obj"'),
        (b"end_header", b"end_of_header", "no PLY header"),
        (b"end_header", b"comment end_header\nend_of_header", "no PLY header"),
        (b"vertex 4", b"vertex -4", "the line 'element vertex -4'"),
        (b"vertex 4", b"vertex 4 4", "the line 'element vertex 4 4'"),
        (
            b"element vertex 4",
            b"\telement  vertex 99999",
            "cut short: it should hold 99999 x vertex",
        ),
        (b"ascii", b"morse", 'invalid token after "format"'),
        (b"float x", b"blob x", 'unknown format type "blob"'),
        (b"float x", b"list uchar int x", 'could not parse "int" value'),
        (b"property list uchar int vertex_indices\n", b"", "trailing tokens"),
        (b"element vertex", b"element point", "elements point, face"),
        (b"end_header", b"element face 1\nend_header", "elements vertex, face, face"),
        (b"face 3", b"face 0", "trailing tokens"),
        (b"float y", b"float x", 'a field with the name "x" already exists'),
        (b"1.0 0.0 0.0", b"1.0 one 0.0", 'could not parse "float" value'),
        (b"1.0 0.0 0.0", b"1.0 0.00.0", "could not convert string to float"),
        (b"comment made", b"property int a\n" * 5000 + b"comment made", "no PLY header"),
    ],
)
def test_header_of_another_form_is_refused(path, old, new, said):
    assert old in ply("ascii")
    assert said in reason(path, ply("ascii").replace(old, new, 1))


@pytest.mark.parametrize("form", FORMS)
def test_indices_as_numbers_of_any_type_are_those_that_mitsuba_reads(path, form):
    content = ply(form, length="uint", index="double")
    path.write_bytes(content)
    check_mesh(path, "ply")
    faces = FACES.astype(float)
    faces[1, 1] = -2
    message = reason(path, ply(form, faces=faces, length="uint", index="double"))
    assert message == "has a face of vertex -2, of 4 from 0 on"


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1 0\nvn 0 0 1\n"


@pytest.mark.parametrize(
    "face", ["f 1 2 3", "f 1/1 2/2 3/1", "f 1//1 2//1 3//1", "f 1/1/1 2/2/1 3/1/1 4/2/1"]
)
def test_sound_obj_passes(path, face):
    path.write_text(f"# by hand\nmtllib a.mtl\n{OBJ}\n{face}\ns off\n")
    check_mesh(path, "obj")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("f 1 2 5", "invalid vertex 5"),
        ("f 1/3 2/1 3/1", "invalid texture coordinate 3"),
        ("f 1//1 2//2 3//1", "invalid normal 2"),
        ("f 0 1 2", "invalid vertex 0"),
        ("f -1 -2 -3", "invalid vertex"),
        ("f 1 2", "a face of 2 corners"),
        ("f 1 2 x", "has 2 triangles, of which Mitsuba reads 1"),
        ("f 1 2 3 \\\n4", "has 3 triangles, of which Mitsuba reads 2"),
        ("f 1 2 3/1/1/1", "could not parse line"),
        ("f 1 2 99999999999", "invalid vertex"),
        ("v 0 0 nan\nf 1 2 5", "invalid vertex position data"),
        ("v 0 0 1e39\nf 1 2 5", "invalid vertex position data"),
        ("v 0 0", "could not parse line"),
        ("vt inf 0\nf 1/3 2/1 3/1", "has texture coordinates that are no finite numbers"),
        ("vt 1 x", "could not parse line"),
        ("vn 0 nan 0\nf 1//2 2//1 3//1", "invalid vertex normal data"),
    ],
)
def test_obj_whose_numbers_mean_nothing_is_refused(path, line, said):
    assert said in reason(path, f"{OBJ}f 1 2 3\n{line}\n".encode(), "obj")


def test_obj_without_faces_is_refused(path):
    assert reason(path, OBJ.encode(), "obj") == "has no faces"


def test_other_formats_are_left_to_mitsuba(path):
    path.write_bytes(b"anything")
    check_mesh(path, "serialized")


@pytest.mark.parametrize("content", [OBJ + "f 1 2\n", OBJ])
def test_no_mesh_outlives_its_refusal(path, content):
    """Dr.Jit would trace it at the next virtual call, and fail at one without faces."""
    path.write_text(content)
    kept = []
    for _ in range(2):
        try:
            check_mesh(path, "obj")
        except ValueError as error:
            kept.append(error)
    frames = [frame for error in kept for frame, _ in traceback.walk_tb(error.__traceback__)]
    held = [value for frame in frames for value in frame.f_locals.values()]
    assert len(kept) == 2 and not any(
        type(value).__module__.startswith("mitsuba") for value in held
    )
