"""The forms of arguments."""

import pytest

import periscopy_sim as ps
from periscopy_sim.cli.arguments import (
    parse_ambient,
    parse_definitions,
    parse_ratios,
    parse_size,
)
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC


@pytest.mark.parametrize("text", ["29x36", "29X36"])
def test_size_is_rows_by_columns(text):
    assert parse_size(text) == (29, 36)


@pytest.mark.parametrize(
    "text",
    [
        *("", "x", "29", "29x", "x36", "29x36x3", "29 x 36", "29x36 ", "29x36\n", "29,36"),
        *("-1x5", "+4x5", "4.0x5", "1e1x5", "0x1Fx2", "²x3", "٣x4", "29×36", "9" * 5000 + "x1"),
    ],
)
def test_malformed_size_is_refused_with_its_form(text):
    with pytest.raises(PeriscopyError, match="is not a size; write ROWSxCOLUMNS, such as 29x36"):
        parse_size(text)


def test_definitions_are_split_at_the_first_equals_sign():
    assert parse_definitions(["a=1", "b=x=y", "c= "]) == {"a": "1", "b": "x=y", "c": " "}
    assert parse_definitions([]) == parse_definitions(None) == {}


@pytest.mark.parametrize("text", ["", "=", "a", "a=", "=1"])
def test_malformed_definition_is_refused_with_its_form(text):
    with pytest.raises(PeriscopyError, match=f"-D '{text}' is not of the form name=value"):
        parse_definitions(["b=2", text])


def test_definition_given_twice_is_refused():
    with pytest.raises(PeriscopyError, match="-D a is given twice"):
        parse_definitions(["a=1", "b=1", "a=1"])


# -- lists ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "ratios"),
    [
        ("0.5", [0.5]),
        ("0.1,1, 10", [0.1, 1, 10]),
        ("0.1:10:log:3", [0.1, 1, 10]),
        ("0.1:10:log:9", [0.1, 0.177828, 0.316228, 0.562341, 1, 1.77828, 3.16228, 5.62341, 10]),
        ("10:1:lin:4", [10, 7, 4, 1]),
        ("2:8:log:1", [2]),
    ],
)
def test_ratios_are_read(text, ratios):
    assert parse_ratios(text) == ratios


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            ",",
            "1,,2",
            "nan",
            "inf",
            "-1",
            "0",
            "1;2",
            "0:1:log:3",
            "-1:1:lin:3",
            "1:inf:log:3",
        ),
        *(
            "1:2",
            "1:2:log",
            "1:2:log:0",
            "1:2:log:x",
            "1:2:cubic:3",
            "1:2:log:3:4",
            "1:2:log:9999999",
        ),
        *("1:1:log:2",),
    ],
)
def test_what_is_no_list_of_ratios_is_refused(text):
    with pytest.raises(ps.PeriscopyError, match="--sbr"):
        parse_ratios(text)


def test_groups_of_ambient_light_are_shipped_and_apart():
    assert list(parse_ambient("all")) == list(REALISTIC) and len(REALISTIC) == 8
    assert list(parse_ambient("adversarial")) == list(ADVERSARIAL)
    assert list(parse_ambient("adversarial,all")) == [*ADVERSARIAL, *REALISTIC]
    assert set(parse_ambient("all,snow").values()) == {None}


def test_folder_stands_for_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lights").mkdir()
    for name in ("b.exr", "a.exr", "notes.txt"):
        (tmp_path / "lights" / name).touch()
    found = parse_ambient("lights,snow,more/c.exr")
    assert {name: str(path) for name, path in found.items()} == {
        "a": "lights/a.exr", "b": "lights/b.exr", "snow": "None", "c": "more/c.exr"
    }  # fmt: skip
    assert list(found) == ["a", "b", "snow", "c"]
