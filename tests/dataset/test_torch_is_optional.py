import sys

import pytest

import periscopy_sim as ps


def test_name_is_public_without_pytorch_and_making_one_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    assert "TorchDataset" in ps.__all__ and hasattr(ps, "TorchDataset")
    with pytest.raises(ps.PeriscopyError, match=r"pip install -e '\.\[torch\]'"):
        ps.TorchDataset("data.zarr")
