import os
from pathlib import Path

import pytest

from periscopy_sim.errors import PeriscopyError, PhotographError, did_you_mean, path_fault


@pytest.mark.parametrize("held", ["a\nb", "a\r\x1b[2Jb", "a\0b", "a\u2028b", "a\ud800b"])
def test_message_is_one_line_that_can_be_printed_whatever_it_quotes(held):
    line = str(PhotographError(f"y.npz: holds '{held}'; rename it"))
    assert line.isprintable() and len(line.splitlines()) == 1
    line.encode()
    assert line.startswith("y.npz: holds 'a") and line.endswith("b'; rename it")


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("no\n  such\tthing", "no such thing"),
        ("a\x1b[2Jb\0", "a\\x1b[2Jb\\x00"),
        ("größe 2 × 3: λ", "größe 2 × 3: λ"),
    ],
)
def test_white_space_becomes_a_space_and_what_cannot_be_printed_is_spelled_out(message, line):
    assert str(PeriscopyError(message)) == line


def test_long_message_keeps_its_start_and_its_end():
    line = str(PeriscopyError(f"y.npz: holds {'x' * 100_000}; rename it"))
    assert len(line) < 1000
    assert line.startswith("y.npz: holds xxx") and line.endswith("xxx; rename it")


@pytest.mark.parametrize(
    ("name", "question"),
    [
        ("lamp_turm", "did you mean 'lamp_turn'?"),
        ("LAMP_TURN", "did you mean 'lamp_turn'?"),
        ("lamp_y", "did you mean 'lamp_z'?"),
        ("lamp_tunr", "did you mean 'lamp_turn'?"),
        ("width_veiw", "did you mean 'view_width'?"),
        ("view", "did you mean 'view_width'?"),
        ("sofa", ""),
        ("", ""),
    ],
)
def test_unknown_name_is_answered_by_what_is_most_like_it(name, question):
    assert did_you_mean(name, ["lamp_x", "lamp_z", "lamp_turn", "view_width"]) == question
    assert did_you_mean(name, []) == ""


URLS = ("s3://b/y", "gs:/b/y", "file:///y", "zip::s3://b/y", "--out=az://y", "all,http://h/y")
PATHS = ("y.npy", "C:/y", "C:\\y", "/a/b:c/y", "--out=C:/y", "occluder_dx=-0.1:0.1", "größe", "")


@pytest.mark.parametrize("name", [*URLS, *PATHS, os.fsdecode(b"a/\xe9")])
def test_url_and_name_that_is_no_utf_8_are_no_paths(name):
    fault = path_fault(name)
    assert bool(fault) == (name not in PATHS) and ("URL" in fault) == (name in URLS)
    assert path_fault(Path(name)) == fault
