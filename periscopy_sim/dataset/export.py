"""Samples of a data set as pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.dataset.reading import open_dataset
from periscopy_sim.errors import DatasetError

if TYPE_CHECKING:
    import xarray as xr

SHEET_SIZE, SHEET_COLUMNS = 24, 6
"""Samples on a contact sheet, and beside each other on it."""


def export_samples(
    path: str | Path,
    folder: Path,
    indices: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> list[str]:
    """Write samples as EXR and PNG files, and some of them on a contact sheet; return their names.

    The folder receives ``NNNNNNNN_photograph.exr`` and ``.png``, ``NNNNNNNN_hidden.exr`` and
    ``.png`` for each sample, and ``sheet.png``. A PNG repeats each pixel to be seen, and a
    photograph's is scaled to its brightest value. `progress` is called with the samples written and
    their number.
    """
    from periscopy_sim.figures.contact_sheet import draw_contact_sheet
    from periscopy_sim.figures.panels import write_enlarged
    from periscopy_sim.storage.formats.exr import write_exr

    data = open_dataset(path, incomplete=True)
    last = data.sizes["sample"] - 1
    if beyond := [index for index in indices if not 0 <= index <= last]:
        raise DatasetError(f"{path}: has no sample {beyond[0]}; it has 0 to {last}")
    labels = [name for name, values in data.variables.items() if values.dims == ("sample",)]
    written, titles = [], []
    sheet: dict[str, list[Any]] = {"photograph": [], "hidden": []}
    for done, index in enumerate(indices, 1):
        sample = data.isel(sample=index).load()
        notes = {str(name): str(sample[name].item()) for name in labels}
        for name, pictures in sheet.items():
            image, stem = sample[name].values.astype(np.float32), f"{index:08d}_{name}"
            white = 1.0 if name == "hidden" else max(image.max(), 1e-12)
            shown = np.clip(image / white, 0, 1).astype(np.float64)
            write_exr(folder / f"{stem}.exr", image, notes)
            write_enlarged(folder / f"{stem}.png", shown, notes)
            written += [f"{stem}.exr", f"{stem}.png"]
            if done <= SHEET_SIZE:
                pictures.append(shown)
        titles.append(_title(sample, index))
        if progress is not None:
            progress(done, len(indices))
    draw_contact_sheet(
        folder / "sheet.png", list(sheet.items()), titles=titles[:SHEET_SIZE],
        columns=SHEET_COLUMNS, fontsize=5.5,
    )  # fmt: skip
    return [*written, "sheet.png"]


def _title(sample: xr.Dataset, index: int) -> str:
    kind, light, split = (str(sample[name].item()) for name in ("hidden_kind", "ambient", "split"))
    return f"{index}: {kind}\n{light[:30]}\nSBR {sample['sbr'].item():.2g}, {split}"
