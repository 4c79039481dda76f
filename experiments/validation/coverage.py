"""Standard errors of the noise-aware method beside its errors, over images of many kinds."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage import color, data, img_as_float, transform

import periscopy_sim as ps
from experiments.validation.solver import within
from periscopy_sim.dataset.configuration import Distribution, Shapes, Smooth
from periscopy_sim.storage.rasters import srgb_decode

Array = NDArray[np.float64]
HIDDEN, FINE = (15, 18), (30, 36)
"""Patches of the hidden image, and of what the monitor shows."""

RESOLUTION = 64
IMAGES = 8
SBR = 0.5
SHIPPED = ("bars", "checker", "digits", "letters", "mushroom", "siemens", "still_life", "sunset")
PHOTOGRAPHS = ("astronaut", "brick", "camera", "chelsea", "coffee", "coins", "moon", "rocket")
"""Pictures that scikit-image installs."""

SNRS = 40, 50, 60, 70
LARGEST_ROOT_MEAN_SQUARE = 1.7
"""Of z over the images of one kind: as measured, of white noise at 70 dB, 1.47 ± 0.04."""

LARGEST_BIAS = 0.1
"""Of an image's light at 60 dB: as measured, of pictures with edges within patches, 0.07 ± 0.03."""


def field(exponent: float) -> Callable[[np.random.Generator], Array]:
    """Return what draws coloured random fields whose amplitude falls with a power of frequency."""
    source = Smooth(
        kind="smooth", exponent=Distribution(value=exponent), saturation=Distribution(value=0.3)
    )
    return lambda rng: source.draw(rng, FINE, 1)


def dots(rng: np.random.Generator) -> Array:
    """Return a black image with one patch in 50 lit."""
    f = np.zeros((HIDDEN[0] * HIDDEN[1], 3))
    lit = rng.choice(len(f), len(f) // 50, replace=False)
    f[lit] = rng.random((len(lit), 3))
    return np.kron(f.reshape(*HIDDEN, 3), np.ones((2, 2, 1)))


def photograph(name: str) -> Array:
    """Return a picture of scikit-image, its middle, in linear light."""
    picture = img_as_float(getattr(data, name)())
    picture = picture if picture.ndim == 3 else color.gray2rgb(picture)
    rows, columns = (int(min(picture.shape[0] / 5, picture.shape[1] / 6) * n) for n in (5, 6))
    top, left = (picture.shape[0] - rows) // 2, (picture.shape[1] - columns) // 2
    linear = srgb_decode(picture[top : top + rows, left : left + columns])
    return np.asarray(transform.resize(linear, FINE, order=1, anti_aliasing=True))


def shapes(rng: np.random.Generator) -> Array:
    """Return plain shapes before a plain ground."""
    return np.asarray(Shapes(kind="shapes").draw(rng, FINE, 1))


DRAWN = {
    "natural (1/f)": field(1),
    "smooth (1/f³)": field(3),
    "shapes": shapes,
    "dots": dots,
    "white noise": field(0),
}


def images(kind: str) -> Iterator[Array]:
    """Yield the images of a kind, the same in every call."""
    if kind == "shipped":
        for name in SHIPPED:
            yield ps.read_hidden_image(ps.find_image(name), FINE)
    elif kind == "photographs":
        yield from map(photograph, PHOTOGRAPHS)
    else:
        rng = np.random.default_rng(0)
        yield from (DRAWN[kind](rng) for _ in range(IMAGES))


def check_standard_errors() -> dict[str, Any]:
    """Tabulate errors over standard errors, z, of kinds of images: chair, 64 x 64, 15 x 18.

    The photographs are A f of twice as many patches along each side.
    """
    scene, fine = (ps.load_scenario("chair", n, {"resolution": RESOLUTION}) for n in (HIDDEN, FINE))
    A = ps.analytic_transport(fine)
    ambient = scene.ambient("overcast").photograph
    method = ps.NoiseAware.for_scene(scene, ps.analytic_transport(scene), scene.B)
    rows: dict[str, Any] = {}
    worst = bias = 0.0
    for kind in ("shipped", "photographs", *DRAWN):
        for snr in SNRS:
            found = []
            for seed, f in enumerate(images(kind)):
                signal = (A @ f.reshape(-1, 3)).reshape(*scene.photograph_shape, 3)
                signal = signal * scene.channel_gain
                y = ps.composite(signal, ambient, SBR)
                truth = f.reshape(HIDDEN[0], 2, HIDDEN[1], 2, 3).mean(axis=(1, 3))
                truth *= SBR / (1 + SBR) / signal.mean()
                found.append(numbers(method, ps.add_noise(y, snr, seed), truth))
            mean = np.mean(found, axis=0)
            error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
            size = np.sqrt(mean[2])
            rows[f"{kind}, {snr} dB"] = (
                f"|z| < 1: {mean[0]:.2f} ± {error[0]:.2f}  "
                f"|z| < 2: {mean[1]:.2f} ± {error[1]:.2f}  "
                f"root mean square {size:.2f} ± {error[2] / (2 * size):.2f}  "
                f"largest {np.max(found, axis=0)[3]:4.1f}  light {mean[4]:.3f} ± {error[4]:.3f}"
            )
            worst = max(worst, float(size))
            bias = max(bias, float(abs(mean[4] - 1))) if snr == 60 else bias
    return {
        f"{IMAGES} images each, ± standard error; a normal z has 0.68, 0.95, 1": rows,
        "largest root mean square": within(worst, LARGEST_ROOT_MEAN_SQUARE),
        "light of the image over the truth's, off 1 at 60 dB": within(bias, LARGEST_BIAS),
    }


def numbers(method: ps.NoiseAware, photograph: Array, truth: Array) -> list[float]:
    """Return the shares of |z| below 1 and 2, the mean square, the largest, and the light."""
    found = method.solve(photograph)
    z = np.abs(found.image - truth) / method.standard_errors(found)
    shares = [float(np.mean(z < 1)), float(np.mean(z < 2)), float(np.mean(z**2))]
    return [*shares, float(z.max()), float(found.image.mean() / truth.mean())]
