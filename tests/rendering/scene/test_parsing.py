"""What a scene file says and which files it names, as Mitsuba has it or in words that help."""

import pytest


def mesh(filename):
    return f'<shape type="ply" id="sofa"><string name="filename" value="{filename}"/></shape>'


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
