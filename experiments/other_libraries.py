"""Solvers of other libraries on a shipped photograph, beside the package's own.

`python -m experiments.other_libraries --out DIR` needs the extras experiments and deepinv, and
pylops. One photograph of the chair, under an overcast sky at an SBR of 0.5 and 60 dB, is recovered
by SciPy's LSQR, PyLops's split Bregman and deepinv's plug-and-play ADMM over `transport_operator`
and `periscopy_sim.deepinv.Periscopy`, range(B) projected out of all. Each has one weight, chosen
without the truth by the discrepancy principle (V. A. Morozov, 1966): the largest whose image leaves
at most `TOLERANCE` times the noise, which the noise-aware method has estimated.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, show_light
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[Any]
Solver = Callable[[float], Array]
"""Takes a weight, gives (R, C, 3)."""

TOLERANCE = 1.01
HIDDEN = 29, 36
WEIGHTS = 1e-7, 1.0
HALVINGS = 9
"""Of the logarithm of `WEIGHTS`: the weight is known to a few percent."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph and its scene; range(B) projected out of both, in units near 1.

    Attributes
    ----------
    scene, A, B, photograph, truth
        As they are.
    rest
        (M, N) A⊥ over its patches' root mean energy.
    y
        (rows, columns, 3) y⊥ over its root mean square.
    noise
        Norm of the noise in y, as the noise-aware method estimates it.
    """

    scene: ps.Scenario
    A: Array
    B: Array
    photograph: Array
    truth: Array
    rest: Array
    y: Array
    noise: float


def shipped_photograph() -> Photograph:
    """Return the chair's photograph of the mushroom."""
    scene = ps.load_scenario("chair", HIDDEN)
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    truth = ps.read_hidden_image(ps.find_image("mushroom"), HIDDEN)
    ambient = ps.render_background("ambient/overcast", scene).photograph
    signal = ps.render_photograph(scene, truth)
    photograph = ps.add_noise(ps.composite(signal, ambient, sbr=0.5), snr=60, seed=0)
    found = ps.NoiseAware.for_scene(scene, A, B).solve(photograph)
    U, s, _ = np.linalg.svd(B, full_matrices=False)
    Q = U[:, s > 1e-10 * s[0]]
    rest = A - Q @ (Q.T @ A)
    flat = photograph.reshape(-1, 3)
    y = flat - Q @ (Q.T @ flat)
    level = np.sqrt(np.mean(y**2))
    noise = float(np.sqrt((len(y) - Q.shape[1]) * np.sum(found.noise**2)) / level)
    unit = np.sqrt(np.sum(rest**2) / rest.shape[1])
    y = (y / level).reshape(photograph.shape)
    return Photograph(
        scene, A, B, photograph, truth, (rest / unit).astype(np.float32), y, noise
    )  # fmt: skip


def discrepancy_weight(solver: Solver, left: Callable[[Array], float], noise: float) -> float:
    """Return the largest weight whose image leaves at most `TOLERANCE` times the noise.

    It is between `WEIGHTS`, by bisection of its logarithm.
    """
    low, high = np.log(WEIGHTS)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if left(solver(float(np.exp(middle)))) <= TOLERANCE * noise:
            low = middle
        else:
            high = middle
    return float(np.exp(low))


def lsqr(given: Photograph) -> Solver:
    """Return SciPy's LSQR with Tikhonov's weight."""
    from scipy.sparse.linalg import lsqr as solve

    operator = ps.transport_operator(given.rest, scene=given.scene)

    def solver(weight: float) -> Array:
        x = solve(operator, given.y.ravel(), damp=np.sqrt(weight), iter_lim=200)[0]
        return operator.image(x)

    return solver


def split_bregman(given: Photograph) -> Solver:
    """Return PyLops's split Bregman for total variation of each direction."""
    import pylops
    from pylops.optimization.sparsity import splitbregman

    operator = ps.transport_operator(given.rest, scene=given.scene)
    plain = pylops.aslinearoperator(operator)
    slopes = [
        pylops.FirstDerivative((*HIDDEN, 3), axis=axis, edge=True, kind="backward", dtype="float32")
        for axis in (0, 1)
    ]

    def solver(weight: float) -> Array:
        x = splitbregman(
            plain, given.y.ravel(), slopes, niter_outer=20, niter_inner=2, mu=1.0,
            epsRL1s=[weight, weight], tol=1e-4, iter_lim=10,
        )[0]  # fmt: skip
        return operator.image(x)

    return solver


