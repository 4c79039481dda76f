import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.cli import output
from periscopy_sim.cli.output import fixable, progress, write_json
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.validation import InputError


def test_fixable_names_what_an_input_error_is_about():
    with pytest.raises(PeriscopyError, match=r"^scene: too small$"), fixable("scene"):
        raise InputError("too small")


def test_json_holds_arrays_as_lists_and_paths_as_text(tmp_path):
    path = tmp_path / "record.json"
    array = np.array([[1.5, 2.0]], np.float32)
    write_json(path, {"λ": [array], "count": np.int64(3), "shape": (4, 5), "path": Path("a/b.npy")})
    expected = {"λ": [[[1.5, 2.0]]], "count": 3, "shape": [4, 5], "path": "a/b.npy"}
    assert json.loads(path.read_text()) == expected and path.read_text().endswith("}\n")


@pytest.mark.parametrize("value", [float("nan"), np.float64("inf"), np.array([1.0, np.nan])])
def test_json_refuses_what_is_no_number(value, tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "record.json", {"value": value})
    assert not (tmp_path / "record.json").exists()


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def test_progress_is_a_line_at_the_start_and_each_half_minute_without_a_terminal(capfd):
    now = [0]
    with progress("rendering", clock=lambda: now[0]) as report, progress("within") as inner:
        inner(1.0)
        for now[0], fraction in ((1, 0.2), (10, 0.25), (32, 0.3), (33, 0.4), (72, 0.5)):
            report(fraction)
    lines = ["rendering", "rendering: 30 %, 0:03:38 left", "rendering: 50 %, 0:01:59 left"]
    assert capfd.readouterr() == ("", "".join(f"periscopy: {line}\n" for line in lines))


def test_interrupt_that_a_library_ignored_is_raised_again(monkeypatch):
    monkeypatch.setattr(output, "_INTERRUPTS", [])
    with pytest.raises(KeyboardInterrupt), progress("rendering") as report:
        with suppress(KeyboardInterrupt):
            output.interrupt(2, None)
        report(0.5)


def test_progress_shows_label_and_fraction_on_a_terminal(monkeypatch, capfd):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with progress("fitting [/x].py") as report:  # a name is no style
        report(0.42)
    out, err = capfd.readouterr()
    assert out == "" and "fitting [/x].py" in err and "42%" in err


@pytest.mark.parametrize("show", [output.say, output.warn])
def test_no_name_controls_the_terminal(show, capfd):
    show("shape 'a\x1b[2J\x9b[red]\u202e'")
    (line,) = "".join(capfd.readouterr()).splitlines()
    assert line.isprintable() and line.endswith(r"shape 'a\x1b[2J\x9b[red]\u202e'")
