"""The light transport on tensors: as NumPy's, with right derivatives; and without PyTorch."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.adapters import TorchTransport
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.testing import adjoint_test

SCENE = SimpleNamespace(photograph_shape=(5, 6), hidden=(3, 4), channel_gain=[1.2, 1.0, 0.8])


@pytest.fixture(name="A")
def matrix():
    return np.random.default_rng(0).random((30, 12))


def test_without_pytorch_one_line_says_what_to_install(A, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(PeriscopyError, match=r"pip install -e '\.\[torch\]'"):
        TorchTransport(A)


@pytest.mark.torch
def test_products_are_those_of_numpy_and_of_each_other(A):
    torch = pytest.importorskip("torch")
    transport = TorchTransport(A, SCENE)
    x = torch.rand(2, 3, 3, 4, dtype=torch.float64)
    expected = 1.2 * A @ x[1, 0].numpy().ravel()
    np.testing.assert_allclose(transport(x)[1, 0].numpy().ravel(), expected)
    shapes = (2, 3, 3, 4), (2, 3, 5, 6)
    adjoint_test(transport, shapes, rtol=1e-12, convert=torch.from_numpy)
    assert transport.to(dtype=torch.float32)(x.float()).dtype == torch.float32


@pytest.mark.torch
def test_derivatives_agree_with_differences(A):
    torch = pytest.importorskip("torch")
    transport = TorchTransport(A, SCENE)
    x = torch.rand(3, 3, 4, dtype=torch.float64, requires_grad=True)
    y = torch.rand(3, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(transport, x)
    assert torch.autograd.gradcheck(transport.adjoint, y)


@pytest.mark.torch
def test_channels_last_is_refused(A):
    torch = pytest.importorskip("torch")
    with pytest.raises(ValueError, match=r"\(\.\.\., 3, 3, 4\), not \(3, 4, 3\)"):
        TorchTransport(A, SCENE)(torch.zeros(3, 4, 3))
