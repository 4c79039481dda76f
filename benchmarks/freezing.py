"""What holds the suites still: their digest, and what photographs and metrics come to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import case
from benchmarks.scoring import scores
from benchmarks.suites import FROZEN, SUITES, VERSION, digest
from periscopy_sim.errors import PeriscopyError

TOLERANCE = 2e-3
"""Relative: two renderings on different machines agree by far better, other light does not."""


def photograph_sums(suite: str, rendered: Path) -> list[float]:
    """Return numbers of a suite's first geometry: moments of each channel of its first photograph.

    (3 x 4,) means of a photograph over its four quarters.
    """
    photograph = case(SUITES[suite], 0, rendered).photographs[0]
    halves = [np.split(half, 2, axis=1) for half in np.split(photograph, 2, axis=0)]
    return [float(v) for row in halves for part in row for v in part.mean(axis=(0, 1))]


def metric_example() -> dict[str, float]:
    """Return the metrics of a drawn image and truth: they tell when a metric has changed."""
    rng = np.random.default_rng(0)
    truth = rng.random((12, 15, 3))
    return scores(truth + rng.normal(0, 0.1, truth.shape), truth)


def recorded() -> dict[str, Any]:
    """Return what ``frozen.json`` holds."""
    record: dict[str, Any] = json.loads(FROZEN.read_text("utf-8"))
    return record


def check_frozen() -> None:
    """Raise a PeriscopyError where the suites are not those that were frozen."""
    held = recorded()
    if held["digest"] == digest() and held["version"] == VERSION:
        return
    if held["version"] == VERSION:
        raise PeriscopyError(
            f"the suites of version {VERSION} have changed: raise VERSION in benchmarks/suites.py, "
            "then run `python -m benchmarks freeze`, or take the change back"
        )
    raise PeriscopyError(
        f"benchmarks/frozen.json is of version {held['version']}, the suites of {VERSION}: run "
        "`python -m benchmarks freeze`"
    )


def freeze(rendered: Path) -> Path:
    """Write ``frozen.json`` for a new version; one that is frozen already is never written over.

    Raises
    ------
    PeriscopyError
        If this version is frozen.
    """
    if FROZEN.is_file() and recorded()["version"] == VERSION:
        check_frozen()
        raise PeriscopyError(
            f"version {VERSION} is frozen: raise VERSION in benchmarks/suites.py to freeze another"
        )
    record = {
        "version": VERSION,
        "digest": digest(),
        "metrics": metric_example(),
        "photographs": {suite: photograph_sums(suite, rendered) for suite in SUITES},
    }
    FROZEN.write_text(json.dumps(record, indent=2) + "\n", "utf-8")
    return FROZEN