def plug_and_play(given: Photograph) -> Solver:
    """Return deepinv's plug-and-play ADMM with its denoiser of total variation."""
    import torch
    from deepinv.models import TVDenoiser
    from deepinv.optim import ADMM
    from deepinv.optim.data_fidelity import L2
    from deepinv.optim.prior import PnP

    from periscopy_sim.deepinv import Periscopy

    physics = Periscopy(given.rest, scene=given.scene, snr=None)
    y = torch.as_tensor(np.moveaxis(given.y, -1, 0)[None].astype(np.float32))

    def solver(weight: float) -> Array:
        model = ADMM(
            data_fidelity=L2(), prior=PnP(TVDenoiser(n_it_max=100)), stepsize=1.0,
            sigma_denoiser=weight, max_iter=40, early_stop=False,
        )  # fmt: skip
        with torch.no_grad():
            image = model(y, physics)[0].numpy()
        return np.moveaxis(image, 0, -1)

    return solver


FOREIGN = {
    "LSQR\nSciPy": lsqr,
    "split Bregman\nPyLops": split_bregman,
    "plug-and-play\ndeepinv": plug_and_play,
}


def main(
    out: Annotated[Path, typer.Option(help="Folder for the picture and its numbers.")],
) -> None:
    """Recover, draw, and write the numbers."""
    given = shipped_photograph()
    images: dict[str, Array] = {}
    numbers: dict[str, dict[str, float]] = {}

    def keep(name: str, recover: Callable[[], Array], **told: float) -> None:
        seconds = []
        for _ in range(2):  # the first compiles
            start = time.perf_counter()
            images[name] = recover()
            seconds.append(time.perf_counter() - start)
        psnr = ps.psnr(images[name], given.truth)
        numbers[name] = {"psnr": psnr, "seconds": seconds[-1], **told}
        print(f"{name.replace(chr(10), ', ')}: {psnr:.2f} dB, {seconds[-1]:.3g} s", flush=True)

    for name, kind in {"preconditioned": ps.Periscope, "noise-aware": ps.NoiseAware}.items():
        method: Any = kind.for_scene(given.scene, given.A, given.B)
        keep(f"{name}\nperiscopy_sim", lambda method=method: method.reconstruct(given.photograph))
    operator = ps.transport_operator(given.rest, scene=given.scene)

    def left(image: Array) -> float:
        return float(np.linalg.norm(operator @ image.ravel() - given.y.ravel()))

    for name, make in FOREIGN.items():
        solver = make(given)
        weight = discrepancy_weight(solver, left, given.noise)
        keep(name, lambda solver=solver, weight=weight: solver(weight), weight=weight)
    draw(given.truth, images, numbers, out)
    with staged_file(out / "other_libraries.json") as file:
        file.write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")
    print(f"wrote {out / 'other_libraries.png'}, {out / 'other_libraries.json'}")


def draw(
    truth: Array, images: dict[str, Array], numbers: dict[str, dict[str, float]], out: Path
) -> None:
    """Draw the hidden image and what each solver made of its photograph."""
    count = len(images) + 1
    height = 1.45 * PAGE / count
    with drawn(out, "other_libraries", PAGE, height) as figure:
        hidden, *axes = figure.subplots(1, count)
        show_light(hidden, truth, white=1.0)
        hidden.set_title("hidden\nimage", fontsize=8)
        for ax, (name, image) in zip(axes, images.items(), strict=True):
            show_light(ax, ps.gain_matched(image, truth), white=1.0)
            ax.set_title(name, fontsize=8)
            told = numbers[name]
            text = f"{told['psnr']:.1f} dB, {told['seconds']:.2g} s"
            ax.text(0.5, -0.08, text, transform=ax.transAxes, ha="center", va="top", fontsize=7.5)
        for ax in (hidden, *axes):
            ax.set_anchor("N")


if __name__ == "__main__":
    typer.run(main)
