"""Ambient light beyond range(B): what the noise-aware method's prior of it is worth.

`python -m experiments.studies.ambient_prior [--real FILE.npz] [--rendered DIR]` reconstructs
photographs at 60 dB under every shipped place's light, and under that of the windows with rows and
columns exchanged, whose edges then stand upright. They are A f of shipped images by the chair's
scene, A f by scenes that are off by 0.7 of the ruler's errors (`NAME_error` in the scene) while the
methods' A is not, and a real photograph if given (arrays `photograph` and `hidden`). Mean squared
errors, in thousandths, are as the images stand for the true scene, and after the best shift of at
most 2 patches otherwise. B's rank tolerance is 1e-10 but where another is named. Ambient light is
kept in DIR.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.setting import AMBIENT_ERROR
from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.cli.ambient import ambient_photographs
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

Array = NDArray[np.float64]

HIDDEN = (29, 36)
SNR = 60.0
SBRS = (0.05, 0.2, 1.0, 10.0)
IMAGES = ("mushroom", "letters", "sunset", "still_life", "digits")
WRONG = 3
OFF = 0.7
"""Of the ruler's errors: as a careful person measures."""

TURNED = "window_left", "window_right"
PAPER = "the paper's"
REAL = "real"


def main(
    real: Annotated[Path | None, typer.Option(help="A real photograph of the chair scene.")] = None,
    rendered: Annotated[Path, typer.Option(help="Folder of ambient light.")] = Path("out/rendered"),
    images: Annotated[int, typer.Option(help="Images for each scene.")] = len(IMAGES),
) -> None:
    """Print a table for each kind of photograph, and one line of it for each method and SBR."""
    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN)
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    known = {f"without, {t:g}": {"rank_tolerance": t} for t in (1e-6, 1e-8, 1e-10, 1e-12)}
    methods = {
        PAPER: ps.Periscope.for_scene(scene, A, B),
        **{
            name: ps.NoiseAware.for_scene(scene, A, B, ambient_prior=False, **tolerance)
            for name, tolerance in known.items()
        },
        "with the prior": ps.NoiseAware.for_scene(scene, A, B),
    }
    places = ambient_photographs(
        (*REALISTIC, *ADVERSARIAL), scene, rendered, 0, target=AMBIENT_ERROR
    )
    for name in TURNED:
        places[f"{name} turned"] = np.ascontiguousarray(places[name].transpose(1, 0, 2))
    for kind, signals in photographs(scene, real, images):
        print(f"\n{kind}\n{'':24}" + "".join(f"{name:>20}" for name in places))
        for sbr in SBRS:
            for name, method in methods.items():
                errors = [errors_of(method, signals, places[at], sbr, at, kind) for at in places]
                row = "".join(f"{1e3 * error:20.2f}" for error in errors)
                print(f"{sbr:<6g}{name:18}{row}", flush=True)


def photographs(
    scene: Scenario, real: Path | None, images: int
) -> list[tuple[str, Mapping[str, tuple[Array, Array]]]]:
    """Return kinds of photographs without ambient light, and what they show, by name."""
    truths = {name: ps.read_hidden_image(ps.find_image(name), HIDDEN) for name in IMAGES[:images]}
    kinds = []
    for number in range(WRONG + 1):
        # Of another seed and four points a pixel: not the A that recovers.
        there = ps.load_scenario(scene.path, HIDDEN, off_by(scene, number) if number else None)
        A = ps.render_transport(there, pixel_samples=4, seed=number + 1).astype(np.float64)
        seen = {n: ((A @ f.reshape(-1, 3)).reshape(*scene.photograph_shape, 3), f)
                for n, f in truths.items()}  # fmt: skip
        kinds.append((f"scene off, draw {number}" if number else "true scene", seen))
    if real is not None:
        signal = ps.read_photograph(real, scene.photograph_shape).values
        kinds.append((REAL, {REAL: (signal, ps.read_hidden_image(real, HIDDEN))}))
    return kinds


def off_by(scene: Scenario, seed: int) -> dict[str, float]:
    """Return values of the scene's parameters that are off by a draw of `OFF` of their errors."""
    rng, errors = np.random.default_rng(seed), declared_errors(scene.path, {})
    values = read_document(scene.path).defaults
    return {
        name: float(values[name]) + OFF * error * rng.standard_normal()
        for name, error in sorted(errors.items())
    }


def errors_of(
    method: ps.Method,
    signals: Mapping[str, tuple[Array, Array]],
    light: Array,
    sbr: float,
    place: str,
    kind: str,
) -> float:
    """Return the mean squared error over the images of a kind at one place; noise follows names."""
    errors = []
    for name, (signal, truth) in signals.items():
        seed = zlib.crc32(f"{kind} {name} {place} {sbr}".encode())
        image = method.reconstruct(ps.add_noise(ps.composite(signal, light, sbr), SNR, seed))
        if kind == "true scene":
            errors.append(ps.mean_squared_error(image, truth))
        else:
            errors.append(10 ** (-ps.registered(image, truth).psnr / 10))
    return float(np.mean(errors))


if __name__ == "__main__":
    typer.run(main)
