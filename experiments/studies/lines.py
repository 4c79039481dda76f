"""What lines of ambient light do to images: `AmbientLines` on real photographs and real light.

The light is the step of a doorway's photographs, `twoman1bg` beside a multiple of `twoman0bg`,
whose noise beyond 8 pixels is blurred away. `python -m experiments.studies.lines SHARED` prints the
table; SHARED has the folders `data` and `cases`, with the photographs and the ball's scene.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy import ndimage

import periscopy_sim as ps
from periscopy_sim.model.fit import Fit
from periscopy_sim.model.wall_gain import WallGain
from periscopy_sim.numerics import Array
from periscopy_sim.storage.published import DECODING
from periscopy_sim.storage.rasters import srgb_decode

BLUR = 8.0
"""Standard deviation in pixels of the Gaussian that blurs the noise of ambient light away."""

BALL = {"ball_dx": -0.035, "ball_dy": -0.158, "ball_dz": 0.094}
"""The ball's place in its own laboratory."""


def main(shared: Annotated[Path, typer.Argument(help="Folder of the photographs.")]) -> None:
    """Print each photograph's score without the correction, and by default."""
    data = {file.stem: dict(np.load(file)) for file in (shared / "data").glob("*.npz")}
    dark, lit = (
        data[f"doorway_{name}"]["photograph"].astype(np.float64) ** DECODING
        for name in ("twoman0bg", "twoman1bg")
    )
    scene = ps.load_scenario("doorway", (32, 32), {"film": 125})
    plain, default = methods(scene)
    ambient = step(plain.fit, lit, dark)
    rooms = {power: plain.reconstruct(dark**power) for power in (1, 1 / DECODING)}
    print("| photograph | without | by default |\n|---|---|---|")
    for name, y, power in doorway(dark, lit, ambient):
        image = rooms[power]
        scores = (np.corrcoef(m.reconstruct(y).ravel(), image.ravel()) for m in (plain, default))
        print(f"| {name} |", " | ".join(f"{each[0, 1]:.3f}" for each in scores), "|", flush=True)
    chair, ball = ("chair", (29, 36), {}), (shared / "cases/ball/scene.xml", (24, 32), BALL)
    for name, given in (("chair_mushroom", chair), ("ssd_ball", ball)):
        plain, default = methods(ps.load_scenario(*given))
        y, truth = (
            data[name]["photograph"].astype(np.float64),
            srgb_decode(data[name]["hidden"] / 255),
        )
        light = ndimage.zoom(ambient, np.divide(y.shape, ambient.shape), order=1)
        for sbr in (np.inf, 1.0, 0.2):
            whole = y / y.mean() + light / light.mean() / sbr
            whole = whole if np.isinf(sbr) else ps.add_noise(whole, snr=60, seed=0)
            scores = (ps.registered(m.reconstruct(whole), truth).psnr for m in (plain, default))
            print(
                f"| {name}, SBR {sbr:g} |", " | ".join(f"{s:.2f}" for s in scores), "|", flush=True
            )


def methods(scene: ps.Scenario) -> tuple[ps.NoiseAware, ps.NoiseAware]:
    """Return the method without lines, and by default."""
    A, B = ps.transport(scene, noise=1e-3), ps.point_light_backgrounds(scene)
    plain = ps.NoiseAware.for_scene(scene, A, B, corrections=[WallGain])
    return plain, ps.NoiseAware.for_scene(scene, A, B)


def doorway(dark: Array, lit: Array, ambient: Array) -> Iterator[tuple[str, Array, float]]:
    """Yield photographs under the step of ambient light, with more light's noise, and powers."""
    yield "a doorway under a step of light", lit, 1
    for factor in (2, 4, 10):
        bright = dark + factor * ambient
        shot = 2e-3 * dark.mean() * np.sqrt(np.maximum(bright / dark - 1, 0))
        noisy = bright + shot * np.random.default_rng(0).standard_normal(dark.shape)
        yield f"{factor} times the step", noisy, 1
        encoded = np.maximum(noisy / noisy.max(axis=(0, 1)), 0) ** (1 / DECODING)
        yield f"{factor} times, encoded for screens", encoded, 1 / DECODING


def step(fit: Fit, lit: Array, dark: Array) -> Array:
    """Return the ambient light that a lit photograph has beside a multiple of the dark one."""
    whole, room = (fit.planes(each[None])[0] for each in (lit, dark))
    y, y_room = fit.project_out(whole), fit.project_out(room)
    light = whole / (np.sum(y * y_room, axis=1) / np.sum(y_room**2, axis=1))[:, None] - room
    outside = fit.project_out(light)
    field = outside.reshape(len(light), *dark.shape[:2])
    across, down = (field.mean(axis=axis, keepdims=True) for axis in (1, 2))
    lines = ndimage.gaussian_filter1d(across, 1, axis=2) + ndimage.gaussian_filter1d(
        down, 1, axis=1
    )
    rest = ndimage.gaussian_filter(field - lines, (0, BLUR, BLUR), mode="nearest")
    smooth = light - outside + (lines + rest).reshape(light.shape)
    return np.asarray(smooth.T.reshape(dark.shape))


if __name__ == "__main__":
    typer.run(main)
