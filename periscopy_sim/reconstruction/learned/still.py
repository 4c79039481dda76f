"""The noise-aware image, refined by a network that has learned from rendered photographs.

The noise-aware method estimates the image, the noise, a gain over the wall and ambient light beyond
range(B). The unrolled network then uses the same evidence, and knows what hidden images look like.
The network reads the photograph's coefficients, no pixels.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.spectral_basis import laplacian
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.reconstruction.learned.weights import NETWORK, SHIPPED, read_weights
from periscopy_sim.reconstruction.method import Report, of_all
from periscopy_sim.reconstruction.noise_aware.noise_aware import (
    NoiseAware,
    NoiseAwareReconstruction,
)

Single = NDArray[np.float32]

LEAST_ERROR = 1e-4
"""Over the image's scale: no error is believed to be smaller."""

_THREADS = Lock()
"""Lock of PyTorch's number of threads, which the whole process shares."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A photograph as the network reads it, images over their `scale`; see `Problems`."""

    data: Single  # (P, N)
    weights: Single  # (P, N)
    errors: Single  # (R, C)
    start: Single  # (P, R, C)
    scale: float  # of the image, in units of the photograph's over those of A


def problem_of(method: NoiseAware, solution: NoiseAwareReconstruction) -> Problem | None:
    """Return the problem of a photograph from its noise-aware solution; None of a black image."""
    evidence, patterns = solution.evidence, method.fit.patterns
    # The network takes each of the monitor's primaries on its own.
    coefficients, variances = evidence.coefficients, evidence.noise**2
    if method.fit.mixing is not None:
        unmixing = np.linalg.pinv(method.fit.mixing)
        coefficients, variances = unmixing @ coefficients, unmixing**2 @ variances
    start = np.moveaxis(solution.image, -1, 0) * (method.fit.unit / evidence.level)
    scale = float(np.sqrt(np.mean(start**2)))
    if not scale > 0:
        return None
    start = start / scale
    weights = scale**2 / np.tile(variances[:, None], len(patterns.curvatures))
    data = weights * coefficients / scale
    # Images of this contrast: a Gaussian prior of precision p K, K = ∇ᵀ∇ + I.
    slopes = np.sum(method.hidden.differences(start.reshape(3, -1).T) ** 2)
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


class Learned(NoiseAware):
    """Recover hidden images by a learned network; fit once to a scene.

    It needs PyTorch. docs/results/learned.md measures its gain.

    Parameters
    ----------
    weights
        Weights of the network: ``"unrolled"``, which ship with the package, or a file that
        `experiments.learned.train` wrote.
    A, B, **settings
        As of `NoiseAware`, whose other errors it raises, too.

    Raises
    ------
    PeriscopyError
        If PyTorch is not installed or the file is damaged.
    ValueError
        If the weights learned from hidden images of another size, or the scene is uncertain.
    """

    def __init__(
        self, A: Image, B: Image | None = None, *, weights: str | Path = NETWORK, **settings: Any
    ) -> None:
        if settings.get("uncertain") is not None:
            raise ValueError(f"{NETWORK} knows no uncertain scenes: take noise-aware")
        super().__init__(A, B, **settings)
        file = SHIPPED if weights == NETWORK else Path(weights)
        read = read_weights(file)
        if self.hidden_shape != read.hidden_shape:
            sizes = read.hidden_shape, self.hidden_shape
            known, wanted = ("{}x{}".format(*size) for size in sizes)
            raise ValueError(
                f"the weights {file.name} ({read.digest[:12]}) learned from hidden images of "
                f"{known} patches, the scene has {wanted}: load the scene with hidden {known}, or "
                "train others by experiments.learned"
            )
        self.provenance = {"network": NETWORK, "sha256": read.digest, **read.provenance}
        self._network = read.network(file)

    @cached_property
    def _basis(self) -> tuple[Any, Any, Any]:
        """The patterns, (N, N), their curvatures and their products with K, as tensors."""
        import torch

        rows, curvatures = self.fit.patterns.rows, self.fit.patterns.curvatures
        products = rows @ laplacian(self.hidden.differences)
        each = rows, curvatures.astype(np.float32), products.astype(np.float32)
        return tuple(map(torch.from_numpy, each))

    def prepare(self) -> None:
        """Compute the basis as tensors; see `StillMethod`."""
        super().prepare()
        _ = self._basis

    @of_all
    def solve(self, photograph: Image) -> NoiseAwareReconstruction:
        """Return the hidden image and how it came about; see `reconstruct`."""
        solution = super().solve(photograph)
        problem = problem_of(self, solution)
        return solution if problem is None else replace(solution, image=self._refined(problem))

    def _refined(self, problem: Problem) -> Array:
        """Return the network's image, (R, C, channels)."""
        import torch

        from periscopy_sim.reconstruction.learned.unrolled_network import CHANNELS, Problems

        if len(problem.start) != CHANNELS:
            raise InputError(
                f"{NETWORK} learned from images of {CHANNELS} channels alone: take noise-aware"
            )
        of_photograph = problem.data, problem.weights, problem.errors[None], problem.start
        batch = (torch.from_numpy(each)[None] for each in of_photograph)
        problems = Problems(*self._basis, *batch)
        with torch.inference_mode(), _one_thread():
            image = self._network(problems)[0].numpy().astype(np.float64)
        if self.positive:
            image = np.maximum(image, 0)
        return np.ascontiguousarray(np.moveaxis(image, 0, -1) * problem.scale)

    @of_all
    def report(self, photograph: Image, solution: NoiseAwareReconstruction) -> Report:
        """Return the noise-aware report and the weights; see `StillMethod`.

        There are no standard errors: nobody knows those of a network's additions.
        """
        report = super().report(photograph, solution)
        numbers = {**report.numbers, "weights_sha256": self.provenance["sha256"]}
        return replace(report, numbers=numbers)

    def standard_errors(self, *_: object) -> None:  # type: ignore[override]
        """Return None: nobody knows the standard errors of a network's additions."""
        return


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let PyTorch compute in this thread alone.

    So small a network gains nothing from more, which then spin for milliseconds on the cores that
    the next photograph needs: stills took twice as long.
    """
    import torch

    with _THREADS:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)
