"""Photographs with all that is known about them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.archive.layout import BOUNCED_ERROR, LABELS
from periscopy_sim.dataset.configuration.document import Configuration
from periscopy_sim.dataset.making.draws import (
    NOISE,
    RENDERING,
    AmbientDraw,
    ClipDraw,
    draw_clip,
    random_seed,
)
from periscopy_sim.dataset.making.geometry import Backgrounds, Geometry, view_digest
from periscopy_sim.dataset.making.lamp_light import lamp_light
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.numerics.products import times_rows
from periscopy_sim.numerics.threads import in_parallel
from periscopy_sim.rendering.transport.bounced import (
    BouncedTransport,
    channels_mean,
)
from periscopy_sim.scenario import Array, Scenario, WallFrame, wall_frame

Block = dict[str, NDArray[Any]]
"""Each variable's values for consecutive samples."""


def make_samples(
    configuration: Configuration,
    geometry: Geometry,
    backgrounds: Backgrounds,
    start: int,
    stop: int,
) -> Block:
    """Make the samples from `start` to `stop`, multiples of the clips' length, of one geometry.

    Return the variables of `Layout.variables`, by name.
    """
    scenario, length = geometry.scenario, configuration.clip_length
    clips = [draw_clip(configuration, number) for number in range(start // length, stop // length)]
    hidden = np.concatenate([clip.hidden for clip in clips])
    signals = _signals(configuration, geometry, hidden, start)
    frame = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
    lights = in_parallel(
        lambda clip: _background(clip.ambient, scenario, frame, backgrounds), clips
    )
    kept = configuration.keep_background
    photographs = np.empty((len(hidden), *scenario.photograph_shape, 3), np.float32)
    ambient = np.empty_like(photographs if kept else photographs[:0])
    scales = np.empty(len(hidden))

    def expose(number: int) -> None:
        """Take the photographs of a clip: monitor, lamps and exposure stay as they are."""
        clip, light, first = clips[number], lights[number], number * length
        frames = slice(first, first + length)
        mean = signals[frames].mean()
        if not mean > 0:
            raise ConfigurationError(
                f"sample {start + first}: no light of the monitor reaches the wall; move what "
                "stands between them, or raise the samples of light"
            )
        if light is None:
            exposed, share = signals[frames] / mean, 1.0
        else:
            share = clip.sbr / (1 + clip.sbr)
            exposed = composite(signals[frames], np.stack([light] * length), clip.sbr)
        scales[frames] = clip.exposure * share / mean
        for k, picture in enumerate(exposed, first):
            noise = random_seed(configuration, NOISE, start + k)
            photograph = add_noise(clip.exposure * picture, clip.snr, noise)
            if configuration.saturation is not None:
                np.minimum(photograph, configuration.saturation, out=photograph)
            photographs[k] = photograph
        if kept:
            ambient[frames] = (
                0 if light is None else light * (clip.exposure * (1 - share) / light.mean())
            )

    in_parallel(expose, range(len(clips)))
    with np.errstate(over="ignore"):
        kept_photographs = photographs.astype(configuration.photograph_type, copy=False)
    if not np.isfinite(kept_photographs).all():
        raise ConfigurationError(
            f"photographs of samples {start} to {stop - 1} do not fit "
            f"{configuration.photograph_type}; lower exposure, or use float32"
        )
    block: Block = {
        "photograph": kept_photographs,
        "hidden": hidden.astype(np.float32),
        "signal_scale": scales,
        **_labels(geometry, clips, length),
    }
    if kept:
        block["background"] = ambient.astype(configuration.photograph_type, copy=False)
    return block


def _signals(
    configuration: Configuration, geometry: Geometry, hidden: Array, start: int
) -> NDArray[np.floating[Any]]:
    """Return photographs of the monitor's light alone, (n, rows, columns, 3)."""
    scenario = geometry.scenario
    if geometry.transport is None:
        assert geometry.photographer is not None
        numbers = range(start, start + len(hidden))
        seeds = [random_seed(configuration, RENDERING, number) for number in numbers]
        return np.stack(list(map(geometry.photographer, hidden, seeds)))
    f = np.moveaxis(hidden.reshape(len(hidden), -1, 3), -1, 1)  # a row for each channel
    rows = np.ascontiguousarray(f, np.float32).reshape(-1, f.shape[-1])
    A = geometry.transport
    y = times_rows(rows, channels_mean(A)).reshape(len(hidden), 3, -1)
    if isinstance(A, BouncedTransport):
        y += A.beyond_mean(np.moveaxis(f, 1, -1)).swapaxes(1, 2)
    y *= scenario.channel_gain.astype(np.float32)[:, None]
    return np.moveaxis(y, 1, -1).reshape(len(hidden), *scenario.photograph_shape, 3)


def _background(
    ambient: AmbientDraw, scenario: Scenario, frame: WallFrame, backgrounds: Backgrounds
) -> Array | None:
    """Return ambient light on the wall, (rows, columns, 3), in any unit."""
    colour = scenario.channel_gain
    if ambient.lamps is not None:
        places, powers = ambient.lamps
        lights = frame.center + places @ np.stack([frame.across, frame.normal, frame.up])
        # Each lights as much as its power tells, wherever it stands.
        light = lamp_light(lights, powers * colour, scenario.wall_points, scenario.wall_normals)
        return light.reshape(*scenario.photograph_shape, 3)
    if not ambient.mixture:
        return None
    pictures = backgrounds[view_digest(scenario)][ambient.source]
    total = np.zeros((*scenario.photograph_shape, 3))
    for which, weight, down, across in ambient.mixture:
        picture = pictures[which, :: -1 if down else 1, :: -1 if across else 1].astype(np.float64)
        total += weight / picture.mean() * picture
    return total * colour


def _labels(geometry: Geometry, clips: list[ClipDraw], length: int) -> Block:
    """Return the variables of one value for each sample, of clips of `length` frames."""
    of_frames = [(clip, frame) for clip in clips for frame in range(length)]
    values = {
        "sbr": [clip.sbr for clip, _ in of_frames],
        "snr": [clip.snr for clip, _ in of_frames],
        "exposure": [clip.exposure for clip, _ in of_frames],
        "clip_number": [clip.number for clip, _ in of_frames],
        "hidden_kind": [clip.kind for clip, _ in of_frames],
        "ambient": [clip.ambient.label for clip, _ in of_frames],
        "frame": [frame for _, frame in of_frames],
        "geometry": [geometry.draw.number] * len(of_frames),
        "split": [geometry.draw.split] * len(of_frames),
    }
    if isinstance(geometry.transport, BouncedTransport):
        values[BOUNCED_ERROR] = [geometry.transport.bounced.relative_error] * len(of_frames)
    text = np.dtypes.StringDType()
    types = {name: text if kind is str else kind for name, (kind, *_) in LABELS.items()}
    return {name: np.array(each, types[name]) for name, each in values.items()}
