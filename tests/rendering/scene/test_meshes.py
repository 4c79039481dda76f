import traceback

import numpy as np
import pytest

from periscopy_sim.rendering.scene.mesh_formats import check_mesh

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
@pytest.mark.parametrize("types", [{}, {"length": "int", "index": "uint", "number": "double"}])
def test_sound_mesh_passes(path, form, types):
    path.write_bytes(ply(form, **types))
    check_mesh(path, "ply")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("index", [4, 2**30])
def test_index_of_no_vertex_is_refused(path, form, index):
    faces = FACES.copy()
    faces[2, 1] = index
    assert str(index) in reason(path, ply(form, faces=faces))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_vertex_that_is_nowhere_is_refused(path, form, number):
    vertices = VERTICES.copy()
    vertices[3, 1] = number
    reason(path, ply(form, vertices))


@pytest.mark.parametrize("form", FORMS)
def test_file_cut_short_is_refused(path, form):
    content = ply(form)
    lines = content.splitlines(keepends=True)
    cuts = [b"".join(lines[:-1])] if form == "ascii" else [content[:-k] for k in (1, 13, 40)]
    for cut in cuts:
        reason(path, cut)


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1 0\nvn 0 0 1\n"


@pytest.mark.parametrize("face", ["f 1 2 3", "f 1/1 2/2 3/1", "f 1/1/1 2/2/1 3/1/1 4/2/1"])
def test_sound_obj_passes(path, face):
    path.write_text(f"# by hand\nmtllib a.mtl\n{OBJ}\n{face}\ns off\n")
    check_mesh(path, "obj")


@pytest.mark.parametrize("line", ["f 1 2 5", "f 1/3 2/1 3/1", "f 0 1 2", "v 0 0 nan\nf 1 2 5", ""])
def test_obj_whose_numbers_mean_nothing_is_refused(path, line):
    reason(path, f"{OBJ}{line}\n".encode(), "obj")


def test_other_formats_are_left_to_mitsuba(path):
    path.write_bytes(b"anything")
    check_mesh(path, "serialized")


def test_no_mesh_outlives_its_refusal(path):
    """Dr.Jit would trace it at the next virtual call, and fail at one without faces."""
    path.write_text(OBJ)
    with pytest.raises(ValueError) as caught:
        check_mesh(path, "obj")
    frames = [frame for frame, _ in traceback.walk_tb(caught.value.__traceback__)]
    held = [value for frame in frames for value in frame.f_locals.values()]
    assert not any(type(value).__module__.startswith("mitsuba") for value in held)
