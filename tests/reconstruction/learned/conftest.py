from dataclasses import dataclass

import numpy as np
import pytest

HIDDEN, PHOTOGRAPH = (4, 5), (12, 12)


@dataclass(frozen=True)
class Small:
    """A, B, a photograph and what was hidden."""

    A: np.ndarray
    B: np.ndarray
    photograph: np.ndarray
    hidden: np.ndarray

    @property
    def settings(self):
        return {"hidden": HIDDEN, "photograph_shape": PHOTOGRAPH}


@pytest.fixture(scope="session")
def small():
    rng = np.random.default_rng(4)
    A, B = rng.uniform(0.1, 1, (144, 20)), rng.uniform(0.1, 1, (144, 2))
    hidden = rng.uniform(0.1, 1, (20, 3))
    y = A @ hidden + B @ rng.uniform(0.5, 1, (2, 3))
    y += rng.normal(0, (0.01, 0.02, 0.04), y.shape)
    return Small(A, B, y.reshape(*PHOTOGRAPH, 3), hidden)


@pytest.fixture(scope="session")
def problems(small):
    """The photograph as networks see it, and what that came from."""
    torch = pytest.importorskip("torch")
    from periscopy_sim.hidden import Hidden
    from periscopy_sim.model.spectral_basis import laplacian
    from periscopy_sim.reconstruction.learned.still import problem_of
    from periscopy_sim.reconstruction.learned.unrolled_network import Problems
    from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

    method = NoiseAware(small.A, small.B, **small.settings, profiles=False, corrections=())
    solution = method.solve(small.photograph)
    problem = problem_of(method, solution)
    patterns = method.fit.patterns
    shared = (
        patterns.rows,
        patterns.curvatures,
        patterns.rows @ laplacian(Hidden.of(HIDDEN).differences),
    )
    own = problem.data, problem.weights, problem.errors[None], problem.start
    tensors = [torch.tensor(each, dtype=torch.float32) for each in shared]
    return Problems(*tensors, *(torch.tensor(each)[None] for each in own)), problem, solution
