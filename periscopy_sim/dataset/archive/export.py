"""Samples as files that people look at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.dataset.archive.reading import open_dataset
from periscopy_sim.errors import DatasetError

if TYPE_CHECKING:
    import xarray as xr

SHEET_SIZE, SHEET_COLUMNS = 24, 6
"""Samples on a contact sheet, and beside each other on it."""

PATCHES = ("hidden_row", "hidden_column")


def export_samples(
    path: str | Path,
    folder: Path,
    indices: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> list[str]:
    """Write samples as EXR and PNG files, and some of them on a contact sheet.

    Parameters
    ----------
    path
        The data set.
    folder
        Receives ``NNNNNNNN_photograph.exr`` and ``.png``, ``NNNNNNNN_hidden.exr`` and ``.png`` for
        each sample, and ``sheet.png``. A photograph's PNG is scaled to its brightest value.
    indices
        Of the samples.
    progress
        Called with the samples written and their number.

    Returns
    -------
    list of str
        The names of the files.

    Raises
    ------
    DatasetError
        If a sample is not there.
    """
    from periscopy_sim.storage.formats.exr import write_exr
    from periscopy_sim.storage.pictures import write_png

    data = open_dataset(path, incomplete=True)
    count = data.sizes["sample"]
    for index in indices:
        if not 0 <= index < count:
            raise DatasetError(f"{path}: has no sample {index}; it has 0 to {count - 1}")
    written = []
    for done, index in enumerate(indices, 1):
        sample = data.isel(sample=index)
        notes = {name: str(sample[name].item()) for name in _labels(data)}
        for name, white in {"photograph": None, "hidden": 1.0}.items():
            image = sample[name].values.astype(np.float32)
            stem = f"{index:08d}_{name}"
            write_exr(folder / f"{stem}.exr", image, notes)
            write_png(folder / f"{stem}.png", _shown(image, white), notes)
            written += [f"{stem}.exr", f"{stem}.png"]
        if progress is not None:
            progress(done, len(indices))
    draw_sheet(folder / "sheet.png", data, list(indices)[:SHEET_SIZE])
    return [*written, "sheet.png"]


def draw_sheet(file: Path, data: xr.Dataset, indices: Sequence[int]) -> None:
    """Draw photographs, each scaled to its brightest value, with the hidden image beneath each.

    Parameters
    ----------
    file
        A PNG file.
    data
        From `open_dataset`.
    indices
        Of the samples.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from periscopy_sim.storage.formats.srgb import srgb_encode

    columns = min(len(indices), SHEET_COLUMNS)
    lines = -(-len(indices) // columns)
    aspects = [data.sizes[d] / data.sizes[w] for d, w in (("row", "column"), PATCHES)]
    size = 1.7 * columns, (1.62 * sum(aspects) + 0.6) * lines
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(hspace=0.005, h_pad=0.01))
    axes = figure.subplots(2 * lines, columns, height_ratios=aspects * lines, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for place, index in enumerate(indices):
        sample = data.isel(sample=index)
        line, column = divmod(place, columns)
        above, beneath = axes[2 * line : 2 * line + 2, column]
        above.imshow(srgb_encode(_shown(sample["photograph"].values, None)))
        above.set_title(_title(sample, index), fontsize=7)
        beneath.imshow(srgb_encode(_shown(sample["hidden"].values, 1.0)), interpolation="nearest")
    figure.savefig(file, dpi=160)


def _labels(data: xr.Dataset) -> list[str]:
    return [str(name) for name in data.variables if data[name].dims == ("sample",)]


def _shown(image: Any, white: float | None) -> Any:
    light = np.maximum(np.asarray(image, np.float64), 0)
    return np.clip(light / (white or max(light.max(), 1e-12)), 0, 1)


def _title(sample: xr.Dataset, index: int) -> str:
    ambient = str(sample["ambient"].item())
    light = ambient if len(ambient) < 30 else f"{ambient[:27]}..."
    ratio = f"SBR {sample['sbr'].item():.2g}, " if np.isfinite(sample["sbr"].item()) else ""
    return f"{index}: {sample['hidden_kind'].item()}\n{light}\n{ratio}{sample['split'].item()}"
