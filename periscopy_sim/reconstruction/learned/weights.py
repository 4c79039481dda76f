"""What the unrolled network learned, as a file: safetensors, with what it learned from.

The file's metadata holds the hidden images' size, the network's steps and width, the SHA-256 of the
tensors' bytes, and the provenance of the training: data and their digest, seed, steps, versions.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import require

SHIPPED = Path(__file__).with_name("unrolled.safetensors")

KIND = "periscopy unrolled network"


@dataclass(frozen=True, eq=False)
class Weights:
    """A network's tensors by name, and what is known of them.

    Attributes
    ----------
    tensors
        By the names of `UnrolledNetwork.state_dict`.
    hidden_shape
        (R, C) of the images that it learned from.
    steps, width
        Of the network.
    provenance
        What it learned from, and how.
    """

    tensors: Mapping[str, Any]
    hidden_shape: tuple[int, int]
    steps: int
    width: int
    provenance: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of the tensors' names and bytes."""
        found = hashlib.sha256()
        for name in sorted(self.tensors):
            found.update(name.encode())
            found.update(self.tensors[name].detach().contiguous().cpu().numpy().tobytes())
        return found.hexdigest()

    def network(self, file: str | Path = SHIPPED) -> Any:
        """Return the `UnrolledNetwork`; a PeriscopyError tells of weights that do not fit it."""
        from periscopy_sim.reconstruction.learned.network import UnrolledNetwork

        network = UnrolledNetwork(self.steps, self.width)
        try:
            network.load_state_dict(dict(self.tensors))
        except RuntimeError as error:
            raise PeriscopyError(
                f"{file}: holds other tensors than its steps and width ask for: {error}"
            ) from error
        return network.requires_grad_(False)

    def check_size(self, hidden_shape: tuple[int, int], file: str | Path = SHIPPED) -> None:
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
        "hidden": "{}x{}".format(*weights.hidden_shape),
        "steps": str(weights.steps),
        "width": str(weights.width),
        "sha256": weights.digest,
        "provenance": json.dumps(weights.provenance, sort_keys=True),
    }
    tensors = {name: each.detach().cpu().contiguous() for name, each in weights.tensors.items()}
    save_file(tensors, Path(file), metadata)


def read_weights(file: str | Path = SHIPPED) -> Weights:
    """Read a network's weights; those that ship with the package by default.

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
        raise PeriscopyError(f"{file}: no such file of weights")
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
            tensors,
            (int(rows), int(columns)),
            int(metadata["steps"]),
            int(metadata["width"]),
            json.loads(metadata["provenance"]),
        )
        recorded = metadata["sha256"]
    except (KeyError, ValueError) as error:
        raise PeriscopyError(f"{file}: is damaged: its head lacks {error}") from error
    if weights.digest != recorded:
        raise PeriscopyError(
            f"{file}: is damaged: its tensors' SHA-256 begins with {weights.digest[:12]}, recorded "
            f"is {recorded[:12]}; get the file anew"
        )
    return weights
