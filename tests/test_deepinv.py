import importlib
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.testing import adjoint_test

SIZES = {"photograph_shape": (8, 9), "hidden": (3, 4)}


def test_without_deepinv_one_line_says_what_to_install(monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.delitem(sys.modules, "periscopy_sim.deepinv", raising=False)
    monkeypatch.setitem(sys.modules, "deepinv", None)
    with pytest.raises(PeriscopyError, match=r"pip install -e '\.\[deepinv\]'"):
        importlib.import_module("periscopy_sim.deepinv")


@pytest.fixture(name="make")
def making():
    pytest.importorskip("deepinv", exc_type=ImportError)
    from periscopy_sim.deepinv import Periscopy

    rng = np.random.default_rng(0)
    A, B = rng.random((72, 12)), rng.random((72, 5))

    def make(unit=1, B=B, gain=(1.0, 1.0, 1.0), **more):
        scene = SimpleNamespace(**SIZES, channel_gain=gain)
        return Periscopy(unit * A, scene, backgrounds=B, **more)

    return make


@pytest.mark.torch
def test_adjoint_is_that_of_the_product_and_backgrounds_leave_no_trace(make):
    import torch

    physics = make()
    shapes = (2, 3, 3, 4), (2, 3, 8, 9)
    adjoint_test((physics.A, physics.A_adjoint), shapes, rtol=1e-12, convert=torch.from_numpy)
    assert torch.autograd.gradcheck(physics.A, torch.rand(shapes[0]).double().requires_grad_())
    B = np.random.default_rng(0)
    B.random((72, 12))
    light = torch.as_tensor(B.random((72, 5))[:, 2].reshape(8, 9)).expand(1, 3, 8, 9)
    assert physics.reject_backgrounds(light).abs().max() < 1e-10


@pytest.mark.torch
@pytest.mark.parametrize("more", [{}, {"B": None}], ids=["backgrounds", "none"])
def test_operator_has_norm_1_whatever_the_unit_of_light(make, more):
    import torch

    physics = make(unit=1e-3, gain=(1.2, 1.0, 0.8), snr=None, **more)
    x = torch.rand(1, 3, 3, 4).double()
    jacobian = torch.autograd.functional.jacobian(physics.A, x).reshape(3 * 72, 3 * 12)
    assert float(torch.linalg.matrix_norm(jacobian, 2)) == pytest.approx(1, rel=1e-6)
    assert float(physics.compute_sqnorm(x, verbose=False)) == pytest.approx(1, rel=0.01)
    assert float((physics.A_dagger(physics(x)) - x).norm() / x.norm()) < 0.05
    with pytest.raises(TypeError, match="sigma"):
        physics(x, sigma=5)


@pytest.mark.torch
def test_light_and_noise_are_at_their_ratios(make):
    import torch

    ambient = np.random.default_rng(1).random((8, 9, 3))
    x = torch.rand(500, 3, 3, 4).double()
    clean = make(B=None, snr=None)(x)
    lit = make(B=None, snr=None, ambient=ambient, sbr=0.5)(x)
    assert torch.allclose(
        clean.mean((1, 2, 3)) / (lit - clean).mean((1, 2, 3)), torch.tensor(0.5).double()
    )
    noisy = make(B=None, snr=20, ambient=ambient, sbr=0.5)(x)
    ratio = (noisy - lit).square().mean() / lit.square().mean()
    assert float(ratio) == pytest.approx(0.01, rel=0.03)
    again = make(B=None, snr=20, ambient=ambient, sbr=0.5)(x)
    assert torch.equal(noisy, again)


@pytest.mark.torch
def test_light_and_noise_are_of_the_photograph_before_backgrounds_are_projected_out(make):
    import torch

    ambient = np.random.default_rng(1).random((8, 9, 3))
    x = torch.rand(500, 3, 3, 4).double()
    whole, left = make(B=None, snr=20, ambient=ambient, sbr=0.5), make(snr=20, ambient=ambient)
    y = left(x)
    photographs = whole.norm * whole(x)  # with the same noise, of the same seed
    assert torch.allclose(y, left.reject_backgrounds(photographs / left.norm))
    assert float(left.reject_backgrounds(y).sub(y).abs().max()) < 1e-12


@pytest.mark.torch
@pytest.mark.parametrize("given", [{"sbr": 0.0}, {"snr": np.inf}, {"ambient": np.ones((2, 2, 3))}])
def test_bad_numbers_are_refused(make, given):
    with pytest.raises(ValueError, match=r"snr|sbr|ambient light is"):
        make(**given)
