"""The noise-aware image, refined by an unrolled network that learned from rendered photographs.

`--method experiments/learned/unrolled.py:Unrolled` runs it. The noise-aware method estimates the
image, the noise, a gain over the wall and ambient light beyond range(B). The network reads the
photograph's coefficients, no pixels. In the spectral basis of a scene
(`periscopy_sim.model.spectral_basis`) its step k is

    x_k = argmin_x Σ_p w_p ‖a_p − λ_p x_p‖²/λ_p + ρ_k ‖x − v_{k−1}‖²_K,    ρ_k = r_k/e²
    v_k = v_{k−1} + D_k(x_k, v_{k−1}, v_0, log e_i)

with K = ∇ᵀ∇ + I, a_p the photograph's coefficients and w_p their weights. The first line is a
proximal step of the misfit in closed form. In the second, D_k is a small convolutional network of
the step, after the scheme of J. Adler and O. Öktem, "Learned primal-dual reconstruction", IEEE TMI
2018. v_0 is the noise-aware image, e_i are the patches' standard errors under a Gaussian prior of
that image's contrast (`Problem`), and e is their root mean square. D_k ends in weights that are
zero before training, so that the network begins as v_0.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.errors import require
from periscopy_sim.model.spectral_basis import laplacian

torch = require("torch")

HIDDEN = 29, 36
"""(R, C) of the images that networks learn from."""

CHANNELS = 3
"""Channels of these images."""

DILATIONS = 1, 2, 1, 1
"""Dilations of the four layers of each D_k: a patch depends on neighbours up to 5 away."""

LEAST_ERROR = 1e-4
"""Least standard error of a patch, over the image's scale."""

WEIGHTS = Path(__file__).with_name("unrolled.npz")
"""The trained weights: an array for each tensor, and the provenance of the training."""

Single = NDArray[np.float32]


class Unrolled:
    """Recover hidden images of 29x36 patches by the network.

    Parameters
    ----------
    scenario, A, B, mask
        As of any method of one's own; see docs/own_method.md.
    weights
        File of weights, which `experiments.learned.train` writes.

    Raises
    ------
    ValueError
        If the scene has other hidden images than the network learned from.
    """

    def __init__(
        self, scenario: Any, A: Any, B: Any, mask: Any = None, weights: str | Path = WEIGHTS
    ) -> None:
        if [*scenario.hidden.shapes.values()] != [HIDDEN]:
            raise ValueError(
                f"the network learned from one hidden surface of {HIDDEN[0]}x{HIDDEN[1]} patches: "
                "take this size, or train another network"
            )
        self.mask = mask
        self.method = ps.NoiseAware.for_scene(scenario, A, B)
        self.network = read_network(weights)
        torch.set_num_threads(1)  # a second one makes so small a network no faster

    def reconstruct(self, photograph: Any) -> Any:
        """Return the image, (R, C, 3), of a photograph, (rows, columns, 3)."""
        if photograph.shape[-1] != CHANNELS:
            raise ValueError(f"the network learned from {CHANNELS} channels: use noise-aware")
        method = self.method.fitted_to(ps.Photograph(photograph, self.mask))
        solution = method.solve(photograph)
        problem = problem_of(method, solution)
        if problem is None:
            return solution.image
        stack = problem.data, problem.weights, problem.errors[None], problem.start
        problems = Problems.of(method.fit.patterns, *(each[None] for each in stack))
        with torch.inference_mode():
            image = self.network(problems)[0].clamp(min=0).numpy()
        return np.moveaxis(image, 0, -1) * problem.scale


@dataclass(frozen=True, eq=False)
class Problem:
    """A photograph as the network reads it, images over their `scale`; see `Problems`."""

    data: Single  # (3, N)
    weights: Single  # (3, N)
    errors: Single  # (R, C)
    start: Single  # (3, R, C)
    scale: float  # of the image, in units of the photograph's over those of A


