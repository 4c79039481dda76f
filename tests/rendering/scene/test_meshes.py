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
    with pytest.raises(ValueError) as caught:
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


@pytest.mark.parametrize("form", FORMS)
def test_columns_and_elements_that_are_not_needed_are_passed_over(path, form):
    content = ply(form, np.hstack([VERTICES, np.ones((4, 2))]))
    content = content.replace(b"float z\n", b"float z\nproperty float u\nproperty float v\n")
    content = content.replace(b"end_header", b"element edge 1\nproperty int a\nend_header")
    path.write_bytes(content)
    check_mesh(path, "ply")


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
    assert "finite" in reason(path, ply(form, vertices))


@pytest.mark.parametrize("form", FORMS)
def test_number_too_large_for_single_precision_is_refused(path, form):
    content = ply(form, 1e39 * VERTICES, number="double")
    assert "finite number" in reason(path, content)


@pytest.mark.parametrize("form", FORMS)
def test_faces_of_other_than_three_corners_are_refused(path, form):
    assert "triangulate it" in reason(path, ply(form, corners=4))


@pytest.mark.parametrize("form", FORMS)
def test_file_cut_short_is_refused(path, form):
    content = ply(form)
    lines = content.splitlines(keepends=True) if form == "ascii" else []
    cuts = [content[:-k] for k in (1, 13, 40)] if not lines else [b"".join(lines[:-1])]
    for cut in cuts:
        assert "is cut short" in reason(path, cut)


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
        (b"ply\n", b"obj\n", "no PLY header"),
        (b"end_header", b"end_of_header", "no PLY header"),
        (b"vertex 4", b"vertex -4", "the line 'element vertex -4'"),
        (b"vertex 4", b"vertex 4 4", "the line 'element vertex 4 4'"),
        (b"ascii", b"morse", "the line 'format morse 1.0'"),
        (b"float x", b"blob x", "the line 'property blob x'"),
        (b"float x", b"list uchar int x", "the line 'property list uchar int x'"),
        (b"uchar int", b"float int", "list of float and int"),
        (b"uchar int", b"uchar double", "list of uchar and double"),
        (b"property list uchar int vertex_indices\n", b"", "faces without a list"),
        (b"element vertex", b"element point", "elements point, face"),
        (b"face 3", b"face 0", "has no faces"),
        (b"float y", b"float x", "occurs more than once"),
        (b"1.0 0.0 0.0", b"1.0 one 0.0", "no row of finite numbers"),
    ],
)
def test_header_of_another_form_is_refused(path, old, new, said):
    assert old in ply("ascii")
    assert said in reason(path, ply("ascii").replace(old, new, 1))


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
        ("f 1 2 5", "uses 'v' number 5, of 4"),
        ("f 1/3 2/1 3/1", "uses 'vt' number 3, of 2"),
        ("f 1//1 2//2 3//1", "uses 'vn' number 2, of 1"),
        ("f 0 1 2", "a face of '0' in line 8"),
        ("f -1 -2 -3", "a face of '-1' in line 8"),
        ("f 1 2", "a face of 2 corners in line 8"),
        ("f 1 2 x", "a face of 'x' in line 8"),
        ("f 1 2 3/1/1/1", "a face of '3/1/1/1' in line 8"),
        ("f 1 2 99999999999", "a face of '99999999999' in line 8"),
        ("v 0 0 nan", "no 3 finite numbers in line 8"),
        ("v 0 0 1e39", "no 3 finite numbers in line 8"),
        ("v 0 0", "no 3 finite numbers in line 8"),
        ("vt inf 0", "no 2 finite numbers in line 8"),
        ("# no face", "has 4 vertices and 0 faces"),
    ],
)
def test_obj_whose_numbers_mean_nothing_is_refused(path, line, said):
    assert said in reason(path, f"{OBJ}{line}\n".encode(), "obj")


def test_other_formats_are_left_to_mitsuba(path):
    path.write_bytes(b"anything")
    check_mesh(path, "serialized")
