import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from periscopy_sim.analytic import area_transport
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering import bounced, wall_polynomials
from periscopy_sim.rendering.bounced import BouncedTransport, render_bounced_light
from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.photograph import render_photograph
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.rendering.variant import OVERRIDE, mi, use_variant
from periscopy_sim.scenario import Scenario, load_scenario
from periscopy_sim.shipped import find_scene
from tests.scenes.room import Room

FALSE_ALARMS = 1e-5
"""Probability with which `same_mean` fails on equal means."""


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    return use_variant()


@pytest.fixture
def room(tmp_path: Path) -> Room:
    return Room(tmp_path)


@pytest.fixture
def mitsubas() -> Callable[..., list[np.ndarray]]:
    """Render pictures of a scene file by Mitsuba alone, in grey: one a seed, of an integrator."""

    def run(
        path: Path, *, seeds: int = 8, samples: int = 1 << 14, **integrator: object
    ) -> list[np.ndarray]:
        scene, traced = mi.load_file(str(path)), mi.load_dict(integrator)
        return [
            np.array(mi.render(scene, integrator=traced, spp=samples, seed=seed)).mean(axis=2)
            for seed in range(seeds)
        ]

    return run


@pytest.fixture
def shipped() -> Callable[..., Scenario]:
    """Load a shipped scene at a small size."""

    def load(name: str, hidden: tuple[int, int] = (6, 8), resolution: int = 24) -> Scenario:
        if name != "plant":
            return load_scenario(find_scene(name), hidden, {"resolution": resolution})
        size = {"width": resolution, "height": round(resolution * 112 / 144)}
        return load_scenario(find_scene(name), hidden, size)

    return load


@pytest.fixture
def same_mean() -> Callable[..., None]:
    """Assert that two sets of renders (one per seed, first axis) have equal means.

    Every pixel's difference and that of the whole picture are measured by the variance of both
    sides. Three statistics share `FALSE_ALARMS`: the picture's sum, the worst pixel, and the sum of
    squares over pixels. Channels of color pictures (last of three axes or more) share their random
    numbers, so they are tested one by one.
    """

    def check(a: np.ndarray, b: np.ndarray) -> None:
        a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
        channels = 3 if a.ndim > 2 and a.shape[-1] == 3 else 1
        a, b = (x.reshape(len(x), -1, channels) for x in (a, b))
        error_rate = FALSE_ALARMS / 3 / channels
        # As standard normal deviates; Welch's number of degrees of freedom is at least this.
        degrees = min(len(a), len(b)) - 1

        def deviates(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            variance = a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b)
            rounding = 1e-6 * np.abs(b).mean(axis=0)
            t = (a.mean(axis=0) - b.mean(axis=0)) / np.sqrt(variance + rounding**2 + 1e-30)
            return stats.norm.isf(stats.t.sf(np.abs(t), degrees))

        assert deviates(a.sum(axis=1), b.sum(axis=1)).max() < stats.norm.isf(error_rate / 2)
        z = deviates(a, b)
        assert z.max() < stats.norm.isf(error_rate / 2 / len(z))
        assert np.sum(z**2, axis=0).max() < stats.chi2.isf(error_rate, len(z))

    return check


@pytest.fixture
def every_wall_point() -> None:
    """Ask for the points of pixels as they are, where a test is about them; see below."""


@pytest.fixture(autouse=True)
def few_wall_points(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin with fewer wall points in a pixel: small photographs cost as large ones."""
    is_thorough = request.node.get_closest_marker("thorough")
    if not is_thorough and "every_wall_point" not in request.fixturenames:
        monkeypatch.setattr(area_transport, "PIXEL_POINTS", 48)


@pytest.fixture
def few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trace few paths of bounced light in a round, and fit few polynomials to it."""
    monkeypatch.setattr(bounced, "PATHS", 64)
    monkeypatch.setattr(wall_polynomials, "POWERS", (0, 1, 2, 3, 5))


@pytest.fixture
def scalar(tmp_path: Path) -> Callable[..., str]:
    """Run Python code in a process of its own, in scalar_rgb; give what it prints."""

    def run(code: str, *arguments: object) -> str:
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", code, *map(str, arguments)],
            env={**os.environ, OVERRIDE: "scalar_rgb"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


BY_BSDF = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}

SEEDS = 8


@pytest.fixture(scope="session")
def refusal():
    """Return the message, of one line that names the file, by which a scene is refused."""

    def refuse(path, *arguments, **options):
        with pytest.raises(SceneError) as caught:
            SceneNodes(path, *arguments, **options).instantiate()
        message = str(caught.value)
        assert "\n" not in message
        assert f"'{path}'" in message
        return message

    return refuse


@pytest.fixture
def is_right(room, same_mean, mitsubas):
    """Assert that A of a white monitor is the file's photograph, sampled as `truth` says."""

    def check(*extra, samples=16, across=4, truth=BY_BSDF, **parts):
        parts = {"monitor": room.monitor(room.area)} | parts
        seen = room.load(*extra, **parts)
        seen = seen.averaged(across)
        found = [render_transport(seen, samples=samples, seed=s).sum(axis=1) for s in range(SEEDS)]
        gain = seen.channel_gain.mean()
        pictures = mitsubas(room.write(*extra, **parts), seeds=SEEDS, **truth)
        same_mean([picture.ravel() / gain for picture in pictures], found)

    return check


@pytest.fixture
def agrees(same_mean):
    """Assert that A f is the path-traced photograph of a random f; return A f, (seeds, M, 3)."""

    def check(seen, bounces=1, *, seeds=12, samples=256, target=2e-3):
        image = np.random.default_rng(0).random((*seen.hidden_shape, 3))
        predicted, traced = [], []
        for seed in range(seeds):
            A = render_transport(seen.averaged(4), samples=16, seed=seed)
            if bounces != 1:
                light = render_bounced_light(seen, bounces=bounces, target=target, seed=seed)
                A = BouncedTransport(A + light.rows(slice(None)), light, bounces)
            predicted.append((A @ image.reshape(-1, 3)) * seen.channel_gain)
            options = {"samples": samples, "bounces": bounces, "seed": 1000 + seed}
            traced.append(render_photograph(seen, image, **options))
        same_mean(traced, predicted)
        return np.array(predicted)

    return check
