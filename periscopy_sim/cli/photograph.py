"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim import measurement
from periscopy_sim.cli import options
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import LIGHT, option
from periscopy_sim.cli.output import fixable, say
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError, PhotographError, did_you_mean
from periscopy_sim.model.noise import camera_noise
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.scenario import Array

MOST_SAMPLES = 2**20
"""Camera samples a pixel, which may take hours."""

_sensor_number = partial(option, "NUMBER", group="Sensor")


def photograph(
    session: Annotated[Session, {"hidden": "29x36"}],
    image: Annotated[
        str, typer.Argument(metavar="IMAGE", help="The hidden image: a file, or a shipped one.")
    ],
    out: options.OutFile,
    samples: Annotated[
        int, option("NUMBER", "Camera samples a pixel.", min=1, max=MOST_SAMPLES, group=LIGHT)
    ] = 4096,
    ambient: Annotated[
        str | None,
        option("LIGHT", "Ambient light to add: a photograph or a shipped condition.", group=LIGHT),
    ] = None,
    sbr: Annotated[
        float | None,
        option("RATIO", "Signal-to-background ratio.", min=1e-6, max=1e6, group=LIGHT),
    ] = None,
    colour_matrix: options.ColourMatrixOption = None,
    snr: options.OptionalSnr = None,
    electrons: Annotated[
        float | None,
        _sensor_number("Mean electrons of a value, instead of --snr.", min=1e-3, max=1e12),
    ] = None,
    read_noise: Annotated[
        float | None, _sensor_number("Read noise, electrons. [default: 2.5]", min=0, max=1e12)
    ] = None,
    full_well: Annotated[
        float | None, _sensor_number("Full well, electrons. [default: 10000]", min=1, max=1e12)
    ] = None,
    bits: Annotated[int | None, _sensor_number("Bit depth. [default: 12]", min=4, max=32)] = None,
    frames: Annotated[
        int | None, _sensor_number("Frames to average. [default: 1]", min=1, max=10**5)
    ] = None,
) -> None:
    """Path trace a photograph of the wall, as an EXR file.

    The photograph has noise if you give --snr or --electrons.
    """
    options.require_suffix(out, ".exr", "the photograph")
    if (ambient is None) != (sbr is None):
        raise PeriscopyError("--ambient and --sbr go together; give both or neither")
    if snr is not None and electrons is not None:
        raise PeriscopyError("--snr and --electrons both set the noise; give one of them")
    described: dict[str, Any] = {
        "read_noise": read_noise, "full_well": full_well, "bit_depth": bits, "frames": frames
    }  # fmt: skip
    described = {name: value for name, value in described.items() if value is not None}
    if described and electrons is None:
        raise PeriscopyError(f"{', '.join(described)} of a sensor need --electrons")
    with fixable("sensor"):
        sensor = None if electrons is None else measurement.Sensor(electrons, **described)
    colours = None if colour_matrix is None else ps.read_colour_matrix(colour_matrix)
    settings: dict[str, Any] = {
        "image": image, "hidden": session.hidden, "samples": samples, "ambient": ambient,
        "sbr": sbr, "snr": snr,
        "colour_matrix": None if colours is None else colours.matrix.tolist(),
    }  # fmt: skip
    with staged_file(out) as file:
        shown = session.hidden_image(image)
        background = None if ambient is None else _ambient_light(ambient, session)
        y = session.synthetic_photograph(shown, samples)
        grain, added = _grain(y), math.inf
        with fixable("photograph"):
            if background is not None and sbr is not None:
                signal, y = y, measurement.composite(y, background, sbr)
                grain *= float(y.mean() / signal.mean()) * sbr / (1 + sbr)
            y = y if colours is None else colours.mix(y)
            level = float(np.sqrt(np.mean(y**2)))
            if snr is not None:
                added = measurement.noise_level(y, snr)
                y = measurement.add_noise(y, snr, session.seed)
            if sensor is not None:
                added = 10 ** (-sensor.snr / 20) * float(y.mean())
                exposure = sensor.expose(y, session.seed)
                y, saturated = exposure.values, int(exposure.saturated.sum())
                settings |= {**asdict(sensor), "saturated": saturated}
        write_exr(file, y, as_text({**settings, **session.provenance}))
    say(f"wrote {out} {y.shape[0]}x{y.shape[1]}")
    if grain > added:
        percent = 100 / level
        session.warn(sentence("grainy", file=out, own=percent * grain, added=percent * added))
    if sensor is not None:
        say(f"saturated {saturated} of {y.size} values; SNR {sensor.snr:.1f} dB at mean light")


def _ambient_light(name: str, session: Session) -> Array:
    """Return ambient light, (rows, columns, 3), of a file or of a shipped condition."""
    shipped = (*REALISTIC, *ADVERSARIAL)
    if Path(name).is_file():
        return session.photograph(Path(name)).values
    if name not in shipped:
        guess = did_you_mean(name, shipped)
        raise PhotographError(f"--ambient {name}: no such file or shipped condition; {guess}")
    return session.ambient_light(name)


def _grain(photograph: Array) -> float:
    """Return the root mean square of the path tracing's standard error."""
    noise = camera_noise(np.moveaxis(photograph, 2, 0))
    return 0.0 if noise is None else float(np.sqrt(np.mean(noise**2)))
