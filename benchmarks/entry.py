"""What an entry is: a method behind benchopt's interface, timed, and held to one cell at a time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from benchopt import BaseDataset, BaseSolver
from threadpoolctl import threadpool_limits

from benchmarks.cases import Case, case
from benchmarks.suites import SUITES
from periscopy_sim.methods import OwnError, without_addresses

Recover = Callable[[Any], Any]
"""Takes a photograph, (rows, columns, 3); returns the hidden image, (R, C, 3)."""


class SuiteDataset(BaseDataset):
    """A suite as a data set of benchopt, one geometry at a time; subclasses name the suite."""

    name = ""
    parameters: dict[str, list[Any]] = {"geometry": [0]}  # noqa: RUF012 (benchopt's way)

    def get_data(self) -> dict[str, Any]:
        """Render the geometry."""
        return {"case": case(SUITES[self.name], self.geometry), "geometry": self.geometry}


def geometries_of(name: str) -> dict[str, list[Any]]:
    """Return benchopt's parameters of a suite's data set: the numbers of its geometries."""
    return {"geometry": list(range(SUITES[name].geometries))}


@dataclass
class Outcome:
    """What a method made of a geometry's photographs.

    Attributes
    ----------
    images
        What was returned for each; None where it failed.
    failures
        Why, for each; empty where it did not fail.
    seconds
        Of each image; the time to fit is apart.
    fit_seconds
        To fit the method to the scene.
    memory
        Bytes that the process's peak of resident memory rose by, from what A, B and the photographs
        take; NaN where the system does not tell (only Linux does).
    """

    images: list[Any] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    fit_seconds: float = float("nan")
    memory: float = float("nan")


class Entry(BaseSolver):
    """A method on the leaderboard. Subclasses give `name` and `fit`.

    Whatever a method raises fails that photograph, or all of a geometry if it cannot be fitted, and
    the rest goes on.
    """

    sampling_strategy = "run_once"
    name = ""

    @property
    def label(self) -> str:
        """What the leaderboard calls it."""
        return str(self.name)

    def fit(self, scene: Any, A: Any, B: Any) -> Any:
        """Fit the method to a scene: return an object with ``reconstruct(photograph) -> image``.

        Parameters
        ----------
        scene
            The `periscopy_sim.Scenario`, as the ruler says it is.
        A
            (M, N) light transport matrix, float32.
        B
            (M, 512) photographs of point lights: the paper's model of ambient light.
        """
        raise NotImplementedError(f"{type(self).__name__} has no fit(scene, A, B); add one")

    def frames(self, method: Any) -> Recover:
        """Return what recovers the next frame of a video: each as a still, unless overridden."""
        recover: Recover = method.reconstruct
        return recover

    def set_objective(self, case: Case) -> None:
        """Take a geometry; benchopt's."""
        self.case = case

    def run(self, _: Any) -> None:
        """Fit and reconstruct; benchopt's."""
        self.outcome = outcome(self, self.case)

    def get_result(self) -> dict[str, Any]:
        """Return what the objective judges; benchopt's."""
        return {"label": self.label, "outcome": self.outcome}


def outcome(entry: Entry, case: Case) -> Outcome:
    """Fit an entry to a geometry and reconstruct each of its photographs."""
    done = Outcome()
    with threadpool_limits(1), _peak(done):
        start = time.perf_counter()
        try:
            method = entry.fit(case.scenario, case.A.copy(), case.B.copy())
            recover = entry.frames(method) if case.suite.frames else method.reconstruct
        except OwnError as error:
            count = len(case.names)
            done.images, done.seconds = [None] * count, [float("nan")] * count
            done.failures = [f"cannot be fitted: {_told(error)}"] * count
            return done
        done.fit_seconds = time.perf_counter() - start
        for photograph in case.photographs:
            start = time.perf_counter()
            try:
                image, failure = recover(photograph.copy()), ""
                image = None if image is None else np.asarray(image)
            except OwnError as error:
                image, failure = None, _told(error)
            done.seconds.append(time.perf_counter() - start)
            done.images.append(image)
            done.failures.append(failure or ("returned nothing" if image is None else ""))
    return done


def _told(error: BaseException) -> str:
    return without_addresses(f"{type(error).__name__}: {error}")


@contextmanager
def _peak(done: Outcome) -> Iterator[None]:
    """Note by how much the process's peak of resident memory rises above what it holds now."""
    try:
        Path("/proc/self/clear_refs").write_text("5", "ascii")  # Linux: the peak starts anew
        before: float = _resident("VmRSS")
    except OSError:
        before = float("nan")
    try:
        yield
    finally:
        done.memory = _resident("VmHWM") - before if before == before else before


def _resident(kind: str) -> int:
    lines = Path("/proc/self/status").read_text("ascii").splitlines()
    kilobytes = next(line for line in lines if line.startswith(kind)).split()[1]
    return 1024 * int(kilobytes)
