"""Adapt the unrolled network to a scene before its photograph is taken: minutes on two cores.

Training sees many chairs at many places; a user has one scene, as a ruler told it. `adapt` draws
scenes about it, off by the errors that it declares, renders photographs of training images in each,
solves them in the scene as told, and trains the shipped network a little further on these. It
looks at no photograph of the user's.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.utils import clip_grad_norm_

import periscopy_sim as ps
from experiments.learned.conditions import lamps
from experiments.learned.samples import HIDDEN, Samples, solved, told_values
from experiments.learned.train import BATCH, Geometry, loss_of
from periscopy_sim.reconstruction.learned.weights import (
    Weights,
    read_weights,
    shipped,
    write_weights,
)
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

SCENES = 6
IMAGES = 24
STEPS = 150
RATE = 2e-4


def adapt(told: Scenario, scene: str, images: Sequence[Array], file: Path, seed: int) -> None:
    """Write the unrolled network's weights, adapted to a told scene.

    Parameters
    ----------
    told
        The scene as methods are told it.
    scene
        The shipped scene that it is of.
    images
        Hidden images to learn from, (R, C, 3).
    file
        Of the weights.
    seed
        Of all draws.
    """
    samples = samples_about(told, scene, images, seed)
    geometry = Geometry(samples, right=False)
    weights = read_weights(shipped("unrolled"))
    network = weights.trained(shipped("unrolled")).requires_grad_(True)
    optimizer = torch.optim.Adam(network.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS, RATE / 100)
    rng = np.random.default_rng([seed, 1])
    for _ in range(STEPS):
        chosen = torch.from_numpy(rng.choice(len(samples.truth), BATCH, replace=False))
        problems, truth = geometry.problems(chosen, torch.from_numpy(rng.permutation(3)))
        loss = loss_of(network(problems), truth, right=False)
        optimizer.zero_grad()
        loss.backward()
        clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
    provenance = {**weights.provenance, "adapted_to": scene, "adaptation_seed": seed}
    adapted = Weights("unrolled", network.state_dict(), HIDDEN, weights.settings, provenance)
    write_weights(adapted, file)


def samples_about(told: Scenario, scene: str, images: Sequence[Array], seed: int) -> Samples:
    """Return photographs of scenes about a told one, as the network sees them in it."""
    rng = np.random.default_rng([seed, 0])
    values = {name: float(value) for name, value in told.parameters.items()}
    photographs, hidden, scales = [], [], []
    for number in range(SCENES):
        true = told_values(values, rng.random(), rng, scene)  # as far from it as it from the true
        there = ps.load_scenario(scene, HIDDEN, true)
        A = ps.render_transport(there, samples=16, seed=number)
        B = ps.point_light_backgrounds(there)
        for chosen in rng.choice(len(images), IMAGES, replace=False):
            signal = (A @ images[chosen].reshape(-1, 3)).reshape(*there.photograph_shape, 3)
            sbr = 10 ** rng.uniform(-1, 1)
            exposed = ps.composite(signal, lamps(B, there, rng), sbr)
            photographs.append(ps.add_noise(exposed, 60, int(rng.integers(2**31))))
            hidden.append(images[chosen])
            scales.append(1 / (signal.mean() * (1 + 1 / sbr)))
    return solved(
        told, np.stack(photographs), np.stack(hidden), np.array(scales), "train",
        displaced=True, seed=seed,
    )  # fmt: skip
