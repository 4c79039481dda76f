"""Train a small network on a data set, as proof that the loader feeds it.

`python -m experiments.studies.dataset_training DATA --out DIR [--seconds 60]` needs PyTorch. The
network knows nothing of light transport. It sees one colour channel of a photograph, pooled, what a
quadratic function of the place explains of it taken out, and is to give that channel's hidden image
in the photograph's units (`signal_scale` f). Its error on geometries that it has not seen stands
beside that of the mean hidden image.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from torch import nn
from torch.utils.data import DataLoader

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, show_light, styled
from periscopy_sim.storage.outputs.staging import staged_file

SHOWN = 6

POOLED = 42
"""Pixels a side that the network sees."""

UNIT = 1e-3
"""Of scaled hidden images: A's entries are small."""


def main(
    data: Annotated[Path, typer.Argument(help="A data set.")],
    out: Annotated[Path, typer.Option(help="Folder for the result and its picture.")],
    seconds: Annotated[float, typer.Option(help="Time to train.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the weights and of the order.")] = 0,
) -> None:
    """Train, test, and draw."""
    torch.manual_seed(seed)
    variables = ("photograph", "hidden", "signal_scale")
    train, test = (ps.TorchDataset(data, split, variables) for split in ("train", "test"))
    batches = DataLoader(
        train, 64, shuffle=True, num_workers=1, generator=torch.Generator().manual_seed(seed)
    )
    hidden_shape = tuple(train[0]["hidden"].shape[1:])
    network = Network(hidden_shape)
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    start = time.perf_counter()
    seen, losses, waited = 0, [], 0.0
    while time.perf_counter() - start < seconds:
        asked = time.perf_counter()
        for batch in batches:
            waited += time.perf_counter() - asked
            found, contrast = network(batch["photograph"])
            loss = nn.functional.mse_loss(found, scaled(batch) / contrast)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            seen += len(found)
            losses.append(float(loss.detach()))
            asked = time.perf_counter()
            if asked - start > seconds:
                break
    took = time.perf_counter() - start
    mean = torch.stack([train[k]["hidden"] for k in range(0, len(train), 10)]).mean(dim=0)
    errors: dict[str, list[float]] = {"network": [], "mean image": []}
    pictures = []
    with torch.no_grad():
        for batch in DataLoader(test, 64):
            found, contrast = network(batch["photograph"])
            image = found * contrast / batch["signal_scale"][:, None, None, None] / UNIT
            for name, guess in {"network": image, "mean image": mean}.items():
                squared = (guess - batch["hidden"]).square().mean(dim=(1, 2, 3))
                errors[name] += squared.tolist()
            if not pictures:
                shown = (batch["photograph"], batch["hidden"], image.float())
                pictures = [picture(part[:SHOWN]) for part in shown]
    result = {
        "samples trained on": seen,
        "samples a second": round(seen / took, 1),
        "share of the time spent waiting for data": round(waited / took, 3),
        "loss, first and last 20 batches": [
            round(float(np.mean(part)), 5) for part in (losses[:20], losses[-20:])
        ],
        "mean squared error on unseen geometries": {
            name: round(float(np.mean(values)), 5) for name, values in errors.items()
        },
        "test samples": len(test),
    }
    print(json.dumps(result, indent=2))
    out.mkdir(parents=True, exist_ok=True)
    with staged_file(out / "training.json") as file:
        file.write_text(json.dumps(result, indent=2) + "\n", "utf-8")
    with styled(), drawn(out, "training", PAGE, 3.4) as figure:
        names = ("photograph", "hidden image", "network")
        for line, name, images in zip(figure.subplots(3, SHOWN), names, pictures, strict=True):
            for ax, image in zip(line, images, strict=True):
                show_light(ax, image, None if name == "photograph" else 1.0)
            line[0].set_ylabel(name)


class Network(nn.Module):
    """From a photograph to scaled hidden images, channel by channel.

    Parameters
    ----------
    hidden_shape
        (R, C).
    """

    def __init__(self, hidden_shape: tuple[int, ...]) -> None:
        super().__init__()
        place = torch.linspace(-1, 1, POOLED, dtype=torch.float64)
        y, x = (axis.ravel() for axis in torch.meshgrid(place, place, indexing="ij"))
        smooth = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], dim=1)
        self.register_buffer("smooth", torch.linalg.qr(smooth)[0].float())
        self.linear = nn.Linear(POOLED**2, int(np.prod(hidden_shape)))
        self.deep = nn.Sequential(
            nn.Linear(POOLED**2, 512), nn.ReLU(), nn.Linear(512, self.linear.out_features)
        )
        self.hidden_shape = hidden_shape

    def forward(self, photograph: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return images over a channel's contrast, and that contrast, (K, 3, 1, 1)."""
        y = nn.functional.adaptive_avg_pool2d(photograph, POOLED).flatten(2)
        y = y - (y @ self.smooth) @ self.smooth.T
        contrast = y.std(dim=2, keepdim=True) + 1e-6
        y = y / contrast
        image = (self.linear(y) + self.deep(y)).unflatten(2, self.hidden_shape)
        return image, contrast[..., None]


def scaled(batch: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return hidden images in units of their photographs, of numbers near 1."""
    return UNIT * batch["signal_scale"][:, None, None, None].float() * batch["hidden"]


def picture(tensor: Any) -> Any:
    """Turn tensors into images, channels last, without negatives."""
    return np.clip(np.moveaxis(tensor.numpy(), 1, -1), 0, None)


if __name__ == "__main__":
    typer.run(main)
