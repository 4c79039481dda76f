"""What is random in a data set: each draw follows from the seed and a number alone.

So any sample can be made by itself, in any order, on any machine. Geometries, clips and noise have
streams of their own: that one takes more draws than before leaves the others as they are.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration.distributions import Distribution, Source
from periscopy_sim.dataset.configuration.document import SPLITS, Configuration
from periscopy_sim.dataset.configuration.light_sources import Conditions, Darkness, Lamps

Array = NDArray[np.float64]

GEOMETRY, CLIP, NOISE, RENDERING, SPLIT = range(5)

GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class GeometryDraw:
    """A scene with values for its parameters.

    Attributes
    ----------
    number
        Counts the geometries of a data set from 0.
    source
        Which of the configuration's scenes.
    parameters
        Values for its ``<default>``s.
    split
        One of `SPLITS`.
    """

    number: int
    source: int
    parameters: dict[str, str]
    split: str


@dataclass(frozen=True, eq=False)
class AmbientDraw:
    """Ambient light of a clip.

    Attributes
    ----------
    source
        Which of the configuration's.
    label
        ``lamps``, ``none``, or the names of what is mixed.
    lamps
        (L, 3) places and (L, 3) powers; None for other sources.
    mixture
        Position within the source's names or files, weight, and whether turned upside down and
        left to right; of each picture that is added.
    """

    source: int
    label: str
    lamps: tuple[Array, Array] | None = None
    mixture: tuple[tuple[int, float, bool, bool], ...] = ()


@dataclass(frozen=True, eq=False)
class ClipDraw:
    """What the frames of a clip have in common.

    Attributes
    ----------
    number
        Counts the clips of a data set from 0.
    hidden
        (frames, R, C, 3) linear light.
    kind
        Of hidden image.
    ambient
        Its ambient light.
    sbr, snr, exposure
        See `Configuration`; the SBR is infinite without ambient light.
    """

    number: int
    hidden: Array
    kind: str
    ambient: AmbientDraw
    sbr: float
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
    rng = generator(configuration, GEOMETRY, number)
    source = _weighted(rng, configuration.scenes)
    parameters = {
        name: distribution if isinstance(distribution, str) else f"{distribution.draw(rng):.9g}"
        for name, distribution in configuration.scenes[source].parameters.items()
    }
    scene = configuration.scenes[source]
    sizes = np.array([getattr(configuration.splits, name) for name in SPLITS])
    edges = np.cumsum(sizes)
    if any(isinstance(q, Distribution) and q.is_continuous for q in scene.parameters.values()):
        largest = int(sizes.argmax())
        place = (edges[largest] - sizes[largest] / 2 + number * GOLDEN) % 1
    else:
        # By its file's name, not by where that lies: the same data set on every machine.
        identity = (Path(scene.scene).name, sorted(parameters.items()))
        pose = zlib.crc32(repr(identity).encode())
        place = generator(configuration, SPLIT, pose).random()
    split = int(np.searchsorted(edges, place, side="right"))
    return GeometryDraw(number, source, parameters, SPLITS[min(split, len(SPLITS) - 1)])


def draw_clip(configuration: Configuration, number: int) -> ClipDraw:
    """Draw the frames and the light of a clip."""
    rng = generator(configuration, CLIP, number)
    source = configuration.hidden_images[_weighted(rng, configuration.hidden_images)]
    hidden = source.draw(rng, configuration.hidden, configuration.clip_length)
    ambient = _draw_ambient(configuration, rng)
    sbr, snr, exposure = (
        distribution.draw(rng)
        for distribution in (configuration.sbr, configuration.snr, configuration.exposure)
    )
    dark = isinstance(configuration.ambient[ambient.source], Darkness)
    return ClipDraw(number, hidden, source.kind, ambient, np.inf if dark else sbr, snr, exposure)


def random_seed(configuration: Configuration, stream: int, index: int) -> int:
    """Return a seed of 31 bits to one of the streams above and a number in it."""
    return int(generator(configuration, stream, index).integers(2**31))


def _draw_ambient(configuration: Configuration, rng: np.random.Generator) -> AmbientDraw:
    number = _weighted(rng, configuration.ambient)
    source = configuration.ambient[number]
    if isinstance(source, Lamps):
        return AmbientDraw(number, "lamps", lamps=source.draw(rng))
    if isinstance(source, Darkness):
        return AmbientDraw(number, "none")
    names = source.names if isinstance(source, Conditions) else source.files
    count = 1
    if isinstance(source, Conditions):
        count = min(round(source.mixed.draw(rng)), len(names))
    chosen = np.sort(rng.choice(len(names), count, replace=False)).tolist()
    weights = rng.dirichlet(np.ones(count)) if count > 1 else np.ones(1)
    turned = rng.random((count, 2)) < (0.5 if source.flip else 0)
    mixture = tuple(
        (which, float(weight), bool(down), bool(across))
        for which, weight, (down, across) in zip(chosen, weights, turned, strict=True)
    )
    return AmbientDraw(
        number, " + ".join(Path(names[which]).stem for which in chosen), mixture=mixture
    )


def _weighted(rng: np.random.Generator, sources: Sequence[Source]) -> int:
    weights = np.array([source.weight for source in sources])
    return int(rng.choice(len(sources), p=weights / weights.sum()))
