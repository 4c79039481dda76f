"""Samples of a data set as pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.dataset.reading import open_dataset
from periscopy_sim.errors import DatasetError


def export_samples(
    path: str | Path,
    folder: Path,
    indices: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> list[str]:
    """Write samples as EXR files, and the first 24 on a contact sheet; return the files' names.

    The folder receives ``NNNNNNNN_photograph.exr`` and ``NNNNNNNN_hidden.exr`` for each sample, and
    ``sheet.png``, where a photograph is scaled to its brightest value. `progress` is called with
    the samples written and their number.
    """
    from periscopy_sim.figures.contact_sheet import draw_contact_sheet
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
            image = sample[name].values.astype(np.float32)
            written.append(f"{index:08d}_{name}.exr")
            write_exr(folder / written[-1], image, notes)
            white = 1.0 if name == "hidden" else max(image.max(), 1e-12)
            pictures.append(np.clip(image / white, 0, 1).astype(np.float64))
        light, sbr = notes["ambient"][:30], float(notes["sbr"])
        kind, split = notes["hidden_kind"], notes["split"]
        titles.append(f"{index}: {kind}\n{light}\nSBR {sbr:.2g}, {split}")
        if progress is not None:
            progress(done, len(indices))
    draw_contact_sheet(
        folder / "sheet.png", [(name, pictures[:24]) for name, pictures in sheet.items()],
        titles=titles[:24], columns=6, fontsize=5.5,
    )  # fmt: skip
    return [*written, "sheet.png"]
