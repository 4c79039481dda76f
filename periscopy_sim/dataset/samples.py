"""Samples of a data set: their random draws, the scenes that they are of, photographs and labels.

Each draw follows from the seed and a number alone: any sample can be made by itself, in any order,
on any machine. Geometries, clips and noise have streams of their own: one that takes more draws
than before leaves the others as they are.
"""

import threading
import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.point_light import responses
from periscopy_sim.dataset.configuration import (
    SPLITS,
    Bounced,
    Conditions,
    Configuration,
    Darkness,
    Distribution,
    Lamps,
    Pictures,
    Source,
)
from periscopy_sim.dataset.reading import BOUNCED_ERROR, LABELS
from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.hidden import named
from periscopy_sim.light import Light
from periscopy_sim.measurement import add_noise, allowed_error
from periscopy_sim.numerics import Array, products
from periscopy_sim.numerics.machine import Stage, in_parallel
from periscopy_sim.rendering.bounced import BouncedTransport, channels_mean
from periscopy_sim.scenario import Scenario, load_scenario
from periscopy_sim.storage.photographs import read_photograph

GEOMETRY, CLIP, NOISE, SPLIT = 0, 1, 2, 4
"""Streams of random numbers."""


@dataclass(frozen=True)
class GeometryDraw:
    """A scene with values for its parameters; `source` counts the configuration's scenes."""

    number: int  # of the data set's geometries, from 0
    source: int
    parameters: dict[str, str]
    split: str  # one of `SPLITS`


@dataclass(frozen=True, eq=False)
class AmbientDraw:
    """Ambient light of a clip; `source` counts the configuration's.

    For each added picture, `mixture` holds its position within the source's names or files,
    its weight, and whether it is turned upside down and left to right.
    """

    source: int
    label: str  # lamps, none, or the names of the mixed pictures
    lamps: tuple[Array, Array] | None = None  # (L, 3) places and (L, 3) powers
    mixture: tuple[tuple[int, float, bool, bool], ...] = ()


@dataclass(frozen=True, eq=False)
class ClipDraw:
    """The hidden frames of a clip, and the light that they share."""

    number: int  # of the data set's clips, from 0
    hidden: dict[str, Array]  # (frames, R, C, 3) linear light, by the archive's variables
    kind: str  # of hidden image
    ambient: AmbientDraw
    sbr: float  # infinite without ambient light
    snr: float
    exposure: float


def generator(configuration: Configuration, stream: int, number: int) -> np.random.Generator:
    """Return the random generator of one of the streams above and a number in it."""
    return np.random.default_rng([configuration.seed, stream, number])


def draw_geometry(configuration: Configuration, number: int) -> GeometryDraw:
    """Draw a scene, its parameters and its split.

    The splits follow multiples of the golden ratio, so that any number of geometries is shared
    among them as nearly by their sizes as it can be, the first to the largest. A scene of which
    nothing varies continuously comes again: its splits follow from what it is.
    """
    golden = (np.sqrt(5) - 1) / 2  # its multiples mod 1 fill [0, 1) most evenly at any count
    rng = generator(configuration, GEOMETRY, number)
    source = _weighted(rng, configuration.scenes)
    scene = configuration.scenes[source]
    parameters = {
        name: given if isinstance(given, str) else f"{given.draw(rng):.9g}"
        for name, given in scene.parameters.items()
    }
    sizes = np.array([getattr(configuration.splits, name) for name in SPLITS])
    edges = np.cumsum(sizes)
    if any(isinstance(q, Distribution) and q.is_continuous for q in scene.parameters.values()):
        largest = int(sizes.argmax())  # the first is in its middle: few geometries are for training
        place = (edges[largest] - sizes[largest] / 2 + number * golden) % 1
    else:
        # By the file's name, not its folder: the same data set on every machine.
        identity = (Path(scene.scene).name, sorted(parameters.items()))
        place = generator(configuration, SPLIT, zlib.crc32(repr(identity).encode())).random()
    split = min(int(np.searchsorted(edges, place, side="right")), len(SPLITS) - 1)
    return GeometryDraw(number, source, parameters, SPLITS[split])


def draw_clip(configuration: Configuration, number: int) -> ClipDraw:
    """Draw the frames and the light of a clip."""
    rng = generator(configuration, CLIP, number)
    source = configuration.hidden_images[_weighted(rng, configuration.hidden_images)]
    frames = configuration.clip_length
    # Every draw is taken, even of an SBR that darkness does not use: other settings of one kind of
    # draw leave the later ones as they are.
    hidden = {
        name: np.broadcast_to(source.draw(rng, size, frames), (frames, *size, 3))
        for name, size in named("hidden", configuration.hidden).items()
    }
    ambient = _draw_ambient(configuration, rng)
    sbr, snr, exposure = (getattr(configuration, n).draw(rng) for n in ("sbr", "snr", "exposure"))
    dark = ambient.lamps is None and not ambient.mixture
    return ClipDraw(number, hidden, source.kind, ambient, np.inf if dark else sbr, snr, exposure)


