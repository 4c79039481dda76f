"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.output import fixable, say
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.measurement import Sensor


def photograph(
    scene: arguments.SceneArgument,
    image: Annotated[
        str,
        typer.Argument(metavar="IMAGE", help="What the monitor shows: a file, or a shipped image."),
    ],
    out: arguments.OutFile,
    hidden: Annotated[
        str, option("ROWSxCOLUMNS", "Patches to average the image down to.")
    ] = "29x36",
    samples: Annotated[int, option("NUMBER", "Camera samples a pixel.", min=1, max=2**20)] = 4096,
    ambient: Annotated[
        Path | None, option("FILE", "Photograph of ambient light to add, at --sbr.")
    ] = None,
    sbr: Annotated[
        float | None,
        option(
            "RATIO",
            "Signal-to-background ratio, monitor's light over ambient; scales the sum to mean 1.",
            min=1e-6,
            max=1e6,
        ),
    ] = None,
    snr: arguments.OptionalSnr = None,
    electrons: Annotated[
        float | None,
        option(
            "NUMBER",
            "Expose a sensor, instead of --snr: mean electrons a value collects in a frame.",
            min=1e-3,
            max=1e12,
        ),
    ] = None,
    read_noise: Annotated[
        float | None,
        option("NUMBER", "The sensor's read noise, electrons. [default: 2.5]", min=0, max=1e12),
    ] = None,
    full_well: Annotated[
        float | None,
        option("NUMBER", "The sensor's full well, electrons. [default: 10000]", min=1, max=1e12),
    ] = None,
    bits: Annotated[
        int | None, option("NUMBER", "The sensor's bit depth. [default: 12]", min=4, max=32)
    ] = None,
    frames: Annotated[
        int | None,
        option("NUMBER", "Frames of the sensor to average. [default: 1]", min=1, max=10**5),
    ] = None,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
) -> None:
    """Path trace what the camera sees, as an EXR file.

    The monitor shows IMAGE. Without --snr or --electrons no noise is added.
    """
    from periscopy_sim import measurement
    from periscopy_sim.storage.formats.exr import write_exr

    arguments.require_suffix(out, ".exr", "the photograph")
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
        shown = inputs.hidden_image(image, scenario.hidden_shape)
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
