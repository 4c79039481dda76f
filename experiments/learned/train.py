"""Train the unrolled network: `python -m experiments.learned.train SAMPLES --out DIR`.

The training takes what `samples` wrote, one or two cores and an hour, prints its progress and
continues a stopped run: `unrolled.pt` holds the network, the optimizer and the curves so far. At
the end it writes `unrolled.npz`, the weights of the least validation error, with their
provenance, and draws `unrolled.png`, the learning curves.

The loss is the mean logarithm of each image's mean squared error, as decibels are, after each
channel's best gain as in the metrics (`matched`). For photographs in the scene as it is, where
brightness is known, half of the loss is without the gain.
"""

import json
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from torch.nn.utils import clip_grad_norm_

from experiments.drawing import PAGE, drawn
from experiments.learned.samples import Samples
from experiments.learned.unrolled import HIDDEN, Problems, UnrolledNetwork, write_weights
from periscopy_sim.hidden import Hidden
from periscopy_sim.model.spectral_basis import SpectralBasis
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import sha256_of

BATCH = 16
RATE = 1e-3
GOOD = 5e-4
"""Mean squared error, over the image's mean square, below which less counts little."""
CHECKED = 500
"""Steps between two looks at the validation error."""
RIGHT = 0.6
"""Share of batches that are of scenes as they are."""
NAME = "unrolled"
"""Of the files that the training writes."""


@dataclass
class Curves:
    """Steps, and in dB the training loss and the validation error, beside the noise-aware one."""

    step: list[int] = field(default_factory=list)
    training: list[float] = field(default_factory=list)
    right: list[float] = field(default_factory=list)
    ruler: list[float] = field(default_factory=list)
    seconds: float = 0.0


