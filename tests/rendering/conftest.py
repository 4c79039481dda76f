import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

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
