"""The network's steps: the first of each in dense algebra, the second none before training."""

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.spectral_basis import laplacian

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from periscopy_sim.reconstruction.learned.unrolled_network import (  # noqa: E402
    UnrolledNetwork,
    proximal_step,
)


def test_what_explains_the_photograph_is_what_dense_normal_equations_say(small, problems):
    given, problem, found = problems
    v = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    ρ = 3.0
    x = proximal_step(given, torch.tensor(v)[None], torch.full((1, 1, 1), ρ))[0].numpy()
    Q, _ = np.linalg.qr(small.B)
    rest = small.A - Q @ (Q.T @ small.A)
    K = laplacian(Hidden.of((4, 5)).differences).toarray()
    for channel in range(3):
        y = small.photograph[..., channel].ravel()
        misfit = (problem.scale / found.noise[channel]) ** 2 * rest.T @ rest
        data = problem.scale / found.noise[channel] ** 2 * rest.T @ y
        expected = np.linalg.solve(misfit + ρ * K, data + ρ * K @ v[channel].ravel())
        assert x[channel].ravel() == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_untrained_network_leaves_the_image_as_it_is(problems):
    given, *_ = problems
    torch.testing.assert_close(UnrolledNetwork()(given), given.start)


def test_every_weight_has_a_gradient_once_the_last_layers_are_not_zero(problems):
    given, *_ = problems
    torch.manual_seed(0)
    network = UnrolledNetwork(steps=2, width=4)
    for learned in network.learned:
        torch.nn.init.normal_(learned[-1].weight, std=0.1)
    network(given).square().sum().backward()
    assert all(float(each.grad.abs().sum()) > 0 for each in network.parameters())
