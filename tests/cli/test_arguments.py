import json
import time
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.cli.arguments import (
    Stopwatch,
    mendable,
    parse_definitions,
    parse_size,
    progress,
    write_json,
)
from periscopy_sim.errors import PeriscopyError, SceneError


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


def test_mendable_names_what_a_value_error_is_about():
    with pytest.raises(PeriscopyError, match=r"^scene: too small$"), mendable("scene"):
        raise ValueError("too small")


def test_mendable_lets_other_errors_pass():
    given = SceneError("says all by itself")
    with pytest.raises(SceneError) as raised, mendable("scene"):
        raise given
    assert raised.value is given
    with pytest.raises(TypeError), mendable("scene"):
        raise TypeError("a defect")


def test_stopwatch_keeps_the_seconds_of_each_stage(monkeypatch):
    clock = iter([10.0, 12.5, 100.0, 100.25])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    timed = Stopwatch()
    with timed("render"):
        pass
    with timed("solve"):
        pass
    assert timed.seconds == {"render": 2.5, "solve": 0.25}


def test_json_holds_arrays_as_lists_and_paths_as_text(tmp_path):
    path = tmp_path / "record.json"
    values = {
        "array": np.array([[1.5, 2.0]], np.float32),
        "number": np.float64(0.1),
        "count": np.int64(3),
        "shape": (4, 5),
        "path": Path("a/b.npy"),
        "none": None,
        "nested": {"λ": [np.arange(2)]},
    }
    write_json(path, values)
    assert json.loads(path.read_text()) == {
        "array": [[1.5, 2.0]],
        "number": 0.1,
        "count": 3,
        "shape": [4, 5],
        "path": "a/b.npy",
        "none": None,
        "nested": {"λ": [[0, 1]]},
    }
    assert path.read_text().endswith("}\n")


@pytest.mark.parametrize("value", [float("nan"), np.float64("inf"), np.array([1.0, np.nan])])
def test_json_refuses_what_is_no_number(value, tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "record.json", {"value": value})
    assert not (tmp_path / "record.json").exists()


@pytest.fixture
def plain_environment(monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("plain_environment")
def test_progress_prints_nothing_where_no_one_watches(capfd):
    with progress("rendering") as report:
        report(0.5)
        report(1.0)
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("plain_environment")
def test_progress_shows_label_and_fraction_on_a_terminal(monkeypatch, capfd):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with progress("rendering") as report:
        report(0.42)
    out, err = capfd.readouterr()
    assert out == "" and "rendering" in err and "42%" in err
