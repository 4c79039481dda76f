import pytest

from periscopy_sim.cli.sweep import parse_axes, parse_values
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.study import conditions_of
from periscopy_sim.numerics.validation import checked
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC


def ratios_of(text):
    return checked("sbr", parse_values(text, "sbr"), "ratio")


def test_axes_are_numbers_or_words_each_named_once():
    axes = parse_axes(["occluder_dx=-0.01:0.01:3", "hidden=9x11, 15x18", "samples=16,64"])
    assert axes == {
        "occluder_dx": [-0.01, 0.0, 0.01], "hidden": ["9x11", "15x18"], "samples": [16.0, 64.0]
    }  # fmt: skip
    for entries, offender in ((["a=1", "a=2"], "--vary a"), (["a"], "'a'"), (["a=1,1"], "a '1,1'")):
        with pytest.raises(PeriscopyError, match=offender):
            parse_axes(entries)


def test_ratios_are_read():
    for text, ratios in [
        ("0.5", [0.5]),
        ("0.1,1, 10", [0.1, 1, 10]),
        ("0.1:10:log:9", [0.1, 0.177828, 0.316228, 0.562341, 1, 1.77828, 3.16228, 5.62341, 10]),
        ("10:1:lin:4", [10, 7, 4, 1]),
        ("1:2:3", [1, 1.5, 2]),
    ]:
        assert ratios_of(text) == pytest.approx(ratios, rel=1e-12)


def test_malformed_ratios_are_refused():
    for text in [
        *("", "1,,2", "nan", "inf", "-1", "0", "0:1:log:3", "1:inf:log:3", "1:2:log:0", "1,1"),
        *("1:2:cubic:3", "1:2:log:3:4", "1:1:log:2"),
    ]:
        with pytest.raises(PeriscopyError, match="sbr"):
            ratios_of(text)


def test_groups_and_folders_of_ambient_light(tmp_path, monkeypatch):
    assert list(conditions_of(["adversarial", "all"])) == [*ADVERSARIAL, *REALISTIC]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lights").mkdir()
    for name in ("b.exr", "a.exr", "notes.txt"):
        (tmp_path / "lights" / name).touch()
    found = {
        name: str(path)
        for name, path in conditions_of(["lights", "snow", "more/c.exr", "d.xml"]).items()
    }
    assert found == {"a": "lights/a.exr", "b": "lights/b.exr", "snow": "None"} | {
        "c": "more/c.exr",
        "d": "d.xml",
    }


def test_unknown_or_doubled_ambient_light_is_refused():
    for text in ["sofa", "snow,adversarial"]:
        with pytest.raises(PeriscopyError, match=text.split(",")[-1]):
            conditions_of(text.split(","))
