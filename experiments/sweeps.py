"""Studies of the page: what `periscopy sweep` varies, as a YAML file beside the figure says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.report import Picture, Table
from experiments.setting import SNR, Setting, package_sha256
from periscopy_sim.cli import app
from periscopy_sim.evaluation.sweep_store import read_sweep
from periscopy_sim.figures.style import COLUMN, PAGE
from periscopy_sim.figures.sweeps import draw_sweep
from periscopy_sim.storage.rasters import write_exr

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]


def swept(setting: Setting, figure: str, light: Mapping[str, Array]) -> xr.Dataset:
    """Run the study beside a figure's file on the setting's photograph, or read what it left.

    The photographs of ambient light are (rows, columns, 3), by name. See `periscopy_sim.run_sweep`;
    axes of a single value are dropped, but the methods'.
    """
    study, measured = Path(figure).with_suffix(".yaml"), setting.measured
    folder = setting.out / "sweeps" / f"{study.stem}-{measured.kind}-{package_sha256()[:8]}"
    given = folder.with_name(f"{study.stem}-given")
    (given / "light").mkdir(parents=True, exist_ok=True)
    write_exr(given / "photograph.exr", measured.signal, {})
    np.save(given / "truth.npy", measured.truth)
    files = [given / "light" / f"{name}.exr" for name in light]
    for file, photograph in zip(files, light.values(), strict=True):
        write_exr(file, photograph, {})
    define = [f"-D{name}={value}" for name, value in (setting.parameters or {}).items()]
    app(
        [
            "sweep", str(setting.scene), *define, "--study", str(study),
            "--hidden", "{}x{}".format(*setting.hidden), "--seed", str(setting.seed),
            "--photograph", str(given / "photograph.exr"), "--truth", str(given / "truth.npy"),
            "--ambient", ",".join(map(str, files)), "--snr", str(SNR), "--out", str(folder),
        ],
        standalone_mode=False,
    )  # fmt: skip
    results = read_sweep(folder / "sweep.zarr")
    sizes = results["failure"].sizes
    return results.squeeze([n for n in sizes if sizes[n] == 1 and n != "algorithm"], drop=True)


def recovered(results: xr.Dataset, truth: Array, **at: Any) -> list[tuple[str, Array]]:
    """Return each method's image, gain-matched, at values of the other axes, with its error."""
    panels = []
    for method in results["algorithm"].values.tolist():
        cell = results.sel(algorithm=method, **at)
        image = ps.gain_matched(cell["reconstruction"].values, truth)
        panels.append((f"{method.rpartition(':')[2]}: {cell['mean_squared_error']:.3f}", image))
    return panels


def tabulated(caption: str, values: xr.DataArray, digits: str = ".4f") -> Table:
    """Tabulate values over two axes, the second one across."""
    down, across = values.dims
    return Table(
        caption,
        (f"{down}, {across}", *map(str, values[across].values.tolist())),
        [
            (
                str(each[down].values).replace("_", " "),
                *(f"{cell:{digits}}" for cell in each.values),
            )
            for each in values
        ],
    )


def drawn_sweep(
    setting: Setting, name: str, errors: xr.DataArray, caption: str, **axes: str
) -> Picture:
    """Draw mean squared errors as `periscopy plot` does; see `draw_sweep` for the axes."""
    import xarray as xr

    failure = xr.where(errors.isnull(), "no image", "")
    results = xr.Dataset({"mean_squared_error": errors, "failure": failure})
    file = setting.out / f"{name}.png"
    width = PAGE if axes else COLUMN
    draw_sweep(file, results, metric="mean_squared_error", width=width, **axes)
    return Picture(file, caption)
