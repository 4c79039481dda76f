"""The noise-aware image refined by a network, `experiments/learned/unrolled.py`."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from benchmarks.cases import Case
from benchmarks.entry import Entry
from periscopy_sim.errors import missing


class Solver(Entry):
    """A user's own method by its file, which needs PyTorch."""

    name = "unrolled"

    def skip(self, case: Case) -> tuple[bool, str | None]:
        """Skip suites of other sizes than the network's, and all without PyTorch."""
        if find_spec("torch") is None:
            return True, missing("torch")
        from experiments.learned.unrolled import HIDDEN

        return case.scenario.hidden_shape != HIDDEN, f"the network knows {HIDDEN} patches alone"

    def fit(self, scene: Any, A: Any, B: Any) -> Any:
        """Return an object with ``reconstruct(photograph) -> image``."""
        from experiments.learned.unrolled import Unrolled

        return Unrolled(scene, A, B)
