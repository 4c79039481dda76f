"""Train a small network on a data set, as proof that the loader feeds it.

`python -m experiments.dataset_training DATA --out DIR [--seconds 60]` needs PyTorch. The network
knows nothing of light transport: it sees the photograph, pooled, and is to give the hidden image.
Its error on geometries that it has not seen stands beside that of the mean hidden image.
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
from periscopy_sim.storage.output import staged_file

SHOWN = 6


def main(
    data: Annotated[Path, typer.Argument(help="A data set.")],
    out: Annotated[Path, typer.Option(help="Folder for the result and its picture.")],
    seconds: Annotated[float, typer.Option(help="Time to train.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the weights and of the order.")] = 0,
) -> None:
    """Train, test, and draw."""
    torch.manual_seed(seed)
    train = ps.TorchDataset(data, "train")
    test = ps.TorchDataset(data, "test")
    batches = DataLoader(
        train, 64, shuffle=True, num_workers=1, generator=torch.Generator().manual_seed(seed)
    )
    hidden_shape = tuple(train[0]["hidden"].shape)
    network = build(hidden_shape)
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    start = time.perf_counter()
    seen, losses, waited = 0, [], 0.0
    while time.perf_counter() - start < seconds:
        asked = time.perf_counter()
        for batch in batches:
            waited += time.perf_counter() - asked
            loss = nn.functional.mse_loss(network(batch["photograph"]), batch["hidden"])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            seen += len(batch["hidden"])
            losses.append(float(loss.detach()))
            asked = time.perf_counter()
            if asked - start > seconds:
                break
    took = time.perf_counter() - start
    mean = torch.stack([train[k]["hidden"] for k in range(0, len(train), 10)]).mean(dim=0)
    network.eval()
    errors: dict[str, list[float]] = {"network": [], "mean image": []}
    pictures = []
    with torch.no_grad():
        for batch in DataLoader(test, 64):
            found = network(batch["photograph"])
            for name, image in {"network": found, "mean image": mean}.items():
                squared = (image - batch["hidden"]).square().mean(dim=(1, 2, 3))
                errors[name] += squared.tolist()
            if not pictures:
                pictures = [picture(part[:SHOWN]) for part in (batch["photograph"], batch["hidden"],
                                                               found)]  # fmt: skip
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


def build(hidden_shape: tuple[int, ...]) -> nn.Module:
    """Give a network from a photograph, channels first, to the hidden image."""
    return nn.Sequential(
        nn.AdaptiveAvgPool2d(42),
        nn.InstanceNorm2d(3),
        nn.Flatten(),
        nn.Linear(3 * 42 * 42, 512),
        nn.ReLU(),
        nn.Linear(512, int(np.prod(hidden_shape))),
        nn.Unflatten(1, hidden_shape),
    )


def picture(tensor: Any) -> Any:
    """Turn tensors into images, channels last, without negatives."""
    return np.clip(np.moveaxis(tensor.numpy(), 1, -1), 0, None)


if __name__ == "__main__":
    typer.run(main)
