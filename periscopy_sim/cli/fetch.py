"""`periscopy fetch`: published photographs, downloaded and made ready for `reconstruct`."""

import shutil
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from periscopy_sim.cli.options import argument, option
from periscopy_sim.cli.output import output_folder, progress, record, show_table, written
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.published import fetch as fetch_set
from periscopy_sim.storage.published import published_sets

Name = Annotated[str, argument("[NAME]", "A set; all are listed without it.")]
Out = Annotated[Path | None, option("DIR", "Folder to copy the set into.")]


def fetch(name: Name = "", out: Out = None) -> None:
    """Download published photographs.

    Files as their authors lay them out, and an NPZ file of each photograph for `reconstruct`.
    """
    sets = published_sets()
    if not name and out is not None:
        raise PeriscopyError("--out: name the set to fetch")
    if not name:
        show_table([each, f"{len(data.files)} files", data.what] for each, data in sets.items())
        record(**{each: data.what for each, data in sets.items()})
        return
    with progress(f"fetching {name}", "files") as report:
        folder = fetch_set(name, report)
    data_set = sets[name]
    values = "".join(f" -D {key}={value:g}" for key, value in data_set.parameters.items())
    about = {entry: getattr(data_set, entry) for entry in ("cite", "licence", "geometry")}
    about["scene"] = f"--scene {data_set.scene}{values}"
    show_table(about.items())
    record(**about)
    if out is None:
        written(folder)
        return
    with output_folder(out) as staged:
        for file in data_set.files:
            (staged / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / file, staged / file)
        for each, arrays in data_set.arrays(folder):
            named: dict[str, Any] = dict(arrays)
            np.savez(staged / f"{each}.npz", **named)
