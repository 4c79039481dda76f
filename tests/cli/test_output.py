import json
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from periscopy_sim.cli import output
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.validation import InputError


def test_fixable_names_what_an_input_error_is_about():
    with pytest.raises(PeriscopyError, match=r"^scene: too small$"), output.fixable("scene"):
        raise InputError("too small")


def test_json_holds_arrays_as_lists_and_paths_as_text(tmp_path):
    path = tmp_path / "record.json"
    array = np.array([[1.5, 2.0]], np.float32)
    output.write_json(
        path, {"λ": [array], "count": np.int64(3), "shape": (4, 5), "path": Path("a/b.npy")}
    )
    expected = {"λ": [[[1.5, 2.0]]], "count": 3, "shape": [4, 5], "path": "a/b.npy"}
    assert json.loads(path.read_text()) == expected and path.read_text().endswith("}\n")


def test_json_refuses_what_is_no_number(tmp_path):
    for value in [float("nan"), np.float64("inf"), np.array([1.0, np.nan])]:
        with pytest.raises(ValueError, match="JSON"):
            output.write_json(tmp_path / "record.json", {"value": value})
        assert not (tmp_path / "record.json").exists()


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch):
    for name in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def test_progress_is_a_line_at_the_start_and_each_half_minute_without_a_terminal(capfd):
    now = [0]
    with (
        output.progress("rendering", clock=lambda: now[0]) as report,
        output.progress("within") as inner,
    ):
        inner(1.0)
        for now[0], fraction in ((1, 0.2), (10, 0.25), (32, 0.3), (33, 0.4), (72, 0.5)):
            report(fraction)
    lines = ["rendering", "rendering: 30 %, 0:03:38 left", "rendering: 50 %, 0:01:59 left"]
    assert capfd.readouterr() == ("", "".join(f"periscopy: {line}\n" for line in lines))


def test_interrupt_that_a_library_ignored_is_raised_again(monkeypatch):
    monkeypatch.setattr(output, "_INTERRUPTS", [])
    with pytest.raises(KeyboardInterrupt), output.progress("rendering") as report:
        with suppress(KeyboardInterrupt):
            output.interrupt(2, None)
        report(0.5)


def test_progress_shows_label_and_fraction_on_a_terminal(monkeypatch, capfd):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with output.progress("fitting [/x].py") as report:  # a name is no style
        report(0.42)
    out, err = capfd.readouterr()
    assert out == "" and "fitting [/x].py" in err and "42%" in err


@pytest.mark.parametrize("show", [output.say, output.warn])
def test_no_name_controls_the_terminal(show, capfd):
    show("shape 'a\x1b[2J\x9b[red]\u202e'")
    (line,) = "".join(capfd.readouterr()).splitlines()
    assert line.isprintable() and line.endswith(r"shape 'a\x1b[2J\x9b[red]\u202e'")


def run_command(**options):
    """Do what a command does, in another order than its lines should have."""
    with output.outcome_of(**{"quiet": False, "as_json": False, **options}):
        output.conclude("The scene fits.", "green")
        output.written(Path("out/a.png"), Path("out/b.npy"))
        output.show_table([["PSNR", "27.10 dB"], ["[shift]", "1 patch \u202e"]], ["", "monitor"])
        with output.outcome_of(quiet=True, as_json=False) as part:
            output.say("of the part")
            output.record(psnr=[np.float64(1.5)])
        output.record(**part.numbers)
        output.warn("few samples")


PLAIN = """\
         monitor
PSNR     27.10 dB
[shift]  1 patch \\u202e
wrote out/a.png, out/b.npy
The scene fits.
"""
WARNED = "periscopy: warning: few samples\n"


def test_table_files_and_verdict_follow_each_other_in_plain_text(capfd):
    run_command()
    assert capfd.readouterr() == (PLAIN, WARNED)


@pytest.mark.parametrize("colours", [True, False])
def test_terminal_has_a_table_and_a_coloured_verdict(colours, monkeypatch, capfd):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    if not colours:
        monkeypatch.setenv("NO_COLOR", "1")
    run_command()
    out, _ = capfd.readouterr()
    assert "\u2502" in out and (out.splitlines()[-1] == "\x1b[32mThe scene fits.\x1b[0m") == colours
    assert colours or out.splitlines()[-1] == "The scene fits."


def test_quiet_keeps_a_verdict_against_the_scene(capfd):
    with output.outcome_of(quiet=True, as_json=False):
        output.conclude("The scene fits.", "green")
        output.conclude("Another does not fit.", "red")
    assert capfd.readouterr() == ("", "periscopy: warning: Another does not fit.\n")


def test_quiet_prints_warnings_alone(capfd):
    run_command(quiet=True)
    with output.outcome_of(quiet=True, as_json=False), output.progress("rendering"):
        output.say("a line")
    assert capfd.readouterr() == ("", WARNED)


def test_json_is_all_of_standard_output(capfd):
    run_command(as_json=True)
    out, err = capfd.readouterr()
    assert json.loads(out) == {
        "psnr": [1.5],
        "verdict": "The scene fits.",
        "files": ["out/a.png", "out/b.npy"],
        "warnings": ["few samples"],
    }
    assert err == WARNED


def test_warnings_of_threads_are_in_the_json(capfd):
    with output.outcome_of(quiet=True, as_json=True):
        thread = Thread(target=output.warn, args=("the stream ended",))
        thread.start()
        thread.join()
    assert json.loads(capfd.readouterr().out)["warnings"] == ["the stream ended"]


class Unhurried(list):
    """A stream that lets other threads run after each piece of text."""

    def write(self, text):
        self.append(text)
        time.sleep(0.01)

    def flush(self):
        pass


def put_row(text):
    output.show_table([[text]])


@pytest.mark.parametrize(
    ("put", "stream"), [(output.say, "stdout"), (output.warn, "stderr"), (put_row, "stdout")]
)
def test_lines_of_threads_do_not_mix(put, stream, monkeypatch):
    pieces = Unhurried()
    monkeypatch.setattr(sys, stream, pieces)
    threads = [Thread(target=put, args=(f"frame {number}",)) for number in range(4)]
    with output.outcome_of(quiet=False, as_json=False):
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(line[-7:] for line in "".join(pieces).splitlines()) == [
        f"frame {number}" for number in range(4)
    ]


def test_files_that_were_written_before_an_error_are_named(capfd):
    with pytest.raises(PeriscopyError), output.outcome_of(quiet=False, as_json=False):
        output.conclude("The scene fits.")
        output.written(Path("a.png"))
        raise PeriscopyError("no space is left")
    assert capfd.readouterr().out == "wrote a.png\n"
