"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from periscopy_sim.cli import scene as scenes
from periscopy_sim.cli.arguments import (
    Define,
    OutFile,
    SceneArgument,
    Seed,
    mendable,
    parse_size,
    say,
)
from periscopy_sim.errors import OutputError, PeriscopyError


def photograph(
    scene: SceneArgument,
    image: Annotated[
        str,
        typer.Argument(metavar="IMAGE", help="What the monitor shows: a file, or a shipped image."),
    ],
    out: OutFile,
    hidden: Annotated[
        str, typer.Option(metavar="ROWSxCOLUMNS", help="Patches to average the image down to.")
    ] = "29x36",
    samples: Annotated[int, typer.Option(min=1, help="Camera samples a pixel.")] = 4096,
    ambient: Annotated[
        Path | None, typer.Option(help="Photograph of ambient light to add, at --sbr.")
    ] = None,
    sbr: Annotated[
        float | None,
        typer.Option(
            min=1e-6, max=1e6, help="Signal-to-background ratio; scales the sum to mean 1."
        ),
    ] = None,
    snr: Annotated[
        float | None,
        typer.Option(
            min=-100, max=300, help="Add Gaussian noise at this signal-to-noise ratio, dB."
        ),
    ] = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Path trace what the camera sees while the monitor shows IMAGE, as an EXR file."""
    from periscopy_sim import measurement
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.exr import write_exr
    from periscopy_sim.storage.output import staged_file
    from periscopy_sim.storage.pictures import read_hidden_image
    from periscopy_sim.storage.provenance import as_text

    if out.suffix != ".exr":
        raise OutputError(f"--out {out}: the photograph is written as .exr; name a file so")
    if (ambient is None) != (sbr is None):
        raise PeriscopyError("--ambient and --sbr go together; give both or neither")
    with staged_file(out) as file:
        scenario = scenes.load(scene, hidden, define)
        shown = read_hidden_image(find_image(image), parse_size(hidden))
        background = None
        if ambient is not None:
            background = scenes.read_photograph(ambient, scenario).values
        y = scenes.photograph(scenario, shown, samples, seed)
        with mendable("photograph"):
            if background is not None and sbr is not None:
                y = measurement.composite(y, background, sbr)
            if snr is not None:
                y = measurement.add_noise(y, snr, seed)
        settings = {
            "image": image,
            "hidden": hidden,
            "samples": samples,
            "ambient": ambient,
            "sbr": sbr,
            "snr": snr,
        }
        write_exr(file, y, as_text({**settings, **scenes.provenance_of(scenario, seed)}))
    say(f"wrote {out} {y.shape[0]}x{y.shape[1]}")
