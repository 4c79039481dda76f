"""Running the command line in this process, in a folder of its own."""

import shutil
import sys
from dataclasses import dataclass

import pytest

from periscopy_sim import cli
from periscopy_sim.analytic import point_light
from periscopy_sim.rendering.variant import examine_variants
from periscopy_sim.shipped import find_scene

TERMINAL = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")  # make rich draw anywhere


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture(scope="session")
def jit():
    """Skip where only the scalar variant works: rendering would crawl, and warn that it does."""
    reports = [report for report in examine_variants() if not report.name.startswith("scalar")]
    if not any(report.works for report in reports):
        pytest.skip("; ".join(f"{report.name}: {report.reason}" for report in reports))


@pytest.fixture
def periscopy(monkeypatch, capfd, caplog, tmp_path):
    """Run `periscopy` with arguments; the current folder is `tmp_path`.

    No library may log anything, which Python would print.
    """
    monkeypatch.chdir(tmp_path)
    for name in ("PERISCOPY_VARIANT", *TERMINAL):
        monkeypatch.delenv(name, raising=False)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["periscopy", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert caplog.records == []
        return Outcome(end.value.code, *capfd.readouterr())

    return run


@pytest.fixture
def succeeds(periscopy):
    """Run a command that must end with exit code 0 in silence but for what it prints; return it."""

    def run(*arguments):
        outcome = periscopy(*arguments)
        assert (outcome.code, outcome.err) == (0, "")
        return outcome.out

    return run


@pytest.fixture
def refused(periscopy, tmp_path):
    """Run a command that must fail by one line and leave every file as it was; return the line."""

    def contents():
        return {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}

    def run(*arguments, out=""):
        before = contents()
        outcome = periscopy(*arguments)
        assert (outcome.code, outcome.out) == (2, out)
        assert outcome.err.startswith("periscopy: error: ")
        assert outcome.err.endswith("\n") and outcome.err.count("\n") == 1
        assert contents() == before
        return outcome.err.removeprefix("periscopy: error: ").strip()

    return run


@pytest.fixture
def edited_scene(tmp_path):
    """Write a chair scene with parts of its XML replaced, beside its mesh; return its path."""

    def write(*replacements):
        chair = find_scene("chair")
        xml = chair.read_text()
        for old, new in replacements:
            assert old in xml
            xml = xml.replace(old, new)
        (tmp_path / "meshes").mkdir(exist_ok=True)
        shutil.copy(chair.parent / "meshes" / "chair.ply", tmp_path / "meshes")
        (tmp_path / "edited.xml").write_text(xml)
        # The whole path: Mitsuba looks for relative ones where the process started.
        return str(tmp_path / "edited.xml")

    return write


@pytest.fixture
def few_lights(monkeypatch):
    """Model ambient light by 3 x 3 x 3 lights, 2 m apart: 512 take longer than all the rest."""
    grid = point_light.paper_grid
    monkeypatch.setattr(point_light, "paper_grid", lambda: grid(2.0))
