"""What the adapters cost beside the plain product."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from experiments.report import Section, Table
from experiments.setting import Setting
from experiments.timing import interleaved_seconds
from periscopy_sim.adapters.linear_operator import transport_operator
from periscopy_sim.adapters.torch_transport import TorchTransport

RUNS = 41
PIXELS, PATCHES = (126, 126), (29, 36)  # the chair's, at README's resolution


def overheads(runs: int = RUNS) -> dict[str, float]:
    """Return each adapter's seconds over the plain product's, float32, three channels."""
    rng = np.random.default_rng(0)
    M, N = int(np.prod(PIXELS)), int(np.prod(PATCHES))
    A = rng.random((M, N), np.float32)
    x, y = rng.random((N, 3), np.float32), rng.random((M, 3), np.float32)
    operator = transport_operator(A, photograph_shape=PIXELS, hidden_shape=PATCHES)
    pairs: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
        "SciPy, forward": (lambda: A @ x, lambda: operator @ x.ravel()),
        "SciPy, adjoint": (lambda: A.T @ y, lambda: operator.H @ y.ravel()),
    }
    if find_spec("torch") is not None:
        import torch

        light = TorchTransport(A, photograph_shape=PIXELS, hidden_shape=PATCHES)
        f, p = torch.rand(1, 3, *PATCHES), torch.rand(1, 3, *PIXELS)
        flat_f, flat_p = f.reshape(3, N), p.reshape(3, M)
        pairs["PyTorch, forward"] = (lambda: flat_f @ light.A.T, lambda: light(f))
        pairs["PyTorch, adjoint"] = (lambda: flat_p @ light.A, lambda: light.adjoint(p))
    ratios = {}
    for name, (plain, adapted) in pairs.items():
        seconds = interleaved_seconds({"plain": plain, "adapted": adapted}, runs)
        ratios[name] = seconds["adapted"] / seconds["plain"]
    return ratios


def operators(_: Setting) -> Section:
    """Show what a product costs through each adapter, beside the plain one."""
    rows = [(name, f"{ratio:.3f}") for name, ratio in overheads().items()]
    caption = f"Medians of {RUNS} interleaved runs, single precision, three channels."
    table = Table(caption, ("product", "seconds over the plain product's"), rows)
    return Section("operators", "Light transport in other libraries", tables=[table])
