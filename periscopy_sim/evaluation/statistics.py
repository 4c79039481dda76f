"""Means over a sweep's pictures, places, rulers and draws, with confidence intervals.

Noise draws of one photograph err alike in the rest, so that they are averaged within it. Pictures,
places and rulers are crossed: each picture is seen in each place. The squared half length of an
interval is the sum of those over each of them alone, by its own Student's t, so that a result holds
for other pictures *and* other places like these. What differs from cell to cell counts in each:
such intervals hold at least 0.95 of the true means, up to 0.997 of few pictures and places.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.evaluation.sweep import TURNS
from periscopy_sim.numerics.validation import number_of

if TYPE_CHECKING:
    import xarray as xr

CROSSED = {"image": "pictures", "background": "places", "ruler": "rulers"}
UNITS = {**CROSSED, "seed": "draws"}
"""Axes of samples, in words."""

LEVEL = 0.95
"""Confidence level of the intervals."""


def interval(
    values: "xr.DataArray", keep: Collection[str] = (), failures: "xr.DataArray | None" = None
) -> "xr.Dataset":
    """Return the mean over pictures, places, rulers and draws, and its 95 % confidence interval.

    Parameters
    ----------
    values
        A metric, or paired differences of one, over a sweep's axes; NaN for cells without one.
    keep
        Axes of `UNITS` to keep instead of averaging.
    failures
        Why a method failed, over the same axes, or nothing; by default it failed where NaN is.

    Returns
    -------
    xarray.Dataset
        Over the other axes: ``mean``; ``half``, half the length of the interval, NaN for a single
        sample; ``failed``, the number of
        cells that failed, which are left out; and of each of `UNITS` that counts, by its words,
        how many samples there are.
    """
    import xarray as xr

    axes = [axis for axis in UNITS if axis in values.dims and axis not in keep]
    failed = (values.isnull() if failures is None else failures != "").sum(axes)
    values = _by_place(values) if "background" in axes else values
    several = [axis for axis in axes if values.sizes[axis] > 1]
    units = [axis for axis in several if axis in CROSSED] or several
    cells = values.mean([axis for axis in axes if axis not in units])
    mean = cells.mean(units)
    counts, squared = {}, xr.zeros_like(mean)
    for unit in units:
        samples = cells.mean([axis for axis in units if axis != unit])
        counts[UNITS[unit]] = n = samples.notnull().sum(unit)
        quantile = stats.t.ppf((1 + LEVEL) / 2, np.maximum(n - 1, 1))
        squared = squared + quantile**2 * samples.var(unit, ddof=1).where(n > 1) / n
    half = np.sqrt(squared).where(bool(units))
    found = {"mean": mean.assign_attrs(values.attrs), "half": half, "failed": failed}
    return xr.Dataset({**found, **counts})


def counted(parts: "Iterable[xr.Dataset]") -> str:
    """Return in words how many samples `interval`s have: ``3 pictures, 7 to 8 places``."""
    numbers: dict[str, set[int]] = {}
    for part in parts:
        for words in UNITS.values():
            if words in part:
                numbers.setdefault(words, set()).update(part[words].values.ravel().tolist())
    texts = {words: sorted(each - {0}) or [0] for words, each in numbers.items()}
    return (
        ", ".join(
            f"{low} {words[: -1 if high == 1 else None]}"
            if low == high
            else f"{low} to {high} {words}"
            for words, (low, *_, high) in ((w, (n[0], *n)) for w, n in texts.items())
        )
        or "1"
    )


def _by_place(values: "xr.DataArray") -> "xr.DataArray":
    """Return means over the flips of each background: they show one place."""
    ends = "|".join(filter(None, TURNS))
    places = [re.sub(f"({ends})$", "", name) for name in values["background"].values]
    of_places = values.assign_coords(background=places).groupby("background").mean()
    return of_places.assign_attrs(values.attrs)


def differences(
    results: "xr.Dataset", metrics: Sequence[str], reference: str, axis: str = "algorithm"
) -> "xr.Dataset":
    """Return results whose metrics are how much more there is than at a value of an axis.

    They are paired, photograph by photograph. The reference itself is left out, and what fails
    there, fails everywhere. A PeriscopyError says that there is no such axis, value, or other one.
    """
    known = [str(each) for each in results["failure"].dims if each not in UNITS]
    if axis not in known:
        guess = did_you_mean(axis, known) or f"there are {', '.join(known)}"
        raise PeriscopyError(f"no axis '{axis}' to compare; {guess}")
    labels = results[axis].values.tolist()
    values = [each for each in labels if each in (reference, number_of(reference))]
    if not values:
        texts = [str(each) for each in labels]
        guess = did_you_mean(reference, texts) or f"there are {', '.join(texts)}"
        raise PeriscopyError(f"no {axis} '{reference}' in the sweep; {guess}")
    if len(labels) == 1:
        raise PeriscopyError(f"{axis} '{reference}' is alone; sweep another one to compare")
    base = results.sel({axis: values[0]}, drop=True)
    results = results.drop_sel({axis: values[0]})
    if axis == "algorithm":  # so that each looks as before
        results = results.assign_attrs(algorithms=labels)
    failure = results["failure"]
    more = {
        name: (results[name] - base[name]).assign_attrs(
            results[name].attrs, minus=reference if axis == "algorithm" else f"{axis} = {reference}"
        )
        for name in metrics
    }
    return results.assign({**more, "failure": failure.where(failure != "", base["failure"])})