def problem_of(method: ps.NoiseAware, solution: Any) -> Problem | None:
    """Return the problem of a photograph from its noise-aware solution; None of a black image."""
    evidence, patterns = solution.evidence, method.fit.patterns
    start = np.moveaxis(solution.image, -1, 0) * (method.fit.unit / evidence.level)
    scale = float(np.sqrt(np.mean(start**2)))
    if not scale > 0:
        return None
    start = start / scale
    weights = scale**2 / np.tile(evidence.noise[:, None] ** 2, len(patterns.curvatures))
    data = weights * evidence.coefficients / scale
    # Images of this contrast: a Gaussian prior of precision p K, K = ∇ᵀ∇ + I.
    slopes = np.sum(method.hidden.differences(start.reshape(len(start), -1).T) ** 2)
    p = start.size / float(slopes + np.sum(start**2))
    spread = np.mean(1 / (weights * patterns.curvatures + p), axis=0)
    errors = np.sqrt(np.maximum(spread.astype(np.float32) @ patterns.rows**2, LEAST_ERROR**2))
    return Problem(
        data=data.astype(np.float32),
        weights=weights.astype(np.float32),
        errors=errors.reshape(method.hidden_shape),
        start=start.astype(np.float32),
        scale=scale * evidence.level / method.fit.unit,
    )


@dataclass(frozen=True, eq=False)
class Problems:
    """K photographs of one scene as the network reads them; images are over their scale, near 1."""

    rows: Any  # (N, N) the scene's patterns W_p, one a row
    curvatures: Any  # (N,) their λ_p
    rows_K: Any  # (N, N) W_p K, a pattern a row
    data: Any  # (K, 3, N) w a
    weights: Any  # (K, 3, N) w
    errors: Any  # (K, 1, R, C) standard errors of the patches; see `Problem`
    start: Any  # (K, 3, R, C) the noise-aware images

    @classmethod
    def of(cls, patterns: Any, *stacks: Any) -> "Problems":
        """Return the tensors of a spectral basis and of stacks: data, weights, errors, start."""
        rows_K = patterns.rows @ laplacian(patterns.hidden.differences)
        arrays = patterns.rows, patterns.curvatures, rows_K, *stacks
        return cls(*(torch.as_tensor(each, dtype=torch.float32) for each in arrays))


class UnrolledNetwork(torch.nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """The network of the module: it maps `Problems` to images, (K, 3, R, C)."""

    def __init__(self, steps: int = 8, width: int = 24) -> None:
        super().__init__()
        self.log_ratios = torch.nn.Parameter(torch.linspace(0.0, 2.0, steps))  # log r_k
        self.learned = torch.nn.ModuleList(_convolutions(width) for _ in range(steps))

    def forward(self, problems: Problems) -> Any:
        """Return the images, (K, 3, R, C), over their scale."""
        start = problems.start
        logs = torch.log10(problems.errors) + 2  # about 0 to 2
        precision = problems.errors.square().mean(dim=(1, 2, 3)).reciprocal()[:, None, None]
        v = start
        for log_ratio, learned in zip(self.log_ratios, self.learned, strict=True):
            x = proximal_step(problems, v, log_ratio.exp() * precision)
            v = v + learned(torch.cat([x, v, start, logs], dim=1))
        return v


def proximal_step(problems: Problems, v: Any, ρ: Any) -> Any:
    """Return x of the module, (K, 3, R, C), near images v; ρ is (K, 1, 1)."""
    coefficients = problems.data + ρ * (v.flatten(2) @ problems.rows_K.T)
    coefficients = coefficients / (problems.weights * problems.curvatures + ρ)
    return (coefficients @ problems.rows).reshape(v.shape)


def read_network(file: str | Path) -> UnrolledNetwork:
    """Return the network of a file of weights."""
    network = UnrolledNetwork()
    with np.load(file) as held:
        tensors = {name: torch.from_numpy(held[name]) for name in network.state_dict()}
    network.load_state_dict(tensors)
    return network.requires_grad_(False)


def write_weights(tensors: Mapping[str, Any], provenance: Mapping[str, Any], file: Path) -> None:
    """Write a network's tensors beside the provenance of its training: data, seed, steps."""
    arrays = {name: each.numpy() for name, each in tensors.items()}
    np.savez(file, provenance=json.dumps(provenance, sort_keys=True), **arrays)


def _convolutions(width: int) -> Any:
    channels = (3 * CHANNELS + 1, width, width, width, CHANNELS)
    layers: list[Any] = []
    for before, after, dilation in zip(channels[:-1], channels[1:], DILATIONS, strict=True):
        layers += [
            torch.nn.Conv2d(before, after, 3, padding=dilation, dilation=dilation),
            torch.nn.ReLU(),
        ]
    layers.pop()  # the last layer's values may be negative
    torch.nn.init.zeros_(layers[-1].weight)
    torch.nn.init.zeros_(layers[-1].bias)
    return torch.nn.Sequential(*layers)
