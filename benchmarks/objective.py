"""What benchopt asks: the metrics of each recovered image, or why there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
from benchopt import BaseObjective

from benchmarks.cases import Case
from benchmarks.entry import Outcome
from benchmarks.scoring import METRICS, scores
from benchmarks.suites import VERSION
from periscopy_sim.evaluation.metrics import gain_matched
from periscopy_sim.storage.pictures import png_bytes
from periscopy_sim.storage.rasters import srgb_encode


class Objective(BaseObjective):
    """Hidden images from photographs of a wall."""

    name = "Passive non-line-of-sight imaging"
    min_benchopt_version = "1.6"
    sampling_strategy = "run_once"
    requirements = ["pip::scikit-image"]  # noqa: RUF012 (benchopt's way)

    def set_data(self, case: Case, geometry: int) -> None:
        """Take a suite's geometry."""
        self.case, self.geometry = case, geometry

    def get_objective(self) -> dict[str, Any]:
        """Return what a method gets."""
        return {"case": self.case}

    def get_one_result(self) -> dict[str, Any]:
        """Return the result of a method that sees nothing but black."""
        count = len(self.case.names)
        images = list(np.zeros_like(self.case.truths))
        return {
            "label": "black",
            "outcome": Outcome(images, [""] * count, [0.0] * count, 0.0, 0.0),
        }

    def evaluate_result(self, label: str, outcome: Outcome) -> list[dict[str, Any]]:
        """Return a row for each cell: its metrics, or NaN and why."""
        rows = []
        for k, (name, truth) in enumerate(zip(self.case.names, self.case.truths, strict=True)):
            image, failure = outcome.images[k], outcome.failures[k]
            measured = dict.fromkeys(METRICS, float("nan"))
            recovered = b""
            if not failure:
                try:
                    measured = scores(image, truth)
                    recovered = _png(gain_matched(image, truth))
                except ValueError as error:
                    failure = str(error)
            rows.append(
                {
                    "value": -measured["psnr"],
                    **measured,
                    "label": label,
                    "suite": self.case.suite.name,
                    "geometry": self.geometry,
                    "cell": name,
                    "failure": failure,
                    "seconds": outcome.seconds[k],
                    "fit_seconds": outcome.fit_seconds,
                    "memory": outcome.memory,
                    "recovered": recovered,
                    "truth": _png(truth),
                    "photograph": _png(self.case.photographs[k] / self.case.photographs[k].max()),
                    "version": VERSION,
                }
            )
        return rows


def _png(image: Any) -> bytes:
    values = np.rint(255 * srgb_encode(np.clip(np.asarray(image, np.float64), 0, 1)))
    return png_bytes(values.astype(np.uint8), {})
