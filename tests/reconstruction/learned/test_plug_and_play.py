"""Plug and play and the U-Net: their inverse is P's, their noise K's, their turns a descent."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.noise_aware.solver.spectral_basis import laplacian

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from periscopy_sim.reconstruction.learned.plug_and_play import (  # noqa: E402
    PlugAndPlay,
    inverse_root,
)
from periscopy_sim.reconstruction.learned.unet import (  # noqa: E402
    PostProcessing,
    UNet,
    least_squares,
)
from periscopy_sim.reconstruction.preconditioned.preconditioner import (  # noqa: E402
    form_preconditioner,
)


def test_inverse_before_the_unet_is_the_papers(small, problems):
    given, problem, _ = problems
    P = form_preconditioner(small.A, small.B)
    expected = P.apply(small.photograph.reshape(-1, 3)).T.reshape(3, 4, 5) / problem.scale
    found = least_squares(given)[0].numpy()
    assert found == pytest.approx(expected, rel=1e-2, abs=1e-2 * np.abs(expected).max())


def test_untrained_unet_leaves_the_images_as_they_are(problems):
    given, *_ = problems
    torch.testing.assert_close(PostProcessing()(given), least_squares(given))
    noisy = torch.rand(2, 3, 29, 36)
    torch.testing.assert_close(UNet()(noisy, torch.zeros(2, 1, 29, 36)), noisy)


def test_every_weight_of_the_unet_has_a_gradient_once_the_last_layer_is_not_zero():
    torch.manual_seed(0)
    unet = UNet(width=8)
    torch.nn.init.normal_(unet.last.weight, std=0.1)
    unet(torch.rand(2, 3, 29, 36), torch.ones(2, 1, 29, 36)).square().sum().backward()
    assert all(float(each.grad.abs().sum()) > 0 for each in unet.parameters())


def test_networks_have_about_a_hundred_thousand_weights():
    assert 8e4 < sum(each.numel() for each in UNet().parameters()) < 1.2e5


def test_noise_of_the_denoiser_has_the_inverse_of_the_penalty_for_its_covariance():
    K = torch.tensor(laplacian((3, 4)), dtype=torch.float32)
    white = torch.randn(40_000, 3, 12, generator=torch.Generator().manual_seed(0))
    noise = (white @ inverse_root(K)).reshape(-1, 12)
    covariance = (noise.T @ noise / len(noise)).numpy()
    # 120,000 draws: an entry is known to about 0.4 % of the variances; six of these.
    assert covariance == pytest.approx(np.linalg.inv(K.numpy()), abs=0.025)


def test_turns_without_a_denoiser_end_near_what_explains_the_photograph(problems):
    given, *_ = problems
    network = PlugAndPlay(steps=30)  # untrained: the U-Net changes nothing
    network.log_ratio.fill_(-4.0)
    with torch.inference_mode():
        image = network(given)
    misfit = [
        (given.weights * (given.data / given.weights - given.curvatures * x).square()
         / given.curvatures).sum()
        for x in (coefficients(given, image), coefficients(given, given.start))
    ]  # fmt: skip
    assert misfit[0] < misfit[1]
    torch.testing.assert_close(image, least_squares(given), rtol=0.05, atol=0.05)


def coefficients(given, image):
    return given.axes @ (image.flatten(2) @ given.rows_K.T)
