"""How close a reconstruction, or each frame of a video, is to the truth.

Every metric but `psnr` uses the truth: for a gain per channel or a matrix of colours, and in
`registered` for the shift. These compare a grey estimate of a coloured truth with the mean of its
channels.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.numerics import Array, Image, precision_of
from periscopy_sim.numerics.validation import InputError, plain_array

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import FrameByFrame


@dataclass(frozen=True, eq=False)
class Registration:
    """The best agreement over small shifts."""

    psnr: float  # peak signal-to-noise ratio in dB after gain and shift
    shift: tuple[float, float]  # (down, right) in patches that the estimate was moved by
    image: Array  # (rows, columns, channels) shifted and gain-matched estimate
    at_limit: bool  # whether the shift is at the limit of the search: the best may lie beyond


BEYOND = 1e-3
"""Excess beyond [0, 1] that resampled truths may have."""

_NOTE = "gain-matched: uses the truth"
_SHARE = {"units": "1", "valid_range": [0, 1]}
METRICS = {
    "mean_squared_error": {
        "long_name": "mean squared error, white being 1", "units": "1", "note": _NOTE
    },
    "psnr": {"long_name": "peak signal-to-noise ratio", "units": "dB", "note": _NOTE},
    "psnr_plain": {
        "long_name": "peak signal-to-noise ratio without a gain", "units": "dB",
        "note": "supposes that the photograph without ambient light has A's unit",
    },
    "psnr_registered": {
        "long_name": "peak signal-to-noise ratio after the best shift of at most 2 patches",
        "units": "dB",
        "note": f"{_NOTE}, to find the shift too",
    },
    "ssim": {
        "long_name": "structural similarity", "units": "1", "valid_range": [-1, 1], "note": _NOTE
    },
    "covered_1": {
        "long_name": "share of patches within a standard error of the truth", "note": _NOTE,
        **_SHARE,
    },
    "covered_2": {
        "long_name": "share of patches within two standard errors of the truth", "note": _NOTE,
        **_SHARE,
    },
}  # fmt: skip
"""What a sweep measures of each image, see `measured`."""


def gain_matched(estimate: Image, truth: Image) -> Array:
    """Clip negatives, scale each channel by the factor that fits the truth best, clip to [0, 1].

    Both are (rows, columns, channels), the truth within [0, 1], else, or if the shapes differ, it
    is a ValueError.
    """
    truth = _seen_by(estimate, truth)
    if estimate.shape != truth.shape:
        raise InputError(
            f"estimate {estimate.shape} and truth {truth.shape} differ in shape; give a truth of "
            "the estimate's rows, columns and channels"
        )
    if not (np.min(truth) >= -BEYOND and np.max(truth) <= 1 + BEYOND):
        raise InputError("the truth leaves the range from 0 to 1; divide it by its largest value")
    positive = np.maximum(np.asarray(estimate, np.float64), 0)
    return np.asarray(np.clip(_gain(positive, truth) * positive, 0, 1))


def _gain(estimate: Image, truth: Image) -> Array:
    """Return the factor per channel that fits the truth best."""
    energy = np.sum(estimate**2, axis=(0, 1))
    return np.asarray(np.sum(estimate * truth, axis=(0, 1)) / np.where(energy > 0, energy, 1))


def mean_squared_error(estimate: Image, truth: Image) -> float:
    """Mean squared error over all patches and channels, after `gain_matched`."""
    return float(np.mean((gain_matched(estimate, truth) - _seen_by(estimate, truth)) ** 2))


def psnr(estimate: Image, truth: Image) -> float:
    """Peak signal-to-noise ratio in dB of an image as it is, for a peak of 1, as scikit-image's.

    Images of one shape, in the truth's unit; a ValueError if the shapes differ.
    """
    if np.shape(estimate) != np.shape(truth):
        raise ValueError(f"{np.shape(estimate)} and {np.shape(truth)} differ in shape")
    return _decibels(
        float(
            np.mean(
                (plain_array(estimate, "the estimate") - plain_array(truth, "the truth")) ** 2.0
            )
        )
    )


def psnr_gain_matched(estimate: Image, truth: Image) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1, after `gain_matched`."""
    return _decibels(mean_squared_error(estimate, truth))


def structural_similarity(estimate: Image, truth: Image) -> float:
    """Mean structural similarity after `gain_matched`, by scikit-image: Wang et al., 2004.

    Its windows have 7 patches a side, fewer in a smaller image; NaN below 3.
    """
    from skimage import metrics

    truth = _seen_by(estimate, truth)
    side = min(7, *truth.shape[:2])
    if side < 3:
        return math.nan
    side -= 1 - side % 2
    image = gain_matched(estimate, truth)
    return float(
        metrics.structural_similarity(image, truth, win_size=side, channel_axis=2, data_range=1)
    )


def colour_matched_psnr(estimate: Image, truth: Image) -> float:
    """Peak signal-to-noise ratio in dB, with the colours fitted to the truth.

    The estimate, (rows, columns, channels), is multiplied by the matrix of colours that fits the
    truth best by least squares, and clipped to [0, 1]. So this is no measure of the colours.
    """
    images = estimate, _seen_by(estimate, truth)
    pixels, known = (np.reshape(image, (-1, image.shape[2])) for image in images)
    matrix = np.linalg.lstsq(pixels, known, rcond=precision_of(pixels))[0]
    return _decibels(float(np.mean((np.clip(pixels @ matrix, 0, 1) - known) ** 2)))