def _draw_ambient(configuration: Configuration, rng: np.random.Generator) -> AmbientDraw:
    number = _weighted(rng, configuration.ambient)
    source = configuration.ambient[number]
    if isinstance(source, Lamps):
        return AmbientDraw(number, "lamps", lamps=source.draw(rng))
    if isinstance(source, Darkness):
        return AmbientDraw(number, "none")
    names = source.names if isinstance(source, Conditions) else source.files
    count = min(round(source.mixed.draw(rng)), len(names))
    chosen = np.sort(rng.choice(len(names), count, replace=False)).tolist()
    # Uniform over all mixtures: weights that add up to 1.
    weights = rng.dirichlet(np.ones(count)) if count > 1 else np.ones(1)
    turned = rng.random((count, 2)) < (0.5 if source.flip else 0)
    mixture = tuple(zip(chosen, weights.tolist(), *turned.T.tolist(), strict=True))
    label = " + ".join(Path(names[which]).stem for which in chosen)
    return AmbientDraw(number, label, mixture=mixture)


def _weighted(rng: np.random.Generator, sources: Sequence[Source]) -> int:
    edges = np.cumsum([source.weight for source in sources])
    return int(np.searchsorted(edges / edges[-1], rng.random(), side="right"))


Block = dict[str, NDArray[Any]]
"""Each variable's values for consecutive samples."""


