"""Make a data set: what is missing of it, on this machine or on Dask workers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from periscopy_sim.dataset.archive.layout import Layout
from periscopy_sim.dataset.configuration.document import Bounced, Configuration
from periscopy_sim.dataset.configuration.light_sources import Pictures
from periscopy_sim.dataset.making.backgrounds import backgrounds_of, given_picture
from periscopy_sim.dataset.making.draws import GeometryDraw, draw_geometry
from periscopy_sim.dataset.making.geometry import Backgrounds, as_json, geometry_of, scenario_of
from periscopy_sim.dataset.making.inputs import attributes_of, labels_of, resolved
from periscopy_sim.dataset.making.samples import Block, make_samples
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.numerics.threads import ahead
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.ambient_library import Progress, silent
from periscopy_sim.storage.outputs.store import MAKING, BlockStore, check_place, digest_of

SHARES_PER_THREAD = 4
"""Tasks for each thread of a Dask cluster, so that none waits long for the last."""

Doubted = tuple[Block, tuple[str, ...]]
"""Samples, and what the rendering of their geometry warned of."""


@dataclass(frozen=True)
class Made:
    """What a run did: of `count` samples in the data set it `made` some, of so many `geometries`.

    `empty_splits` were asked for, but have no geometry.
    """

    count: int
    made: int
    geometries: int
    empty_splits: tuple[str, ...] = ()


def make_dataset(
    configuration: Configuration,
    out: str | Path,
    *,
    count: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    rendering: Progress = silent,
) -> Made:
    """Make what is missing of a data set.

    Parameters
    ----------
    configuration
        From `load_configuration`.
    out
        The archive, a Zarr folder. What it holds already of this configuration stays; blocks that
        are damaged are made again.
    count
        Samples, instead of the configuration's; may grow from run to run.
    scheduler
        Address of a Dask scheduler; None for this process.
    progress
        Called with the samples that are done and those that there will be, before each block is
        kept; what it raises stops the making.
    rendering
        Called with each ambient condition that is rendered, gives what takes the fraction done.

    Returns
    -------
    Made
        Numbers of samples and of their geometries, and splits that stay empty.

    Raises
    ------
    PeriscopyError
        If a scene, an image or a condition cannot be used, `out` holds something else or another
        process is at work there, the disk is full, or no scheduler answers.

    Warns
    -----
    RuntimeWarning
        The photographs have fewer than two pixels for each patch of the hidden images; or, told of
        each geometry, light that bounces is not known well enough, see `render_bounced_light`.
    """
    from periscopy_sim.storage.outputs.resume import alone_in

    out, report = Path(out), progress or (lambda *_: None)
    if count is not None:
        configuration = _of_count(configuration, count)
    check_place(out, Layout.what, Layout.recognizes)
    settings = resolved(configuration)
    draws = [draw_geometry(settings, number) for number in range(settings.geometries)]
    first = _checked_scenes(settings, draws)
    layout = Layout(
        settings.count, settings.samples_per_shard, first.photograph_shape, settings.hidden,
        settings.photograph_type, settings.keep_background,
        isinstance(settings.light, Bounced),
    )  # fmt: skip
    attributes = attributes_of(settings, layout)
    with alone_in(out / MAKING):
        store = BlockStore(out, layout, attributes, labels_of(settings, draws))
        blocks_each = settings.samples_per_geometry // layout.block_size
        by_geometry = groupby(store.missing(), lambda block: block // blocks_each)
        shares = {geometry: list(blocks) for geometry, blocks in by_geometry}
        made = sum(layout.block(number).size for blocks in shares.values() for number in blocks)
        done = layout.count - made
        report(done, layout.count)
        if made:
            # What another seed or version has rendered, before any sample, is not taken.
            lit_by = digest_of({"seed": settings.seed, **attributes["versions"]})[:8]
            folder = out / MAKING / f"ambient-{lit_by}"
            backgrounds = backgrounds_of(settings, shares, first, folder, rendering)
            making = _made(settings, shares, layout.photograph_shape, backgrounds, scheduler)
            told: set[str] = set()
            for block, (values, doubts) in making:
                # Before it is kept: who interrupts may have stopped Mitsuba in the midst of it.
                report(done, layout.count)
                store.write(block, values)
                done += layout.block(block).size
                for doubt in sorted(set(doubts) - told):  # several blocks are of a geometry
                    warnings.warn(doubt, RuntimeWarning, stacklevel=2)
                told.update(doubts)
            report(done, layout.count)
    filled = {draw.split for draw in draws}
    empty = (name for name, share in settings.splits if share > 0 and name not in filled)
    return Made(layout.count, made, len(shares), tuple(empty))


def _made(
    settings: Configuration,
    shares: Mapping[int, list[int]],
    photograph_shape: tuple[int, int],
    backgrounds: Backgrounds,
    scheduler: str | None,
) -> Iterator[tuple[int, Doubted]]:
    """Make blocks, geometry by geometry or wherever a worker is free."""
    shared = (as_json(settings), photograph_shape, backgrounds)
    if scheduler is None:
        for geometry, blocks in shares.items():
            make = partial(make_block, *shared, geometry)
            # Rendered here, not in the threads; path tracing is parallel by itself.
            traced = geometry_of(shared[0], geometry).transport is None
            made = map(make, blocks) if traced else ahead(make, blocks)
            yield from zip(blocks, made, strict=True)
        return
    from periscopy_sim.evaluation.workers import compute, connect

    with connect(scheduler) as client:
        threads = sum(client.nthreads().values())
        tasks = list(_tasks(shares, SHARES_PER_THREAD * threads))
        for _, share in compute(client, _make_share, shared, tasks):
            yield from share


def make_block(
    configuration: str,
    photograph_shape: tuple[int, int],
    backgrounds: Backgrounds,
    geometry: int,
    block: int,
) -> Doubted:
    """Make the samples of a block of a geometry, here and now.

    The configuration is JSON, from `as_json`. The geometry's camera must see photographs of
    `photograph_shape`, (rows, columns).
    """
    settings = Configuration.model_validate_json(configuration)
    start = block * settings.samples_per_shard
    ready = geometry_of(configuration, geometry)
    _check_shape(geometry, ready.scenario, photograph_shape)
    stop = start + settings.samples_per_shard
    return make_samples(settings, ready, backgrounds, start, stop), ready.doubts


def _make_share(
    shared: tuple[str, tuple[int, int], Backgrounds], task: tuple[int, tuple[int, ...]]
) -> list[tuple[int, Doubted]]:
    geometry, blocks = task
    return [(block, make_block(*shared, geometry, block)) for block in blocks]


def _tasks(shares: Mapping[int, list[int]], wanted: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield shares of the work: a geometry's blocks stay together unless workers would go idle."""
    pieces = max(1, -(-wanted // len(shares)))
    for geometry, blocks in shares.items():
        for part in np.array_split(blocks, min(pieces, len(blocks))):
            yield geometry, tuple(part.tolist())


def _of_count(configuration: Configuration, count: int) -> Configuration:
    """Return a configuration of another number of samples, checked as the file's own."""
    try:
        return Configuration.model_validate({**dict(configuration), "count": count})
    except ValidationError as error:
        message = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise ConfigurationError(f"count {count}: {message}") from None


def _checked_scenes(settings: Configuration, draws: Sequence[GeometryDraw]) -> Scenario:
    """Return the scenario of geometry 0, once every scene and given ambient light was read.

    All must be of its film size.
    """
    first = scenario_of(settings, 0)
    pixels, patches = first.transport_shape
    if pixels < 2 * patches:
        warnings.warn(
            f"{_by(settings.hidden)} patches of {_by(first.photograph_shape)} pixels: with fewer "
            "than two pixels a patch, noise and ambient light can hardly be told from the hidden "
            "image; give fewer patches, or larger films",
            RuntimeWarning,
            stacklevel=3,
        )
    for number in {draw.source: draw.number for draw in reversed(draws)}.values():
        if number:
            _check_shape(number, scenario_of(settings, number), first.photograph_shape)
    for source in settings.ambient:
        for name in source.files if isinstance(source, Pictures) else ():
            given_picture(name, first)
    return first


def _check_shape(geometry: int, scenario: Scenario, expected: tuple[int, int]) -> None:
    if scenario.photograph_shape != expected:
        raise ConfigurationError(
            f"geometry {geometry} has photographs of {_by(scenario.photograph_shape)} pixels, "
            f"geometry 0 of {_by(expected)}; give all scenes films of one size"
        )


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
