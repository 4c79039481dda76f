"""The photographs of the ablation: hidden images, ambient conditions, ratios of signal to both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.setting import SNR, Measured, Setting

Array = NDArray[np.float64]

IMAGES = ("mushroom", "letters", "still_life")
RATIOS = (10.0, 0.5, 0.05)
REAL_RATIOS = (10.0, 0.05)
REAL = "real"
BLURRED, BAD_PIXELS = "blurred noise", "bad pixels"
OTHER_NOISE_RATIO = 0.5
BAD_PART, BAD_SIZE = 1e-3, 20.0
"""Part of the pixels that are bad, and how much too bright, in σ."""


@dataclass(frozen=True, eq=False)
class Case:
    """Photographs of one hidden image at one SBR, each under another ambient light.

    Attributes
    ----------
    name
        Its column.
    photographs
        (P, rows, columns, 3).
    truth
        (R, C, 3).
    real
        Whether a camera took the signal.
    common
        Whether weights may be chosen on it: rendered, under realistic light.
    """

    name: str
    photographs: Array
    truth: Array
    real: bool = False
    common: bool = False

    def scores(self, images: Array) -> Array:
        """Score (P, R, C, 3) images: (1, P) mean squared errors; (2, P) if real, PSNR in dB.

        For a real photograph the second PSNR is that after the best shift.
        """
        if not self.real:
            return np.array([[ps.mean_squared_error(image, self.truth) for image in images]])
        pairs = [(ps.psnr(i, self.truth), ps.registered(i, self.truth).psnr) for i in images]
        return np.array(pairs).T


def cases(setting: Setting) -> Iterator[Case]:
    """Form every case, the rendered ones first."""
    realistic, adversarial = setting.backgrounds(), setting.adversarial
    for image in IMAGES:
        measured = rendered(setting, image)
        for sbr in RATIOS:
            photographs = _photographs(setting, image, measured, realistic, sbr)
            yield Case(f"{image} {sbr:g}", photographs, measured.truth, common=True)
    measured = rendered(setting, IMAGES[0])
    for name, background in adversarial.items():
        for sbr in RATIOS:
            photographs = _photographs(setting, IMAGES[0], measured, {name: background}, sbr)
            yield Case(f"{name} {sbr:g}", photographs, measured.truth)
    ordinary = _photographs(setting, IMAGES[0], measured, realistic, OTHER_NOISE_RATIO, exact=True)
    for number, (name, spoilt) in enumerate({BLURRED: blurred, BAD_PIXELS: bad_pixels}.items()):
        rng = np.random.default_rng([setting.seed, number])
        photographs = np.stack([spoilt(photograph, rng) for photograph in ordinary])
        yield Case(f"{name} {OTHER_NOISE_RATIO:g}", photographs, measured.truth)
    if setting.measured.real:
        measured = setting.measured
        yield Case(REAL, (measured.signal / measured.signal.mean())[None], measured.truth, True)
        for sbr in REAL_RATIOS:
            photographs = _photographs(setting, REAL, measured, realistic, sbr)
            yield Case(f"{REAL} {sbr:g}", photographs, measured.truth, True)


def rendered(setting: Setting, image: str) -> Measured:
    """Photograph a shipped hidden image by path tracing."""
    truth = ps.read_hidden_image(ps.find_image(image), setting.hidden)

    def render() -> Array:
        return ps.render_photograph(setting.scenario, truth, samples=8192, seed=setting.seed)

    return Measured(setting.kept(image, "chair", render), truth, real=False)


def noise_level(photograph: Array) -> float:
    """Return σ of the noise at `SNR`."""
    return 10 ** (-SNR / 20) * root_mean_square(photograph)


def root_mean_square(photograph: Array) -> float:
    """Of all pixels and channels."""
    return float(np.sqrt(np.mean(photograph**2)))


def blurred(photograph: Array, rng: np.random.Generator) -> Array:
    """Add noise of the same σ that neighbours share, as demosaicing or resampling makes it."""
    from scipy.ndimage import convolve1d

    noise = rng.standard_normal(photograph.shape)
    for axis in (0, 1):
        noise = convolve1d(noise, np.array([1, 2, 1]) / np.sqrt(6), axis=axis, mode="wrap")
    return photograph + noise_level(photograph) * noise


def bad_pixels(photograph: Array, rng: np.random.Generator) -> Array:
    """Add white noise, and light to a few pixels."""
    σ = noise_level(photograph)
    bad = rng.random(photograph.shape) < BAD_PART
    return photograph + σ * rng.standard_normal(photograph.shape) + BAD_SIZE * σ * bad


def _photographs(
    setting: Setting,
    image: str,
    measured: Measured,
    backgrounds: dict[str, Array],
    sbr: float,
    *,
    exact: bool = False,
) -> Array:
    """Composite a signal and each background; with noise, if not exact."""

    def seed(name: str) -> int:
        identity = json.dumps([setting.seed, image, name, sbr]).encode()
        return int.from_bytes(hashlib.sha256(identity).digest()[:16])

    light = {name: ps.composite(measured.signal, b, sbr) for name, b in backgrounds.items()}
    if not exact:
        light = {name: ps.add_noise(total, SNR, seed(name)) for name, total in light.items()}
    return np.stack([*light.values()])