def _seen_by(estimate: Image, truth: Image) -> Image:
    """Return the truth, of which a grey estimate shows the mean of the channels."""
    if estimate.ndim == 3 and estimate.shape[2] == 1 and truth.ndim == 3:
        return np.asarray(truth.mean(axis=2, keepdims=True))
    return truth


def _decibels(mean_squared_error: float) -> float:
    return -10 * float(np.log10(max(mean_squared_error, 1e-30)))


def registered(
    estimate: Image, truth: Image, reach: float = 2.0, step: float = 0.5
) -> Registration:
    """Find the shift that agrees best with the truth.

    The monitor's position is often known only to about a patch; this separates that error from
    the image's own. Shifts of (rows, columns, channels) up to the reach are tried over a grid of
    the step, both in patches, by linear interpolation with zeros outside. Among equals, the
    smallest shift is the best.
    """
    limit = int(reach / step + 1e-9)
    shifts = [step * n for n in range(-limit, limit + 1)]
    # The nearest first: among equals, max takes the first.
    candidates = sorted(product(shifts, shifts), key=lambda shift: math.hypot(*shift))
    best = max(candidates, key=lambda shift: psnr_gain_matched(shifted(estimate, *shift), truth))
    image, at_limit = shifted(estimate, *best), max(map(abs, best)) >= shifts[-1]
    return Registration(psnr_gain_matched(image, truth), best, gain_matched(image, truth), at_limit)


def shifted(image: Image, down: float, right: float) -> Array:
    """Shift an image, (rows, columns, channels), by a fraction of patches.

    It is interpolated linearly, with zeros outside.
    """
    from scipy import ndimage

    values, shift = np.asarray(image, np.float64), (down, right, 0)
    return np.asarray(ndimage.shift(values, shift, order=1, mode="grid-constant"))


def covered(image: Image, errors: Image, truth: Image) -> dict[str, float]:
    """Return the fractions of patches within one and two standard errors of the truth.

    All are (R, C, channels). The truth is scaled by the gain per channel that fits the image
    best: the image's own would shrink with its noise. For normal errors the fractions are 0.68
    and 0.95.
    """
    estimate, truth = np.asarray(image, np.float64), _seen_by(image, truth)
    off = np.abs(estimate - _gain(truth, estimate) * truth)
    return {f"covered_{k}": float(np.mean(off <= k * errors)) for k in (1, 2)}


def measured(
    image: Image, truth: Image, errors: Image | None = None, scale: float = 1.0
) -> dict[str, float]:
    """Return the `METRICS` of an image, its truth and its standard errors, (R, C, channels).

    `scale` is the image of a truth of 1.
    """
    truth = np.ascontiguousarray(truth)
    plain = np.clip(np.asarray(image, np.float64) / scale, 0, 1)
    shares = {"covered_1": np.nan, "covered_2": np.nan}
    return {
        **(shares if errors is None else covered(image, errors, truth)),
        "mean_squared_error": mean_squared_error(image, truth),
        "psnr": psnr_gain_matched(image, truth),
        "psnr_plain": psnr(plain, _seen_by(image, truth)),
        "psnr_registered": registered(image, truth).psnr,
        "ssim": structural_similarity(image, truth),
    }


Record = dict[str, Any]


def timed_solutions(
    video: FrameByFrame[Any, Any], photographs: Image, batch: int = 16
) -> Iterator[tuple[Any, float]]:
    """Yield solutions in turn, and the seconds of each: its own and its share of its batch's."""
    for start in range(0, len(photographs), batch):
        clock = time.perf_counter()
        remaining: list[Callable[[], Any]] = list(
            video.recoveries(photographs[start : start + batch])
        )
        share = (time.perf_counter() - clock) / len(remaining)
        for finish in remaining:
            clock = time.perf_counter()
            solution = finish()
            yield solution, share + time.perf_counter() - clock


def record_of(seconds: float, numbers: Mapping[str, Any]) -> Record:
    """Return a frame's numbers for the table; of those by channel, the root mean square."""
    means = {
        key: value if isinstance(value, int) else float(np.sqrt(np.mean(np.square(value))))
        for key, value in numbers.items()
    }
    return {"seconds": seconds, **means}


def compare(records: Sequence[Record], images: Image, known: Image, of: str = "") -> None:
    """Add each frame's metrics against the truth to its record, their names ending with `of`."""
    for record, image, truth in zip(records, images, known, strict=True):
        record[f"mean_squared_error{of}"] = mean_squared_error(image, truth)
        record[f"psnr{of}"] = psnr_gain_matched(image, truth)


def medians_of(records: Sequence[Record]) -> dict[str, float]:
    """Return the median over the frames of each number."""
    names = (name for name in records[0] if name not in ("frame", "name"))
    return {name: float(np.median([record[name] for record in records])) for name in names}


def write_table(path: Path, records: Sequence[Record]) -> None:
    """Write the records as CSV, one row a frame."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, list(records[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(records)
