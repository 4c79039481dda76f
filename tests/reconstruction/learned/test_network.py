"""The network's steps: the first of each in dense algebra, the second none before training."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.learned.problem import problem_of
from periscopy_sim.reconstruction.noise_aware.solver.spectral_basis import laplacian
from periscopy_sim.reconstruction.noise_aware.still import NoiseAware

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from periscopy_sim.reconstruction.learned.proximal_step import Problems, explained  # noqa: E402
from periscopy_sim.reconstruction.learned.unrolled_network import UnrolledNetwork  # noqa: E402


def problems_of(small):
    method = NoiseAware(small.A, small.B, **small.settings, wall_gain=False)
    found = method.solve(small.photograph)
    problem = problem_of(method, found)
    rows = method._basis.rows
    patterns = rows, method._basis.curvatures.astype(np.float32), rows @ laplacian((4, 5))
    own = problem.axes, problem.data, problem.weights, problem.errors[None], problem.start
    tensors = [torch.tensor(each, dtype=torch.float32) for each in patterns]
    return Problems(*tensors, *(torch.tensor(each)[None] for each in own)), problem, found


def test_what_explains_the_photograph_is_what_dense_normal_equations_say(small):
    problems, problem, found = problems_of(small)
    v = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    ρ = 3.0
    x = explained(problems, torch.tensor(v)[None], torch.full((1, 1, 1), ρ))[0].numpy()
    Q, _ = np.linalg.qr(small.B)
    rest = small.A - Q @ (Q.T @ small.A)
    K = laplacian((4, 5))
    for channel in range(3):
        y = small.photograph[..., channel].ravel()
        misfit = (problem.scale / found.noise[channel]) ** 2 * rest.T @ rest
        data = problem.scale / found.noise[channel] ** 2 * rest.T @ y
        expected = np.linalg.solve(misfit + ρ * K, data + ρ * K @ v[channel].ravel())
        assert x[channel].ravel() == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_axes_of_colour_turn_the_photograph_and_the_image_alike(small):
    problems, *_ = problems_of(small)
    turned, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn = torch.tensor(turned, dtype=torch.float32)[None]
    alike = torch.ones_like(problems.weights) * 50
    same = Problems(*patterns(problems), turn, turn @ problems.data, alike, *rest(problems))
    straight = Problems(
        *patterns(problems), torch.eye(3)[None], problems.data, alike, *rest(problems)
    )
    ρ = torch.full((1, 1, 1), 2.0)
    images = [explained(each, problems.start, ρ) for each in (same, straight)]
    torch.testing.assert_close(*images, rtol=1e-4, atol=1e-4)


def patterns(problems):
    return problems.rows, problems.curvatures, problems.rows_K


def rest(problems):
    return problems.errors, problems.start


def test_untrained_network_leaves_the_image_as_it_is(small):
    problems, *_ = problems_of(small)
    torch.testing.assert_close(UnrolledNetwork()(problems), problems.start)


def test_every_weight_has_a_gradient_once_the_last_layers_are_not_zero(small):
    problems, *_ = problems_of(small)
    torch.manual_seed(0)
    network = UnrolledNetwork(steps=2, width=4)
    for learned in network.learned:
        torch.nn.init.normal_(learned[-1].weight, std=0.1)
    network(problems).square().sum().backward()
    assert all(float(each.grad.abs().sum()) > 0 for each in network.parameters())


def test_it_has_about_a_hundred_thousand_weights():
    assert 8e4 < sum(each.numel() for each in UnrolledNetwork().parameters()) < 1.2e5
