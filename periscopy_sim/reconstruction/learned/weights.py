"""What a network learned, as a file: safetensors, with what it learned from.

The file's metadata holds which network it is, its settings, the hidden images' size, the SHA-256
of these and the tensors, and the provenance of the training: data and their digest, seed, steps.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.extras import require

NETWORKS: Mapping[str, str] = {
    "unrolled": "unrolled_network:UnrolledNetwork",
    "unet": "unet:PostProcessing",
    "plug-and-play": "plug_and_play:PlugAndPlay",
}
"""``module:class`` of each: it takes `Problems`, gives images; weights of each ship."""

KIND = "periscopy network"


def shipped(network: str) -> Path:
    """Return the file of the weights that ship with the package."""
    return Path(__file__).with_name(f"{network}.safetensors")


def new_network(network: str, settings: Mapping[str, int]) -> Any:
    """Return an untrained network by its name; a KeyError or TypeError tells of a wrong one."""
    module, _, name = NETWORKS[network].partition(":")
    place = import_module(f"periscopy_sim.reconstruction.learned.{module}")
    return getattr(place, name)(**settings)


@dataclass(frozen=True, eq=False)
class Weights:
    """A network's tensors by name, and what is known of them.

    Attributes
    ----------
    network
        Name in `NETWORKS`.
    tensors
        By the names of the network's ``state_dict``.
    hidden_shape
        (R, C) of the images that it learned from.
    settings
        Arguments of the network's class, such as ``width``.
    provenance
        What it learned from, and how.
    """

    network: str
    tensors: Mapping[str, Any]
    hidden_shape: tuple[int, int]
    settings: Mapping[str, int]
    provenance: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of what the network is and of its tensors: names, types, shapes and bytes."""
        import torch

        kinds = {name: (str(each.dtype), list(each.shape)) for name, each in self.tensors.items()}
        head = [self.network, list(self.hidden_shape), dict(self.settings), kinds]
        found = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
        for name in sorted(self.tensors):
            values = self.tensors[name].detach().contiguous().cpu().reshape(-1)
            found.update(values.view(torch.uint8).numpy().tobytes())
        return found.hexdigest()

    def trained(self, file: str | Path) -> Any:
        """Return the network; a PeriscopyError tells of weights of `file` that do not fit it."""
        try:
            network = new_network(self.network, self.settings)
            network.load_state_dict(dict(self.tensors))
        except (RuntimeError, TypeError) as error:
            raise PeriscopyError(
                f"{file}: holds other tensors than its settings ask for: {error}"
            ) from error
        return network.requires_grad_(False)

    def check_size(self, hidden_shape: tuple[int, int], file: str | Path) -> None:
        """Refuse a scene of another size than the network learned from, by a ValueError."""
        if tuple(hidden_shape) != self.hidden_shape:
            known, wanted = ("{}x{}".format(*shape) for shape in (self.hidden_shape, hidden_shape))
            raise ValueError(
                f"the weights {Path(file).name} ({self.digest[:12]}) learned from hidden images of "
                f"{known} patches, the scene has {wanted}: load the scene with hidden {known}, or "
                "train others by experiments.learned"
            )


def write_weights(weights: Weights, file: str | Path) -> None:
    """Write a network's weights."""
    require("torch")
    require("safetensors")
    from safetensors.torch import save_file

    metadata = {
        "kind": KIND,
        "network": weights.network,
        "hidden": "{}x{}".format(*weights.hidden_shape),
        "settings": json.dumps(weights.settings, sort_keys=True),
        "sha256": weights.digest,
        "provenance": json.dumps(weights.provenance, sort_keys=True),
    }
    tensors = {name: each.detach().cpu().contiguous() for name, each in weights.tensors.items()}
    save_file(tensors, Path(file), metadata)


def read_weights(file: str | Path) -> Weights:
    """Read a network's weights.

    Raises
    ------
    PeriscopyError
        If PyTorch or safetensors is not installed, or the file is missing, damaged, or something
        else.
    """
    require("torch")
    safetensors = require("safetensors")
    file = Path(file)
    if not file.is_file():
        guess = did_you_mean(str(file), NETWORKS)
        raise PeriscopyError(
            f"{file}: no such file of weights; {guess} {', '.join(NETWORKS)} ship with the package"
        )
    try:
        with safetensors.safe_open(file, framework="pt") as opened:
            metadata = opened.metadata() or {}
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    except (safetensors.SafetensorError, OSError) as error:
        raise PeriscopyError(f"{file}: is damaged, or no safetensors file: {error}") from error
    if metadata.get("kind") != KIND:
        raise PeriscopyError(f"{file}: holds no {KIND}; give what experiments.learned.train wrote")
    try:
        rows, _, columns = metadata["hidden"].partition("x")
        weights = Weights(
            metadata["network"],
            tensors,
            (int(rows), int(columns)),
            dict(json.loads(metadata["settings"])),
            dict(json.loads(metadata["provenance"])),
        )
        recorded = metadata["sha256"]
    except (KeyError, TypeError, ValueError) as error:
        raise PeriscopyError(f"{file}: is damaged: its head lacks {error}") from error
    if weights.network not in NETWORKS:
        raise PeriscopyError(
            f"{file}: holds a network '{weights.network}', which this version does not know; it "
            f"knows {', '.join(NETWORKS)}"
        )
    if weights.digest != recorded:
        raise PeriscopyError(
            f"{file}: is damaged: its SHA-256 begins with {weights.digest[:12]}, recorded "
            f"is {recorded[:12]}; get the file anew"
        )
    return weights
