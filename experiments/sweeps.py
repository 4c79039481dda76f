"""Sweeps of the page: methods over ambient light, signal-to-background ratios and noise draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.setting import SNR, Measured, Setting, package_sha256
from periscopy_sim.storage.outputs.provenance import array_sha256

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]


def swept(
    setting: Setting,
    name: str,
    measured: Measured,
    methods: Mapping[str, Any],
    backgrounds: Mapping[str, Array],
    sbrs: Sequence[float],
    draws: int = 1,
    **fitted: float,
) -> xr.Dataset:
    """Reconstruct composites by several methods, or read what an earlier run left.

    Parameters
    ----------
    setting
        Folder, seed and matrices that the methods were fitted to.
    name
        Of the sweep's folder.
    measured
        The photograph without ambient light.
    methods, backgrounds, sbrs
        What is varied.
    draws
        Of the noise, for each background and SBR.
    **fitted
        Settings of the methods that are not their defaults: with others the folder is not taken up.

    Returns
    -------
    xarray.Dataset
        See `periscopy_sim.run_sweep`.
    """
    code = package_sha256()
    sweep = ps.Sweep(
        ps.World({name: measured.signal}, {name: measured.truth}, backgrounds, methods),
        sbrs=sbrs,
        snrs=[SNR],
        seeds=range(draws),
        seed=setting.seed,
        conditions={
            "A_sha256": array_sha256(setting.A),
            "B_sha256": array_sha256(setting.B),
            "package_sha256": code,
            **fitted,
        },
    )
    folder = setting.out / "sweeps" / f"{name.replace(' ', '')}-{code[:8]}"
    return ps.run_sweep(sweep, folder).squeeze(["image", "snr"], drop=True)


def of_method(results: xr.Dataset, method: str) -> xr.Dataset:
    """Return one method's part of a sweep's results."""
    return results.sel(algorithm=method)


def errors_of(results: xr.Dataset, method: str, *, registered: bool = False) -> Array:
    """Return a method's mean squared errors, unshifted or after the best shift.

    Returns
    -------
    ndarray
        (SBRs, backgrounds, draws).
    """
    found = of_method(results, method).transpose("sbr", "background", "seed", ...)
    if registered:
        return np.asarray(10 ** (-found["psnr_registered"] / 10))
    return np.asarray(found["mean_squared_error"])
