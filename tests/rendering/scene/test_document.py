import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import declared_defaults

ROOM = '<scene version="3.0.0">{}</scene>'


def refusal(path):
    with pytest.raises(SceneError) as caught:
        declared_defaults(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def written(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_files_that_double_with_every_include_are_refused(tmp_path):
    for k in range(60):
        text = ROOM.format(f'<include filename="{k + 1}.xml"/>' * 2)
        written(tmp_path / f"{k}.xml", text)
    written(tmp_path / "60.xml", ROOM.format('<default name="a" value="1"/>'))
    assert "includes more than 100 files" in refusal(tmp_path / "0.xml")
    assert declared_defaults(tmp_path / "56.xml") == {"a": "1"}


def test_nodes_nested_beyond_any_stack_are_refused(tmp_path):
    def nested(depth):
        return ROOM.format('<bsdf type="twosided">' * depth + "</bsdf>" * depth)

    assert "nests more than 100 nodes" in refusal(written(tmp_path / "a.xml", nested(200_000)))
    assert "nests more than 100 nodes" in refusal(written(tmp_path / "a.xml", nested(100)))
    assert declared_defaults(written(tmp_path / "a.xml", nested(99))) == {}


def test_entities_that_multiply_are_refused(tmp_path):
    entities = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
    doctype = f'<!DOCTYPE scene [<!ENTITY l0 "ha">{entities}]>'
    text = doctype + ROOM.format('<default name="a" value="&l11;"/>')
    assert "not well-formed XML" in refusal(written(tmp_path / "a.xml", text))


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


@pytest.mark.parametrize("name", ["x" * 5000, "/dev/zero", ".", "", "none.xml"])
def test_include_of_no_file_is_left_to_mitsuba(tmp_path, name):
    text = ROOM.format(f'<default name="a" value="1"/><include filename="{name}"/>')
    assert declared_defaults(written(tmp_path / "a.xml", text)) == {"a": "1"}
