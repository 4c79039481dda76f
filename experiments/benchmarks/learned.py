"""One photograph by the learned method, beside the noise-aware one."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

import periscopy_sim as ps
from experiments.benchmarks.scene import SMALL, photographs_of, seconds_text
from experiments.report import Claim, Section, Verdict
from experiments.setting import Chair, Setting
from experiments.timing import interleaved_seconds

RUNS = 41
MOST = 0.06
"""Seconds asked for a still."""


def learned(_: Setting) -> Section:
    """Time stills of both methods in turn."""
    title = "Learned method, 36 x 29 patches, 126 x 126 pixels"
    if find_spec("torch") is None:
        return Section("learned", title, "PyTorch is not installed: not measured.")
    scene = Chair(SMALL)
    y = photographs_of(scene, 1)[0]
    seen = scene.scenario, scene.A, scene.B
    methods: dict[str, ps.NoiseAware] = {"noise-aware": ps.NoiseAware.for_scene(*seen)}
    methods["unrolled"] = ps.Learned.for_scene(*seen)
    tasks = {name: partial(method.reconstruct, y) for name, method in methods.items()}
    seconds = interleaved_seconds(tasks, RUNS)
    claims = [
        Claim(
            f"a still, {name}",
            f"at most {seconds_text(MOST)}" if name == "unrolled" else "",
            f"{seconds_text(took)}, {took / seconds['noise-aware']:.2f} of noise-aware's",
            Verdict.of(took <= MOST) if name == "unrolled" else Verdict.MEASURED,
        )
        for name, took in seconds.items()
    ]
    return Section("learned", title, f"Medians of {RUNS} runs in turn.", claims=claims)
