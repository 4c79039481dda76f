"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli import inputs
from periscopy_sim.cli.arguments import (
    Define,
    OptionalSnr,
    OutFile,
    SceneArgument,
    Seed,
    parse_size,
)
from periscopy_sim.cli.output import fixable, say
from periscopy_sim.errors import OutputError, PeriscopyError

if TYPE_CHECKING:
    from periscopy_sim.measurement import Sensor


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
    samples: Annotated[
        int, typer.Option(min=1, max=2**20, metavar="NUMBER", help="Camera samples a pixel.")
    ] = 4096,
    ambient: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Photograph of ambient light to add, at --sbr."),
    ] = None,
    sbr: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            max=1e6,
            metavar="RATIO",
            help="Signal-to-background ratio; scales the sum to mean 1.",
        ),
    ] = None,
    snr: OptionalSnr = None,
    electrons: Annotated[
        float | None,
        typer.Option(
            min=1e-3,
            max=1e12,
            metavar="NUMBER",
            help="Expose a sensor, instead of --snr: mean electrons a value collects in a frame.",
        ),
    ] = None,
    read_noise: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e12,
            metavar="NUMBER",
            help="The sensor's read noise, electrons. [default: 2.5]",
        ),
    ] = None,
    full_well: Annotated[
        float | None,
        typer.Option(
            min=1,
            max=1e12,
            metavar="NUMBER",
            help="The sensor's full well, electrons. [default: 10000]",
        ),
    ] = None,
    bits: Annotated[
        int | None,
        typer.Option(min=4, max=32, metavar="NUMBER", help="The sensor's bit depth. [default: 12]"),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1, max=10**5, metavar="NUMBER", help="Frames of the sensor to average. [default: 1]"
        ),
    ] = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Path trace what the camera sees while the monitor shows IMAGE, as an EXR file."""
    from periscopy_sim import measurement
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.formats.exr import write_exr
    from periscopy_sim.storage.outputs.provenance import as_text
    from periscopy_sim.storage.outputs.staging import staged_file
    from periscopy_sim.storage.pictures import read_hidden_image

    if out.suffix != ".exr":
        raise OutputError(f"--out {out}: the photograph is written as .exr; name a file so")
    if (ambient is None) != (sbr is None):
        raise PeriscopyError("--ambient and --sbr go together; give both or neither")
    if snr is not None and electrons is not None:
        raise PeriscopyError("--snr and --electrons both set the noise; give one of them")
    chosen = {
        "read_noise": read_noise, "full_well": full_well, "bit_depth": bits, "frames": frames
    }  # fmt: skip
    sensor = _sensor(electrons, {name: x for name, x in chosen.items() if x is not None})
    with staged_file(out) as file:
        scenario = inputs.load(scene, hidden, define)
        shown = read_hidden_image(find_image(image), parse_size(hidden))
        background = None
        if ambient is not None:
            background = inputs.read_photograph(ambient, scenario).values
        y = inputs.photograph(scenario, shown, samples, seed)
        with fixable("photograph"):
            if background is not None and sbr is not None:
                y = measurement.composite(y, background, sbr)
            if snr is not None:
                y = measurement.add_noise(y, snr, seed)
            if sensor is not None:
                exposure = sensor.expose(y, seed)
                y, saturated = exposure.values, int(exposure.saturated.sum())
        settings: dict[str, Any] = {
            "image": image,
            "hidden": hidden,
            "samples": samples,
            "ambient": ambient,
            "sbr": sbr,
            "snr": snr,
        }
        if sensor is not None:
            settings |= {**asdict(sensor), "saturated": saturated}
        write_exr(file, y, as_text({**settings, **inputs.provenance_of(scenario, seed)}))
    say(f"wrote {out} {y.shape[0]}x{y.shape[1]}")
    if sensor is not None:
        say(f"saturated {saturated} of {y.size} values; SNR {sensor.snr:.1f} dB at mean light")


def _sensor(electrons: float | None, chosen: Mapping[str, Any]) -> Sensor | None:
    """Return the sensor that was asked for; None if none was."""
    from periscopy_sim.measurement import Sensor

    if electrons is None:
        if chosen:
            raise PeriscopyError(
                "--read-noise, --full-well, --bits and --frames describe a sensor; expose it by "
                "--electrons MEAN"
            )
        return None
    with fixable("sensor"):
        return Sensor(electrons, **chosen)
