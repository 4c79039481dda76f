"""Samples as files that people look at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.dataset.reading import open_dataset
from periscopy_sim.errors import DatasetError

if TYPE_CHECKING:
    import xarray as xr

SHEET_SIZE = 12
"""Samples on a contact sheet."""


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
    from periscopy_sim.storage.exr import write_exr
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
    """Draw samples side by side: photographs, each scaled to its brightest value, hidden images.

    Parameters
    ----------
    file
        A PNG file.
    data
        From `open_dataset`.
    indices
        Of the samples.
    """
    from periscopy_sim.evaluation.contact_sheet import draw_contact_sheet

    samples = [data.isel(sample=index) for index in indices]
    photographs = [_shown(sample["photograph"].values, None) for sample in samples]
    hidden = [_shown(sample["hidden"].values, 1.0) for sample in samples]
    draw_contact_sheet(
        file,
        [("photograph", photographs), ("hidden", hidden)],
        titles=[_title(sample) for sample in samples],
        notes=[_note(sample) for sample in samples],
    )


def _labels(data: xr.Dataset) -> list[str]:
    return [str(name) for name in data.variables if data[name].dims == ("sample",)]


def _shown(image: Any, white: float | None) -> Any:
    light = np.maximum(np.asarray(image, np.float64), 0)
    return np.clip(light / (white or max(light.max(), 1e-12)), 0, 1)


def _title(sample: xr.Dataset) -> str:
    return f"{sample['hidden_kind'].item()}\n{str(sample['ambient'].item())[:18]}"


def _note(sample: xr.Dataset) -> str:
    return f"SBR {sample['sbr'].item():.2g}\n{sample['split'].item()}"
