"""Lines, progress, times and JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.cli import output
from periscopy_sim.cli.output import counted_progress, fixable, progress, write_json
from periscopy_sim.errors import PeriscopyError, SceneError


def test_fixable_names_what_a_value_error_is_about():
    with pytest.raises(PeriscopyError, match=r"^scene: too small$"), fixable("scene"):
        raise ValueError("too small")


def test_fixable_names_first_a_file_that_the_error_is_about():
    about = r"^off.npy: is black \(scene\)$"
    with pytest.raises(PeriscopyError, match=about), fixable("scene", ["on.npy", "off.npy"]):
        raise ValueError("off.npy: is black")


def test_fixable_lets_other_errors_pass():
    given = SceneError("says all by itself")
    with pytest.raises(SceneError) as raised, fixable("scene"):
        raise given
    assert raised.value is given
    with pytest.raises(TypeError), fixable("scene"):
        raise TypeError("a defect")


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
def test_progress_is_a_plain_line_where_there_is_no_terminal(capfd):
    with progress("rendering") as report, progress("within", lines=False):
        report(0.5)
        report(1.0)
    assert capfd.readouterr() == ("", "periscopy: rendering\n")


@pytest.mark.usefixtures("plain_environment")
def test_long_work_tells_now_and_then_how_far_it_is(monkeypatch, capfd):
    clock = iter([0.0, 1.0, 25.0, 25.0, 30.0, 50.0, 50.0])
    monkeypatch.setattr(output.time, "monotonic", lambda: next(clock))
    with progress("rendering") as report:
        for fraction in (0.1, 0.42, 0.5, 0.9):
            report(fraction)
    lines = ["rendering", "rendering: 42 %, about 35 s left", "rendering: 90 %, about 6 s left"]
    assert capfd.readouterr().err == "".join(f"periscopy: {line}\n" for line in lines)


@pytest.mark.usefixtures("plain_environment")
def test_counted_progress_tells_of_how_many(monkeypatch, capfd):
    monkeypatch.setattr(output, "BETWEEN_LINES", -1.0)
    with counted_progress("making", "samples") as report:
        report(3, 12)
    assert (
        capfd.readouterr().err
        == "periscopy: making\nperiscopy: making: 3 of 12 samples, about 0 s left\n"
    )


@pytest.mark.usefixtures("plain_environment")
def test_progress_shows_label_and_fraction_on_a_terminal(monkeypatch, capfd):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with progress("rendering") as report:
        report(0.42)
    out, err = capfd.readouterr()
    assert out == "" and "rendering" in err and "42%" in err