def make_samples(
    configuration: Configuration,
    geometry: "RenderedGeometry",
    backgrounds: "Backgrounds",
    start: int,
    stop: int,
) -> Block:
    """Make the samples from `start` to `stop`, multiples of the clips' length, of one geometry.

    Return the variables of `Layout.variables`, by name.
    """
    scenario, length = geometry.scenario, configuration.clip_length
    sources = configuration.ambient
    clips = [draw_clip(configuration, number) for number in range(start // length, stop // length)]
    of_surfaces = named("hidden", scenario.hidden)
    hidden = {name: np.concatenate([clip.hidden[name] for clip in clips]) for name in of_surfaces}
    colours = configuration.colours
    mixed = np.asarray if colours is None else colours.mix
    signals = mixed(_signals(geometry, [*hidden.values()]))
    photographs = np.empty(signals.shape, np.float32)
    ambient = np.zeros_like(photographs if configuration.keep_background else photographs[:0])
    scales = np.empty(len(signals))

    def expose(number: int) -> None:
        """Take the photographs of a clip: monitor, lamps and exposure stay as they are."""
        clip, frames = clips[number], slice(number * length, (number + 1) * length)
        light = _background(clip.ambient, scenario, backgrounds)
        if light is not None and not isinstance(sources[clip.ambient.source], Pictures):
            light = mixed(light)  # pictures are in the camera's channels
        mean = signals[frames].mean(dtype=np.float64)  # of the clip: frames may differ
        if not mean > 0:
            raise ConfigurationError(
                f"sample {start + frames.start}: no light of the monitor reaches the wall; move "
                "what stands between them, or raise the samples of light"
            )
        # y = t (s M A f / mean M A f + (1 - s) b / mean b): exposure t, the monitor's share s of a
        # light of unit mean, so that exposure and SBR vary independently.
        share = 1.0 if light is None else clip.sbr / (1 + clip.sbr)
        scales[frames] = clip.exposure * share / mean  # y = scale M A f + background + noise
        exposed = signals[frames] * scales[frames, None, None, None]
        if light is not None:
            if not (level := light.mean()) > 0:
                place = f"sample {start + frames.start}"
                raise ConfigurationError(f"{place}: no ambient light reaches the wall; move it")
            light *= clip.exposure * (1 - share) / level
            exposed += light
            if configuration.keep_background:
                ambient[frames] = light
        for k, picture in enumerate(exposed, frames.start):
            # A stream for each sample: the same noise in whichever block it is made.
            noise = int(generator(configuration, NOISE, start + k).integers(2**31))
            photographs[k] = add_noise(picture, clip.snr, noise)

    in_parallel(expose, range(len(clips)))
    if configuration.saturation is not None:  # after the noise, as in a sensor
        np.minimum(photographs, configuration.saturation, out=photographs)
    dtype = configuration.photograph_type
    with np.errstate(over="ignore"):  # half precision ends at 65504; the check below raises
        kept = photographs.astype(dtype, copy=False)
    if not np.isfinite(kept).all():
        raise ConfigurationError(f"samples from {start} on do not fit {dtype}; lower the exposure")
    block = {
        "photograph": kept,
        **{name: images.astype(np.float32) for name, images in hidden.items()},
        "signal_scale": scales,
        **_labels(geometry, clips, length),
    }
    if configuration.keep_background:
        block["background"] = ambient.astype(dtype, copy=False)
    return block


def _signals(geometry: "RenderedGeometry", hidden: Sequence[Array]) -> NDArray[np.floating[Any]]:
    """Return photographs of the hidden surfaces' light alone, (n, rows, columns, 3)."""
    scenario, A = geometry.scenario, geometry.transport
    frames, channels = len(hidden[0]), hidden[0].shape[-1]
    flat = np.concatenate([each.reshape(frames, -1, channels) for each in hidden], axis=1)
    f = np.moveaxis(flat, -1, 1)  # a row for each channel
    rows = np.ascontiguousarray(f, np.float32).reshape(-1, f.shape[-1])
    # One product with the channels' mean of A serves all frames and channels; bounced light alone
    # differs by channel, and is added as the small difference from that mean.
    y = products.times_rows(rows, channels_mean(A)).reshape(frames, channels, -1)
    if isinstance(A, BouncedTransport):
        y += A.beyond_mean(np.moveaxis(f, 1, -1)).swapaxes(1, 2)
    y *= np.atleast_2d(scenario.channel_gain).astype(np.float32).T
    return np.moveaxis(y, 1, -1).reshape(frames, *scenario.photograph_shape, channels)


def _background(
    ambient: AmbientDraw, scenario: Scenario, backgrounds: "Backgrounds"
) -> Array | None:
    """Return ambient light on the wall, (rows, columns, channels), in any unit; None for darkness.

    Pictures have the camera's channels, other light has the scene's three.
    """
    if ambient.lamps is not None:
        (places, powers), frame = ambient.lamps, scenario.view.frame
        lights = frame.center + places @ np.stack([frame.across, frame.normal, frame.up])
        light = lamp_light(lights, powers, scenario.view.centers, scenario.view.center_normals)
        return light.reshape(*scenario.photograph_shape, -1) * _colour(scenario, light.shape[-1])
    if not ambient.mixture:
        return None
    total = np.zeros(1)
    for which, weight, down, across in ambient.mixture:
        turned = slice(None, None, -1 if down else 1), slice(None, None, -1 if across else 1)
        picture = backgrounds[ambient.source][which][turned].astype(np.float64)
        total = total + weight / picture.mean() * picture  # weights are of light, in any unit
    return total * _colour(scenario, total.shape[-1])


def _colour(scenario: Scenario, channels: int) -> Array:
    """Return the wall's colour, (rows, columns, C), or (1, 1, C) without a texture.

    In other channels than its own the wall is grey.
    """
    gain = scenario.channel_gain
    colour = (gain if gain.shape[-1] == channels else np.ones(channels)) * scenario.paint
    return colour.reshape(*(scenario.photograph_shape if len(colour) > 1 else (1, 1)), -1)


def lamp_light(lamps: Array, powers: Array, points: Array, normals: Array) -> Array:
    """Return the wall's responses to point lights, each scaled to its mean over the wall, added.

    Σ_l p_l ψ(α_l) / mean ψ(α_l), (M, 3), with ψ of Eq. 4, see `point_light_response`: lamps α
    (L, 3) in metres, off the wall; powers p (L, 3) by channel; wall points (M, 3) in metres and
    their unit normals. A lamp behind the whole wall gives nothing.
    """
    ψ = responses(lamps, points, normals)
    mean = ψ.mean(axis=1)
    weights = powers / np.where(mean > 0, mean, 1)[:, None]
    return np.asarray(products.combine_rows(np.ascontiguousarray(weights.T), ψ).T, np.float64)


def _labels(geometry: "RenderedGeometry", clips: list[ClipDraw], length: int) -> Block:
    """Return the variables of one value for each sample, of clips of `length` frames."""
    draw = geometry.draw
    of_geometry: dict[str, Any] = {"geometry": draw.number, "split": draw.split}
    if isinstance(geometry.transport, BouncedTransport):
        of_geometry[BOUNCED_ERROR] = geometry.transport.bounced.relative_error
    records = [
        {
            "sbr": clip.sbr, "snr": clip.snr, "exposure": clip.exposure,
            "clip_number": clip.number, "frame": frame, "hidden_kind": clip.kind,
            "ambient": clip.ambient.label, **of_geometry,
        }
        for clip in clips for frame in range(length)
    ]  # fmt: skip
    text = np.dtypes.StringDType()
    types = {name: text if kind is str else kind for name, (kind, *_) in LABELS.items()}
    return {name: np.array([each[name] for each in records], types[name]) for name in records[0]}


Backgrounds = Mapping[int, NDArray[np.float32]]
"""By ambient source: (K, rows, columns, channels) light on a grey wall, in any unit."""

_rendering = threading.Lock()
"""Held while Mitsuba is at work: Dr.Jit's arrays belong to one thread at a time."""


LEAST_NOISE = 1e-4
"""Noise over the mean of the photographs that A is made for: 80 dB."""

TRIED = 8
"""Clips of a geometry whose first images show the error of A."""


@dataclass(frozen=True, eq=False)
class RenderedGeometry:
    """A scene with its parameters, ready to take photographs by A."""

    draw: GeometryDraw
    scenario: Scenario
    transport: NDArray[np.float32] | BouncedTransport  # (M, N)


def scenario_of(configuration: Configuration, draw: GeometryDraw) -> Scenario:
    """Return the scene of a geometry; the error of one that cannot be loaded has its parameters."""
    scene, of = configuration.scenes[draw.source].scene, configuration.light
    bounces = of.bounces if isinstance(of, Bounced) else 1
    # The seed is the data set's own: samples of A are no random draw of a sample.
    light, seed = Light(samples=of.samples, bounces=bounces), configuration.seed
    place = f"geometry {draw.number} ({draw.parameters or 'no parameters'})"
    try:
        with _rendering:
            return load_scenario(
                scene, configuration.hidden, draw.parameters, light=light, seed=seed
            )
    except SceneError as error:
        raise ConfigurationError(f"{place}: {error}") from error


def render_geometry(settings: Configuration, number: int) -> RenderedGeometry:
    """Return a geometry with its A: 66 MB at 36 x 29 patches, 126 x 126 pixels, direct light."""
    draw = draw_geometry(settings, number)
    scenario = scenario_of(settings, draw)
    first = number * settings.samples_per_geometry // settings.clip_length
    clips = (draw_clip(settings, first + k).hidden for k in range(TRIED))
    ids = named("hidden", {name: name for name in scenario.hidden})
    joined = (scenario.hidden.join({ids[n]: f[0] for n, f in clip.items()}) for clip in clips)
    images = np.stack([*joined])
    noise = max(10 ** (-settings.snr.bounds[1] / 20), LEAST_NOISE)
    with _rendering:
        error, A = scenario.transport_of(images, noise)
    snr = -20 * np.log10(noise)
    if error > allowed_error(snr):
        warnings.warn(
            f"geometry {number}: A errs by up to {error:.1e} of the light of its first images, "
            f"more than a third of the noise at {snr:.0f} dB",
            RuntimeWarning,
            stacklevel=2,
        )
    return RenderedGeometry(draw, scenario, A)


def missing_lights(settings: Configuration, scenario: Scenario) -> int:
    """Return how many conditions `backgrounds_of` renders."""
    wall, sources = _in_grey(scenario), settings.ambient
    rendered = (each for each in sources if isinstance(each, Conditions))
    return len(set().union(*(wall.missing_ambient(each.names, each.target) for each in rendered)))


def _in_grey(scenario: Scenario) -> Scenario:
    """Return a scenario whose wall has no colour and no texture."""
    view = scenario.view.even
    if view.reflectance is None:
        return scenario
    return replace(scenario, view=replace(view, reflectance=view.reflectance / view.channel_gain))


def backgrounds_of(
    settings: Configuration, scenario: Scenario, progress: Stage | None = None
) -> Backgrounds:
    """Return the ambient light of each source of pictures or conditions, on a scene's wall in grey.

    Pictures show the scene's wall, with a positive mean. Without `progress` even light takes the
    place of conditions, to try how long a sample takes.
    """
    scenario, light = _in_grey(scenario), dict[int, NDArray[np.float32]]()
    for number, source in enumerate(settings.ambient):
        if isinstance(source, Conditions) and progress is None:
            even = np.ones((*scenario.photograph_shape, 3))
            pictures = [(name, even) for name in source.names]
        elif isinstance(source, Conditions):
            assert progress is not None
            of_source = partial(scenario.ambient, target=source.target, progress=progress)
            pictures = [(name, of_source(name).photograph) for name in source.names]
        elif isinstance(source, Pictures):
            shape = scenario.photograph_shape
            pictures = []
            for file in source.files:
                values = read_photograph(file, shape).values
                if values.shape[2] not in (1, settings.channels):
                    raise ConfigurationError(
                        f"{file}: has {values.shape[2]} channels, the camera {settings.channels}"
                    )
                values = np.broadcast_to(values, (*shape, settings.channels))
                pictures.append((file, values / _colour(scenario, settings.channels)))
        else:
            continue
        for name, picture in pictures:
            if not picture.mean() > 0:
                raise ConfigurationError(f"{name}: its mean is not positive")
        light[number] = np.stack([picture for _, picture in pictures]).astype(np.float32)
    return light
