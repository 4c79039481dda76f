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

TERMINAL = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")  # make rich draw anywhere


parser_of = cache(typer.main.get_command)
"""Typer makes the parser of all commands anew at every call."""

STAGE = re.compile(r"^periscopy: (?!error: |warning: )(.*)\n", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """The exit code of a command and what it printed; `err` lacks the lines of its stages."""

    code: int
    out: str
    told: str

    @property
    def err(self):
        return STAGE.sub("", self.told)


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
        monkeypatch.setattr("os._exit", sys.exit)
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        # Futures of an earlier test's Dask client may be collected, and complain, during this one.
        assert [record for record in caplog.records if record.name != "asyncio"] == []
        return Outcome(end.value.code, *capfd.readouterr())

    return run


@pytest.fixture
def succeeds(periscopy):
    """Run a command that must end with exit code 0, with no complaint but warnings; return it."""

    def run(*arguments):
        outcome = periscopy(*arguments)
        assert outcome.code == 0, outcome.err
        assert all(line.startswith("periscopy: warning: ") for line in outcome.err.splitlines())
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
def few_lights(monkeypatch):
    """Model ambient light by 3 x 3 x 3 lights, 2 m apart: 512 take longer than all the rest."""
    grid = point_light.paper_grid
    monkeypatch.setattr(point_light, "paper_grid", lambda: grid(2.0))


@pytest.fixture
def every_wall_point():
    """Ask for the points of pixels as they are, where numbers depend on them; see below."""


@pytest.fixture(autouse=True)
def few_wall_points(request, monkeypatch):
    """Average A by areas over fewer points of each pixel: small photographs cost as large ones."""
    if "every_wall_point" not in request.fixturenames:
        points = 48 if request.node.get_closest_marker("thorough") else 24
        monkeypatch.setattr("periscopy_sim.analytic.area_transport.PIXEL_POINTS", points)


@pytest.fixture(autouse=True)
def few_bounced_paths(monkeypatch):
    """Trace few paths of the light that bounces, which each result is checked for."""
    monkeypatch.setattr("periscopy_sim.rendering.bounced.PATHS", 64)
    monkeypatch.setattr("periscopy_sim.rendering.wall_polynomials.POWERS", (0, 1, 2, 3, 5))
    for module in ("ambient", "bounced"):
        monkeypatch.setattr(f"periscopy_sim.rendering.{module}.REPLICAS", 3)


@pytest.fixture
def few_paths(monkeypatch):
    """Trace few paths in a round of ambient light, one of which is as exact as tests need."""
    monkeypatch.setattr("periscopy_sim.rendering.ambient.RAYS", 16)
    monkeypatch.setattr("periscopy_sim.rendering.ambient.DIRECT_SAMPLES", 16)


TINY = ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


@pytest.fixture(scope="session")
def tiny():
    """Options that name the scene of the photographs."""
    return TINY


@pytest.fixture(scope="session")
def clip():
    """A hidden video (3, 4, 5, 3): noise that moves a patch to the right with each frame."""
    first = np.random.default_rng(22).uniform(0.1, 1, (4, 5, 3))
    return np.stack([np.roll(first, k, axis=1) for k in range(3)])


@pytest.fixture(scope="session")
def scenario():
    return ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})


@pytest.fixture(scope="session")
def transport(scenario):
    return ps.render_transport(scenario, samples=4)


@pytest.fixture(scope="session")
def photographs(transport, clip):
    """Photographs of the clip, as the scene's own matrix has them, and noise of 40 dB."""
    signal = (transport.astype(np.float64) @ clip.reshape(-1, 20, 3)).reshape(-1, 24, 24, 3)
    noise = 0.01 * np.sqrt(np.mean(signal**2))
    return signal + np.random.default_rng(5).normal(0, noise, signal.shape)


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    """Reconstruct from a file into `out`; return the image and the summary."""

    def run(photo, *options):
        succeeds("reconstruct", photo, *TINY, *options, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


@pytest.fixture(scope="session")
def hidden():
    return np.random.default_rng(21).uniform(0.1, 1, (4, 5, 3))


@pytest.fixture(scope="session")
def light(hidden, scenario, transport):
    """A photograph as the scene's own matrix has it, without noise, and ambient light."""
    signal = transport.astype(np.float64) @ hidden.reshape(20, 3)
    # A lamp 1 m to the left, 3 m before the wall and 1 m above the centre: one of the modelled.
    lamp = np.array([0.7435 - 1, 1.03 - 3, 0.2645 + 1])
    away = lamp - scenario.view.centers
    ambient = -away[:, 1] / np.linalg.norm(away, axis=1) ** 3
    ambient *= 5 * signal.mean() / ambient.mean()
    colour = [1.2, 1, 0.8]
    return signal.reshape(24, 24, 3), (ambient[:, None] * colour).reshape(24, 24, 3)
