"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.output import fixable, progress, say, warn
from periscopy_sim.errors import PeriscopyError, PhotographError, did_you_mean
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.measurement import Sensor
    from periscopy_sim.scenario import Array, Scenario

MOST_SAMPLES = 2**20
"""Camera samples a pixel, which may take hours."""


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
    samples: Annotated[
        int, option("NUMBER", "Camera samples a pixel.", min=1, max=MOST_SAMPLES)
    ] = 4096,
    ambient: Annotated[
        str | None,
        option(
            "LIGHT",
            "Ambient light to add, at --sbr: a photograph of it, or a shipped condition, which is "
            f"path traced: {', '.join((*REALISTIC, *ADVERSARIAL))}.",
        ),
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
            background = _ambient_light(ambient, scenario, seed)
        y = inputs.photograph(scenario, shown, samples, seed)
        inputs.warn_of_long_patches(scenario, scene)
        grain = _grain(scenario, y)
        grainy = ""
        with fixable("photograph"):
            if background is not None and sbr is not None:
                signal, y = y, measurement.composite(y, background, sbr)
                grain *= float(y.mean() / signal.mean()) * sbr / (1 + sbr)
            if snr is not None:
                grainy = _grainy(grain, measurement.noise_level(y, snr), y, samples)
                y = measurement.add_noise(y, snr, seed)
            if sensor is not None:
                grainy = _grainy(grain, 10 ** (-sensor.snr / 20) * float(y.mean()), y, samples)
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
    if grainy:
        warn(f"{out}: {grainy}")
    if sensor is not None:
        say(f"saturated {saturated} of {y.size} values; SNR {sensor.snr:.1f} dB at mean light")


def _ambient_light(name: str, scenario: Scenario, seed: int) -> Array:
    """Return ambient light, (rows, columns, 3), of a file or of a shipped condition."""
    if Path(name).is_file() or name not in (*REALISTIC, *ADVERSARIAL):
        if not Path(name).is_file() and (guess := did_you_mean(name, (*REALISTIC, *ADVERSARIAL))):
            raise PhotographError(f"--ambient {name}: no such file or shipped condition; {guess}")
        return inputs.read_photograph(Path(name), scenario).values
    from periscopy_sim.rendering.ambient.background import render_background

    with progress("path tracing the ambient light") as report:
        return render_background(
            f"ambient/{name}", scenario, target=3e-4, seed=seed + 1, progress=report
        ).photograph


def _grain(scenario: Scenario, photograph: Array) -> float:
    """Return the path tracing's standard error, the root mean square of those of the channels.

    It is told from neighbouring pixels, and 0 where it cannot be: those of a textured wall differ.
    """
    from periscopy_sim.model.noise import camera_noise

    noise = camera_noise(np.moveaxis(photograph, 2, 0))
    if noise is None or scenario.wall_texture is not None:
        return 0.0
    return float(np.sqrt(np.mean(noise.σ**2)))


def _grainy(grain: float, added: float, photograph: Array, samples: int) -> str:
    """Return that the path tracing's standard error exceeds the noise that is added; or nothing."""
    if grain <= added:
        return ""
    own, asked = 100 * np.array([grain, added]) / np.sqrt(np.mean(photograph**2))
    enough = samples * (grain / added) ** 2
    most = min(2 ** math.ceil(math.log2(enough)), MOST_SAMPLES)
    return (
        f"the path tracing's own noise is {own:.2g} % of the photograph, more than the "
        f"{asked:.2g} % that was asked for; more samples lessen it: --samples {most}"
    )


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
