"""The network's steps against dense algebra, its image, and the shipped weights."""

import json

import numpy as np
import pytest

import periscopy_sim as ps

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from experiments.learned import unrolled  # noqa: E402
from periscopy_sim.hidden import Hidden  # noqa: E402
from periscopy_sim.model.spectral_basis import laplacian  # noqa: E402

FILE = "experiments/learned/unrolled.py:Unrolled"
SHAPE = 4, 5
RNG = np.random.default_rng(4)
A, B = RNG.uniform(0.1, 1, (144, 20)), RNG.uniform(0.1, 1, (144, 2))
Y = A @ RNG.uniform(0.1, 1, (20, 3)) + B @ RNG.uniform(0.5, 1, (2, 3))
Y = (Y + RNG.normal(0, (0.01, 0.02, 0.04), Y.shape)).reshape(12, 12, 3)


@pytest.fixture(scope="module")
def problems():
    """The photograph as networks see it, and what that came from."""
    method = ps.NoiseAware(
        A, B, hidden=SHAPE, photograph_shape=(12, 12), profiles=False, corrections=()
    )
    solution = method.solve(Y)
    problem = unrolled.problem_of(method, solution)
    stack = problem.data, problem.weights, problem.errors[None], problem.start
    of_all = unrolled.Problems.of(method.fit.patterns, *(each[None] for each in stack))
    return of_all, problem, solution


def test_what_explains_the_photograph_is_what_dense_normal_equations_say(problems):
    given, problem, solution = problems
    v = np.random.default_rng(0).random((3, *SHAPE)).astype(np.float32)
    ρ = 3.0
    step = unrolled.proximal_step(given, torch.tensor(v)[None], torch.full((1, 1, 1), ρ))
    Q, _ = np.linalg.qr(B)
    rest = A - Q @ (Q.T @ A)
    K = laplacian(Hidden.of(SHAPE).differences).toarray()
    for channel, x in enumerate(step[0].numpy()):
        y = Y[..., channel].ravel()
        misfit = (problem.scale / solution.noise[channel]) ** 2 * rest.T @ rest
        data = problem.scale / solution.noise[channel] ** 2 * rest.T @ y
        expected = np.linalg.solve(misfit + ρ * K, data + ρ * K @ v[channel].ravel())
        assert x.ravel() == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_every_weight_has_a_gradient_once_the_last_layers_are_not_zero(problems):
    given, *_ = problems
    torch.manual_seed(0)
    network = unrolled.UnrolledNetwork(steps=2, width=4)
    torch.testing.assert_close(network(given), given.start)
    for learned in network.learned:
        torch.nn.init.normal_(learned[-1].weight, std=0.1)
    network(given).square().sum().backward()
    assert all(float(each.grad.abs().sum()) > 0 for each in network.parameters())


@pytest.fixture(scope="module", name="scene")
def coarse():
    return ps.load_scenario("chair", unrolled.HIDDEN, {"resolution": 48})


def lit(scene, seed=0, name="mushroom", **moved):
    """A hidden image and a photograph of it, with the scene's numbers moved."""
    truth = scene.image(name)
    y = (scene.at(**moved).A @ truth.reshape(-1, 3)).reshape(48, 48, 3)
    return truth, ps.add_noise(y / y.mean(), snr=60, seed=seed)


@pytest.mark.usefixtures("jit")
def test_untrained_weights_give_the_noise_aware_image_in_any_unit_and_mask(scene, tmp_path):
    file, mask = tmp_path / "mine.npz", np.ones((48, 48), bool)
    unrolled.write_weights(unrolled.UnrolledNetwork().state_dict(), {"seed": 1}, file)
    mask[10:20, 5:9] = False
    _, y = lit(scene)
    method = unrolled.Unrolled(scene, scene.A, scene.B, mask, file)
    plain = ps.NoiseAware.for_scene(scene, scene.A, scene.B)
    expected = plain.reconstruct(ps.Photograph(y, mask))
    for unit in (1.0, 3e4):
        image = method.reconstruct(unit * np.where(mask[..., None], y, 0))
        assert image == pytest.approx(unit * expected, rel=1e-3, abs=unit * 1e-4)
    assert not method.reconstruct(0 * y).any()
    with pytest.raises(ValueError, match="3 channels"):
        method.reconstruct(y[..., :1])


@pytest.mark.usefixtures("jit")
def test_shipped_weights_gain_on_a_scene_that_a_ruler_got_wrong(scene):
    gained = []
    for seed, name in enumerate(("still_life", "sunset", "mushroom")):
        truth, y = lit(scene, seed, name, occluder_dx=0.004, occluder_dz=-0.004)
        images = (scene.method(each, y).reconstruct(y) for each in (FILE, "noise-aware"))
        mine, plain = (ps.registered(image, truth).psnr for image in images)
        gained.append(mine - plain)
    assert np.mean(gained) > 0, gained
    with np.load(unrolled.WEIGHTS) as held:
        provenance = json.loads(str(held["provenance"]))
    assert {"data", "samples_sha256", "photographs", "seed", "training_steps"} <= {*provenance}


def test_another_size_is_refused_by_name():
    scene = ps.load_scenario("chair", SHAPE, {"resolution": 12})
    with pytest.raises(ps.PeriscopyError, match="29x36"):
        scene.method(FILE, np.ones((12, 12, 3)))
