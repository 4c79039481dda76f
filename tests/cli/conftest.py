"""Running the command line in this process, in a folder of its own, and small inputs for it."""

import csv
import json
import re
import sys
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import typer

import periscopy_sim as ps
from periscopy_sim import cli
from periscopy_sim.analytic import point_light
from periscopy_sim.rendering.variant import examine_variants
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.formats.exr import write_exr

TERMINAL = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")  # make rich draw anywhere


parser_of = cache(typer.main.get_command)
"""Typer makes the parser of all commands anew at every call, which takes as long as many a test."""

STAGE = re.compile(r"^periscopy: (?!error: |warning: )(.*)\n", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """What a command ended with; the plain lines of its stages are apart from its complaints."""

    code: int
    out: str
    told: str

    @property
    def err(self):
        return STAGE.sub("", self.told)

    @property
    def stages(self):
        return STAGE.findall(self.told)


@pytest.fixture(scope="session")
def complaints():
    """Return what a process printed to stderr, without the plain lines of its stages."""
    return lambda printed: STAGE.sub("", printed)


@pytest.fixture(scope="session")
def jit():
    """Skip where only the scalar variant works: rendering would crawl, and warn that it does."""
    reports = [report for report in examine_variants() if not report.name.startswith("scalar")]
    if not any(report.works for report in reports):
        pytest.skip("; ".join(f"{report.name}: {report.reason}" for report in reports))


@pytest.fixture(autouse=True)
def few_figures(blank_figures):
    """Each figure is drawn by tests that ask for `drawings`, and by those of `figures`."""


@pytest.fixture
def periscopy(monkeypatch, capfd, caplog, tmp_path):
    """Run `periscopy` with arguments; the current folder is `tmp_path`.

    No library may log anything, which Python would print.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("typer.main.get_command", parser_of)
    for name in ("PERISCOPY_VARIANT", *TERMINAL):
        monkeypatch.delenv(name, raising=False)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["periscopy", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        # Futures of an earlier test's Dask client may be collected, and complain, during this one.
        assert [record for record in caplog.records if record.name != "asyncio"] == []
        return Outcome(end.value.code, *capfd.readouterr())

    return run


@pytest.fixture
def without_doubts():
    """Leave out that a photograph shows nothing or does not fit: many here are random numbers."""
    doubts = "hidden image", "does not fit", "not linear", "is uneven"
    return lambda warnings: [
        each for each in warnings if not any(doubt in each for doubt in doubts)
    ]


@pytest.fixture
def succeeds(periscopy, without_doubts):
    """Run a command that must end with exit code 0 in silence but for what it prints; return it."""

    def run(*arguments):
        outcome = periscopy(*arguments)
        assert (outcome.code, without_doubts(outcome.err.splitlines())) == (0, [])
        return outcome.out

    return run


@pytest.fixture
def refused(periscopy, tmp_path):
    """Run a command that must fail by one line and leave every file as it was; return the line."""

    def contents():  # but for what Python keeps beside a file of methods
        return {
            path: path.is_file() and path.read_bytes()
            for path in tmp_path.rglob("*")
            if "__pycache__" not in path.parts
        }

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
    """Write a chair scene with parts of its XML replaced; return its path."""

    def write(*replacements):
        xml = find_scene("chair").read_text()
        for old, new in replacements:
            assert old in xml
            xml = xml.replace(old, new)
        (tmp_path / "edited.xml").write_text(xml)
        # The whole path: Mitsuba looks for relative ones where the process started.
        return str(tmp_path / "edited.xml")

    return write


@pytest.fixture
def few_lights(monkeypatch):
    """Model ambient light by 3 x 3 x 3 lights, 2 m apart: 512 take longer than all the rest."""
    grid = point_light.paper_grid
    monkeypatch.setattr(point_light, "paper_grid", lambda: grid(2.0))


@pytest.fixture
def few_paths(monkeypatch):
    """Trace few paths in a round of ambient light, one of which is as exact as tests need."""
    monkeypatch.setattr("periscopy_sim.rendering.ambient.background.RAYS", 16)
    monkeypatch.setattr("periscopy_sim.rendering.ambient.background.DIRECT_SAMPLES", 16)


# -- videos --------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def clip():
    """A hidden video (9, 4, 5, 3): noise that moves a patch to the right with each frame."""
    first = np.random.default_rng(22).uniform(0.1, 1, (4, 5, 3))
    return np.stack([np.roll(first, k, axis=1) for k in range(9)])


@pytest.fixture(scope="session")
def scenario():
    return ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})


@pytest.fixture(scope="session")
def transport(scenario):
    return ps.render_transport(scenario, samples=4)


@pytest.fixture(scope="session")
def photographs(transport, clip):
    """Photographs of the clip, as the scene's own matrix has them, and noise of 40 dB."""
    signal = (transport.astype(np.float64) @ clip.reshape(9, 20, 3)).reshape(9, 24, 24, 3)
    noise = 0.01 * np.sqrt(np.mean(signal**2))
    return signal + np.random.default_rng(5).normal(0, noise, signal.shape)


@pytest.fixture(scope="session")
def few_photographs(photographs):
    return photographs[:3]


@pytest.fixture(scope="session")
def tiny():
    """Options that name the scene of the photographs."""
    return ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


@pytest.fixture
def video(succeeds, tiny, results, tmp_path):
    """Reconstruct a sequence into `out`; return the frames, the summary and the table."""

    def run(given, *options):
        succeeds("video", given, *tiny, *options, "--out", "out")
        return results(tmp_path / "out")

    return run


@pytest.fixture(scope="session")
def results():
    """Read the frames, the summary and the table in a folder."""

    def read(folder):
        with (folder / "metrics.csv").open(newline="") as stream:
            table = list(csv.DictReader(stream))
        summary = json.loads((folder / "summary.json").read_text())
        return np.load(folder / "frames.npy"), summary, table

    return read


# -- sweeps --------------------------------------------------------------------------------------

OWN_METHODS = """
import numpy as np

class Mine:
    def __init__(self, scenario, A, B):
        self.shape, self.A = (*scenario.hidden_shape, 3), A

    def reconstruct(self, photograph):
        return (self.A.T @ photograph.reshape(len(self.A), 3)).reshape(self.shape)

class Failing(Mine):
    def reconstruct(self, photograph):
        raise KeyError("lost")

class Unfit(Mine):
    def __init__(self, scenario, A, B):
        raise KeyError("no")
"""


@pytest.fixture
def sweep_input(tmp_path):
    """What a sweep needs, in the current folder: a photograph, its truth, ambient light."""
    x, z = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    for name, light in {"left": 2 - x, "lamp": 1 / (2 + x**2 + z)}.items():
        write_exr(tmp_path / f"{name}.exr", light[..., None] * [1.0, 0.9, 0.8], {})
    write_exr(tmp_path / "small.exr", np.ones((20, 21, 3)), {})
    rng = np.random.default_rng(31)
    np.save(tmp_path / "truth.npy", rng.uniform(0.1, 1, (4, 5, 3)))
    np.save(tmp_path / "y.npy", rng.uniform(1, 2, (21, 21, 3)))
    (tmp_path / "mine.py").write_text(OWN_METHODS)
    return tmp_path


@pytest.fixture(scope="session")
def sweep_command():
    """Give the arguments of a small sweep of `sweep_input`, some of its options changed."""

    def arguments(**changes):
        options = {
            "photograph": "y.npy",
            "truth": "truth.npy",
            "ambient": "left.exr,lamp.exr",
            "sbr": "0.5,5",
            "methods": "preconditioned,truncated-svd",
            "out": "out",
            **changes,
        }
        listed = [
            (f"--{name.replace('_', '-')}", *([] if value is True else [value]))
            for name, value in options.items()
            if value is not None
        ]
        scene = ("plate", "-D", "resolution=21", "--hidden", "4x5", "--samples", "4")
        return ("sweep", *scene, *(str(part) for pair in listed for part in pair))

    return arguments


@pytest.fixture(scope="session")
def sweep_results():
    """Read the bytes of the table and of every file of the store in a folder."""

    def contents(folder):
        files = [folder / "sweep.csv", *(folder / "sweep.zarr").rglob("*")]
        return {
            str(path.relative_to(folder)): path.read_bytes() for path in files if path.is_file()
        }

    return contents
