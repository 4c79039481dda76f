"""Random draws of a data set: each follows from the seed and a number alone.

Any sample can be made by itself, in any order, on any machine. Geometries, clips and noise have
streams of their own: one that takes more draws than before leaves the others as they are.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from periscopy_sim.dataset.configuration import SPLITS, Conditions, Configuration, Darkness, Lamps
from periscopy_sim.dataset.distributions import Distribution, Source
from periscopy_sim.scenario import Array

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

    Of each picture that is added, `mixture` holds its position within the source's names or files,
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
    hidden: Array  # (frames, R, C, 3) linear light
    kind: str  # of hidden image
    ambient: AmbientDraw
    sbr: float  # infinite without ambient light
    snr: float
    exposure: float


def generator(configuration: Configuration, stream: int, number: int) -> np.random.Generator:
    """Return the random generator of one of the streams above and a number in it."""
    return np.random.default_rng([configuration.seed, stream, number])


def random_seed(configuration: Configuration, stream: int, number: int) -> int:
    """Return a seed of 31 bits to one of the streams above and a number in it."""
    return int(generator(configuration, stream, number).integers(2**31))


def draw_geometry(configuration: Configuration, number: int) -> GeometryDraw:
    """Draw a scene, its parameters and its split.

    The splits follow multiples of the golden ratio, so that any number of geometries is shared
    among them as nearly by their sizes as it can be, the first to the largest. A scene of which
    nothing varies continuously comes again: its splits follow from what it is.
    """
    golden = (np.sqrt(5) - 1) / 2
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
        largest = int(sizes.argmax())
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
    size = configuration.hidden
    shown = source.draw(rng, size, configuration.clip_length)
    hidden = np.broadcast_to(shown, (configuration.clip_length, *size, 3))
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
    weights = rng.dirichlet(np.ones(count)) if count > 1 else np.ones(1)
    turned = rng.random((count, 2)) < (0.5 if source.flip else 0)
    mixture = tuple(zip(chosen, weights.tolist(), *turned.T.tolist(), strict=True))
    label = " + ".join(Path(names[which]).stem for which in chosen)
    return AmbientDraw(number, label, mixture=mixture)


def _weighted(rng: np.random.Generator, sources: Sequence[Source]) -> int:
    weights = np.array([source.weight for source in sources])
    return int(rng.choice(len(sources), p=weights / weights.sum()))
