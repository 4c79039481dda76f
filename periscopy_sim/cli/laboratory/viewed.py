"""What the page of `periscopy view` writes: the scene as it is set, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.cli import inputs
from periscopy_sim.cli.messages import report_sentences, residual_summary
from periscopy_sim.cli.output import say_written, write_json
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_folder

if TYPE_CHECKING:
    from periscopy_sim.live.level import LivePictures


AT_TIMES = (
    "photograph.exr", "standard_error.npy", "certainty.png", "residual.png",
)  # fmt: skip
"""What is not written for every photograph or method."""


def write_view(
    out: Path, pictures: LivePictures, given: Mapping[str, str], photo: Path | None
) -> None:
    """Write the scene with the values that the pictures are of, and these, to a folder.

    What was written there before is replaced. A PeriscopyError says what cannot be written; nothing
    is written then.
    """
    from periscopy_sim.calibration.calibrated_scene import write_copy
    from periscopy_sim.figures.panels import displayable, draw_certainty, draw_panels
    from periscopy_sim.figures.residual import draw_residual
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.storage.formats.exr import write_exr

    scenario, choice, report = pictures.scenario, pictures.choice, pictures.report
    residual = report.residual
    provenance = inputs.provenance_of(scenario, 0)
    text = as_text(provenance)
    values = dict(given) | {name: f"{value:.9g}" for name, value in choice.values.items()}
    panels = [("photograph", displayable(pictures.photograph))]
    if pictures.truth is not None:
        panels.insert(0, ("hidden image", displayable(pictures.truth, white=1)))
    panels.append(("reconstruction", displayable(pictures.image)))
    told: dict[str, Any] = {
        **asdict(choice),
        "photograph": None if photo is None else str(photo),
        "hidden_shape": scenario.hidden_shape,
        "psnr": pictures.psnr,
        "notes": report_sentences(report),
        **({} if residual is None else residual.numbers()),
        "provenance": provenance,
    }
    with staged_folder(out) as folder:
        write_copy(scenario.path, values, folder / "scene.xml")
        load_scenario(folder / "scene.xml", scenario.hidden_shape)
        if photo is None:
            write_exr(folder / "photograph.exr", pictures.photograph, text)
        np.save(folder / "reconstruction.npy", pictures.image)
        draw_panels(folder / "pictures.png", panels, metadata=text)
        if report.standard_errors is not None:
            np.save(folder / "standard_error.npy", report.standard_errors.astype(np.float32))
            draw_certainty(
                folder / "certainty.png", pictures.image, report.standard_errors, metadata=text
            )
        if residual is not None:
            caption = residual_summary(residual)
            draw_residual(folder / "residual.png", pictures.photograph, residual, caption, text)
        write_json(folder / "view.json", told)
        names = sorted(file.name for file in folder.iterdir())
    for name in set(AT_TIMES).difference(names):
        (out / name).unlink(missing_ok=True)  # of other pictures than those beside it
    say_written(*(out / name for name in names))
