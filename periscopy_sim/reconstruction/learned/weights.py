"""The weights of the unrolled network as a safetensors file, with their provenance.

The file's metadata holds the network's name and settings, the hidden images' size, the SHA-256 of
these and the tensors, and the provenance of the training: data and their digest, seed, steps.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import require

NETWORK = "unrolled"
"""Name of the network in files and on the command line."""

SHIPPED = Path(__file__).with_name(f"{NETWORK}.safetensors")
"""The weights that ship with the package."""

KIND = "periscopy network"


@dataclass(frozen=True, eq=False)
class Weights:
    """Tensors of an `UnrolledNetwork` by name, its settings and its provenance."""

    tensors: Mapping[str, Any]  # by the names of the network's ``state_dict``
    hidden_shape: tuple[int, int]  # (R, C) of the images that it learned from
    settings: Mapping[str, int]  # arguments of `UnrolledNetwork`, such as ``width``
    provenance: Mapping[str, Any]  # data, seed and steps of the training

    @property
    def digest(self) -> str:
        """SHA-256 of name, settings and tensors: their names, types, shapes and bytes."""
        import torch

        kinds = {name: (str(each.dtype), list(each.shape)) for name, each in self.tensors.items()}
        head = [NETWORK, list(self.hidden_shape), dict(self.settings), kinds]
        digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
        for name in sorted(self.tensors):
            values = self.tensors[name].detach().contiguous().cpu().reshape(-1)
            digest.update(values.view(torch.uint8).numpy().tobytes())
        return digest.hexdigest()

    def network(self, file: str | Path) -> Any:
        """Return the network; a PeriscopyError names `file` if the tensors do not fit it."""
        from periscopy_sim.reconstruction.learned.unrolled_network import UnrolledNetwork

        try:
            network = UnrolledNetwork(**self.settings)
            network.load_state_dict(dict(self.tensors))
        except (RuntimeError, TypeError) as error:
            raise PeriscopyError(
                f"{file}: the tensors do not fit the network's settings: {error}"
            ) from error
        return network.requires_grad_(False)


def write_weights(weights: Weights, file: str | Path) -> None:
    """Write a network's weights."""
    require("torch")
    require("safetensors")
    from safetensors.torch import save_file

    metadata = {
        "kind": KIND,
        "network": NETWORK,
        "hidden": "{}x{}".format(*weights.hidden_shape),
        "settings": json.dumps(weights.settings, sort_keys=True),
        "sha256": weights.digest,
        "provenance": json.dumps(weights.provenance, sort_keys=True),
    }
    tensors = {name: each.detach().cpu().contiguous() for name, each in weights.tensors.items()}
    save_file(tensors, Path(file), metadata)


def read_weights(file: str | Path) -> Weights:
    """Read a network's weights.

    A PeriscopyError says that PyTorch or safetensors is not installed, or that the file is missing,
    damaged, or of another kind or network.
    """
    require("torch")
    safetensors = require("safetensors")
    file = Path(file)
    if not file.is_file():
        raise PeriscopyError(f"{file}: no such file of weights; '{NETWORK}' ships with the package")
    try:
        with safetensors.safe_open(file, framework="pt") as opened:
            metadata = opened.metadata() or {}
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    except (safetensors.SafetensorError, OSError) as error:
        raise PeriscopyError(f"{file}: not a whole safetensors file: {error}") from error
    try:
        if (metadata["kind"], metadata["network"]) != (KIND, NETWORK):
            raise ValueError(f"of {metadata['kind']} {metadata['network']}")
        rows, columns = map(int, metadata["hidden"].split("x"))
        settings, provenance = (json.loads(metadata[key]) for key in ("settings", "provenance"))
        weights = Weights(tensors, (rows, columns), dict(settings), dict(provenance))
        recorded = metadata["sha256"]
    except (KeyError, TypeError, ValueError) as error:
        raise PeriscopyError(f"{file}: holds no weights of '{NETWORK}': {error}") from error
    if weights.digest != recorded:
        raise PeriscopyError(
            f"{file}: damaged: its SHA-256 begins with {weights.digest[:12]}, not "
            f"{recorded[:12]}; copy the file again"
        )
    return weights
