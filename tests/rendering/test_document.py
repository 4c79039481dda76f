import os
import random
import re

import mitsuba as mi
import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering import scene_files
from periscopy_sim.rendering.nodes import parse
from periscopy_sim.rendering.scene_files import read_document

ROOM = '<scene version="3.0.0">{}</scene>'


def refusal(path):
    with pytest.raises(SceneError) as caught:
        read_document(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def written(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        '<?xml version="1.0" encoding="morse"?>' + ROOM.format(""),
        b"\xff\xfe\x00",
        "",
        "<scene>",
        ROOM.format("\x00"),
    ],
)
def test_what_is_no_xml_is_refused(tmp_path, text):
    assert "not well-formed XML" in refusal(written(tmp_path / "a.xml", text))


@pytest.mark.parametrize("value", ["$b", r"\$a", "$"])
def test_dollar_that_stays_in_a_value_is_refused(tmp_path, value):
    path = written(tmp_path / "a.xml", ROOM.format(f'<default name="a" value="{value}"/>'))
    assert "whose '$' no parameter before it fills in" in refusal(path)
    path = written(tmp_path / "a.xml", ROOM.format('<default name="a" value="1"/>'))
    with pytest.raises(SceneError, match="whose '\\$' no parameter"):
        read_document(path, {"a": value})


def test_names_are_filled_in_longest_first_but_for_an_escaped_dollar(tmp_path):
    text = (
        '<default name="a" value="1"/><default name="ab" value="2\\1"/>'
        '<default name="c" value="$ab$a-$a"/>'
        r'<string name="filename" value="$ab$ac\$a"/>'
    )
    path = written(tmp_path / "a.xml", ROOM.format(text))
    given = {"a": "3"}
    for parameters, name in [({}, r"2\11c$a"), (given, r"2\13c$a")]:
        written(tmp_path / name, "")
        assert read_document(path, parameters).files == (path, tmp_path / name)
    # What is declared is told, whatever is given.
    assert read_document(path).defaults == {"a": "1", "ab": r"2\1", "c": r"2\11-1"}


def repeated(text, times=1):
    """A scene of one file that holds a text many times."""
    return {"a.xml": ROOM.format(text * times)}


def including(name, times, count):
    """Documents, each of which includes the next some times."""
    tag = f'<include filename="{name}{{}}.xml"/>' * times
    return {f"{'a' if k == 0 else name + str(k)}.xml": ROOM.format(tag.replace("{}", str(k + 1)))
            for k in range(count)}  # fmt: skip


@pytest.mark.parametrize(
    ("files", "told"),
    [
        (including("c", 1, 40), "50 elements within"),
        (including("e", 160, 3), "25000 elements"),
        (repeated(f"{'<bsdf>' * 20_000}{'</bsdf>' * 20_000}"), "50 elements within"),
        (repeated('<default name="a0" value="xxxxxxxxxx"/>' + "".join(
            f'<default name="a{k + 1}" value="{f"$a{k}" * 10}"/>' for k in range(9)
        )), "characters"),
        (repeated(f'<default name="a" value="{"x" * 99}"/><q w="{"$a" * 999}"/>'), "characters"),
        ({"a.xml": b"<scene>" + b" " * (1 << 24)}, "bytes"),
    ],
)  # fmt: skip
def test_texts_without_end_are_refused(tmp_path, files, told, monkeypatch):
    monkeypatch.setitem(scene_files.MOST, "elements", 25_000)
    for name, text in files.items():
        written(tmp_path / name, text)
    assert re.search(told, refusal(tmp_path / "a.xml"))


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    assert "regular file" in refusal(tmp_path / "pipe.xml")
    path = written(tmp_path / "a.xml", ROOM.format('<include filename="pipe.xml"/>'))
    with pytest.raises(SceneError, match=r"missing file 'pipe\.xml'"):
        parse(read_document(path))


FOLDERS = [".", "m", "m/n", "parts", "parts/m"]
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "{0} 0 0\n0 1 0\n0 0 1\n3 0 1 2\n"
)


@pytest.fixture
def library(tmp_path, variant):  # noqa: ARG001 (needs a variant)
    """Files of the same names in several folders, each of its own content."""

    def fill(chance):
        for number, name in enumerate(FOLDERS, 1):
            folder = tmp_path / name
            folder.mkdir(exist_ok=True)
            for k in range(2):
                (folder / f"mesh{k}.ply").write_text(PLY.format(number + k / 2))
                value = (number + k / 2) / 10
                (folder / f"paint{k}.spd").write_text(f"300 {value}\n900 {value}\n")
                (folder / f"part{k}.xml").write_text(ROOM.format(tags(chance, 1 + k)))
            for path in list(folder.glob("*.*")):
                if chance.random() < 0.4:
                    path.unlink()
        default = f'<default name="f" value="{chance.choice(FOLDERS)}"/>'
        return written(tmp_path / "scene.xml", ROOM.format(default + tags(chance, 0)))

    return fill


def tags(chance, level):
    """Random tags that name files; a part includes only parts of a higher number."""
    ids = (f"n{chance.getrandbits(60)}" for _ in range(99))
    found = []
    for _ in range(chance.randrange(1, 5)):
        folder = chance.choice(["", "", "$f/", *(f"{name}/" for name in FOLDERS)])
        k = chance.randrange(2)
        found += [
            chance.choice(
                [
                    f'<path value="{chance.choice(FOLDERS)}"/>',
                    f'<shape type="ply"><string name="filename" value="{folder}mesh{k}.ply"/>'
                    "</shape>",
                    f'<bsdf type="diffuse" id="{next(ids)}"><spectrum name="reflectance" '
                    f'filename="{folder}paint{k}.spd"/></bsdf>',
                    f'<include filename="{folder}part{chance.randrange(level, 2)}.xml"/>'
                    if level < 2
                    else "",
                ]
            )
        ]
    return "".join(found)


def outcome(path):
    """What Mitsuba makes of a scene, sorted, since it merges meshes in any order; or None."""
    try:
        scene = mi.load_file(str(path))
    except RuntimeError:
        return None
    places = [str(np.ravel(shape.bbox().max)) for shape in scene.shapes()]
    return sorted(places + str(scene).splitlines())


def test_files_are_those_that_mitsuba_opens(library, tmp_path):
    """Take each file away in turn: what Mitsuba makes of the scene changes if the file is named."""
    loaded, named = 0, 0
    for seed in range(24):
        scene = library(random.Random(seed))
        whole = outcome(scene)
        if whole is None:
            continue
        loaded += 1
        files = {file.resolve() for file in read_document(scene).files}
        for path in sorted(tmp_path.rglob("*.*")):
            if path == scene:
                continue
            named += path.resolve() in files
            hidden = path.rename(path.with_suffix(".away"))
            assert (outcome(scene) != whole) == (path.resolve() in files), (seed, path)
            hidden.rename(path)
    assert loaded > 3 and named > 8