def matched(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return images, (K, 3, R, C), without negatives, each channel times its best gain."""
    positive = image.clamp(min=0)
    energy = positive.square().sum(dim=(2, 3), keepdim=True)
    gain = (positive * truth).sum(dim=(2, 3), keepdim=True) / energy.clamp(min=1e-12)
    return gain * positive


def error(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return the mean squared error of each image, (K,), in dB below 1."""
    return 10 * torch.log10((image - truth).square().mean(dim=(1, 2, 3)) + GOOD)


def loss_of(image: torch.Tensor, truth: torch.Tensor, right: bool) -> torch.Tensor:
    """Return the loss of the module."""
    loss = error(matched(image, truth), truth).mean()
    return (loss + error(image, truth).mean()) / 2 if right else loss


class Geometry:
    """The samples of one file as tensors."""

    def __init__(self, samples: Samples, right: bool) -> None:
        self.right = right
        patterns = SpectralBasis(samples.curvatures, samples.rows, Hidden.of(HIDDEN))
        stacks = samples.data, samples.weights, samples.errors[:, None], samples.start
        self.all = Problems.of(patterns, *stacks)
        self.truth = torch.from_numpy(samples.truth)

    def problems(self, chosen: Any, colours: Any = None) -> tuple[Problems, torch.Tensor]:
        """Return chosen photographs and their truths, the colours in another order if given."""
        stacks = self.all.data, self.all.weights, self.all.errors, self.all.start
        data, weights, errors, start = (each[chosen] for each in stacks)
        truth = self.truth[chosen]
        if colours is not None:
            data, weights = data[:, colours], weights[:, colours]
            start, truth = start[:, colours], truth[:, colours]
        own = replace(self.all, data=data, weights=weights, errors=errors, start=start)
        return own, truth


def validation(network: torch.nn.Module | None, geometries: list[Geometry]) -> float:
    """Return the mean error in dB of a network, or of the images that it starts from."""
    errors = []
    with torch.inference_mode():
        for geometry in geometries:
            problems, truth = geometry.problems(slice(None))
            image = problems.start if network is None else network(problems)
            errors.append(error(matched(image, truth), truth).mean())
    return float(torch.stack(errors).mean())


def read_geometries(folder: Path, split: str) -> list[Geometry]:
    """Return the geometries of a split."""
    files = sorted(folder.glob("*.npz"))
    samples = ((file, Samples.read(file)) for file in files)
    return [Geometry(each, file.stem.endswith("right")) for file, each in samples
            if each.split == split]  # fmt: skip


def main(
    samples: Annotated[Path, typer.Argument(help="What experiments.learned.samples wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for the weights and the curves.")],
    steps: Annotated[int, typer.Option(help="Steps of the optimizer.")] = 12_000,
    threads: Annotated[int, typer.Option(help="Processor cores.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the network and of the order.")] = 0,
) -> None:
    """Train, or go on."""
    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    learner = UnrolledNetwork().to(memory_format=torch.channels_last)  # a fifth less time
    optimizer = torch.optim.Adam(learner.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps, 1e-5)
    curves, best, least, first = Curves(), learner.state_dict(), np.inf, 0
    state, samples_sha256 = out / f"{NAME}.pt", sha256_of(sorted(samples.glob("*.npz")))
    if state.is_file():
        held = torch.load(state, weights_only=True)
        if held["steps"] != steps or held["seed"] != seed:
            raise SystemExit(f"{state}: is of {held['steps']} steps and seed {held['seed']}; give "
                             "these, or another --out")  # fmt: skip
        if held["samples_sha256"] != samples_sha256:
            raise SystemExit(f"{state}: learned from other samples; name another --out")
        learner.load_state_dict(held["network"])
        optimizer.load_state_dict(held["optimizer"])
        schedule.load_state_dict(held["schedule"])
        curves, best, least, first = Curves(**held["curves"]), held["best"], *held["at"]
    train, validate = (read_geometries(samples, split) for split in ("train", "validation"))
    right, ruler = ([g for g in train if g.right is kind] for kind in (True, False))
    known = {kind: [g for g in validate if g.right is kind] for kind in (True, False)}
    starts = {kind: validation(None, known[kind]) for kind in known}
    print(f"noise-aware: {starts[True]:.2f} dB, ruler's scenes {starts[False]:.2f} dB", flush=True)
    losses: list[float] = []
    began = time.perf_counter() - curves.seconds
    for step in range(first, steps):
        rng = np.random.default_rng([seed, step])
        kind = right if rng.random() < RIGHT or not ruler else ruler
        geometry = kind[int(rng.integers(len(kind)))]
        chosen = torch.from_numpy(rng.choice(len(geometry.truth), BATCH, replace=False))
        problems, truth = geometry.problems(chosen, torch.from_numpy(rng.permutation(3)))
        loss = loss_of(learner(problems), truth, geometry.right)
        optimizer.zero_grad()
        loss.backward()
        clip_grad_norm_(learner.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        losses.append(float(loss.detach()))
        if (step + 1) % CHECKED == 0 or step + 1 == steps:
            errors = {kind: validation(learner, known[kind]) for kind in known}
            curves.step.append(step + 1)
            curves.training.append(float(np.mean(losses)))
            curves.right.append(errors[True])
            curves.ruler.append(errors[False])
            curves.seconds = time.perf_counter() - began
            losses.clear()
            if (mean := (errors[True] + errors[False]) / 2) < least:
                least = mean
                best = {name: each.clone() for name, each in learner.state_dict().items()}
            with staged_file(state) as staged:
                torch.save({
                    "network": learner.state_dict(), "optimizer": optimizer.state_dict(),
                    "schedule": schedule.state_dict(), "curves": asdict(curves), "best": best,
                    "at": (least, step + 1), "steps": steps, "seed": seed,
                    "samples_sha256": samples_sha256,
                }, staged)  # fmt: skip
            print(f"step {step + 1} of {steps}, {curves.seconds:.0f} s: training "
                  f"{curves.training[-1]:.2f} dB, validation {errors[True]:.2f} dB, ruler's "
                  f"scenes {errors[False]:.2f} dB", flush=True)  # fmt: skip
    learner.load_state_dict(best)
    provenance = {
        "data": "experiments/learned/training.yaml", "samples_sha256": samples_sha256,
        "photographs": sum(len(g.truth) for g in train), "seed": seed, "training_steps": steps,
        "torch": torch.__version__.partition("+")[0],
    }  # fmt: skip
    file = out / f"{NAME}.npz"
    write_weights(learner.state_dict(), provenance, file)
    levels = {"noise_aware": starts[True], "noise_aware_ruler": starts[False]}
    (out / f"{NAME}.json").write_text(json.dumps(asdict(curves) | levels), "utf-8")
    draw(curves, starts, out / f"{NAME}.png")
    print(f"wrote {file}, {out / NAME}.png")


def draw(curves: Curves, starts: dict[bool, float], file: Path) -> None:
    """Draw the errors beside those of the images that the network starts from."""
    with drawn(file.parent, file.stem, PAGE, 0.36 * PAGE) as figure:
        titles = "Scene as it is", "Scene with a ruler's errors"
        axes, series = figure.subplots(1, 2), (curves.right, curves.ruler)
        for ax, title, errors, start in zip(axes, titles, series, starts.values(), strict=True):
            ax.plot(curves.step, errors, label=NAME)
            ax.axhline(start, color="0.4", linestyle="--", label="noise-aware")
            ax.set(title=title, xlabel="steps", ylabel="validation error (dB)")
            ax.legend(frameon=False)


if __name__ == "__main__":
    typer.run(main)
