"""Make a data set: blocks that it lacks, on this machine or on Dask workers."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from periscopy_sim.dataset import samples
from periscopy_sim.dataset.configuration import Bounced, Configuration, load_configuration
from periscopy_sim.dataset.reading import CHANNELS, KIND, Layout
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.evaluation.workers import check_scheduler, compute, connect
from periscopy_sim.numerics.machine import Stage, ahead, core_count, silent, timed
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage import outputs, places
from periscopy_sim.storage.provenance import provenance
from periscopy_sim.storage.store import MAKING, BlockStore, Label, check_place

VERSIONS = ("periscopy-sim", "numpy", "mitsuba", "drjit", "variant")
"""What samples depend on, beside the configuration."""


@dataclass(frozen=True)
class Made:
    """Numbers of a run: samples there are, those made now, and their geometries.

    `empty_splits` were asked for, but have no geometry.
    """

    count: int
    made: int
    geometries: int
    empty_splits: tuple[str, ...] = ()


@dataclass(frozen=True)
class Work:
    """What a run makes: the numbers of samples and geometries that a data set lacks."""

    samples: int
    geometries: int
    lights: int  # ambient conditions that are rendered
    size: int  # bytes of the samples, before compression


def make_dataset(
    configuration: Configuration | str | Path,
    out: str | Path,
    *,
    count: int | None = None,
    scheduler: str | None = None,
    planned: Callable[[Work], None] | None = None,
    estimated: Callable[[float], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    rendering: Stage = silent,
) -> Made:
    """Make the blocks that a data set lacks.

    Parameters
    ----------
    configuration
        A YAML file, or what `load_configuration` returns.
    out
        The archive, a Zarr folder, or a URL that fsspec opens, such as ``s3://bucket/name``. Blocks
        of this configuration stay; damaged ones are made again.
    count
        Samples, instead of the configuration's; may grow from run to run.
    scheduler
        Address of a Dask scheduler; None for this process.
    planned
        Called with what the run makes, before it does.
    estimated
        Called with the seconds that it takes, by the first geometry and block, but for ambient
        light. A run on a scheduler calls it never.
    progress
        Called with the samples that are done and those that there will be, before each block is
        kept; an exception that it raises stops the making.
    rendering
        Called with each ambient condition that is rendered, gives the function that takes the
        fraction done.

    Raises
    ------
    PeriscopyError
        If a scene, an image or a condition cannot be used, `out` holds something else or another
        process is at work there, the disk is full, or no scheduler answers.

    Warns
    -----
    RuntimeWarning
        A scene has lights beside the monitor, A errs by more than a third of the least noise, or
        light that bounces is not known well enough, see `render_bounced_light`. The archive's
        `bounced_error` has the error of each geometry.
    """
    out, report = places.place(out), progress or (lambda *_: None)
    if not isinstance(configuration, Configuration):
        configuration = load_configuration(configuration)
    settings = configuration.located()
    if count is not None:
        settings = settings.model_copy(update={"count": count})
    check_place(out, "data set")
    require_vectorized("a data set")
    draws = [samples.draw_geometry(settings, number) for number in range(settings.geometries)]
    first = samples.scenario_of(settings, draws[0])
    for draw in {draw.source: draw for draw in reversed(draws)}.values():
        # An error of any scene comes before anything is written.
        scenario = samples.scenario_of(settings, draw)
        _check_shape(draw.number, scenario, first.photograph_shape)
        if lights := ", ".join(scenario.scene.lights):
            what = f"{scenario.path}: no photograph has the light of {lights}"
            warnings.warn(f"{what}; add it as ambient light", RuntimeWarning, stacklevel=2)
    layout = Layout(
        settings.count, settings.samples_per_shard, first.photograph_shape, settings.hidden,
        settings.photograph_type, settings.keep_background,
        isinstance(settings.light, Bounced), settings.channels,
    )  # fmt: skip
    made_by = provenance(None, settings.seed)
    attributes = {
        "kind": KIND,
        "configuration": settings.identity(),
        "layout": layout.attributes,
        "versions": {name: made_by[name] for name in VERSIONS},
        "count": layout.count,
    }
    check_scheduler(scheduler, out)
    with outputs.alone_in(out / MAKING):
        store = BlockStore(out, layout.of_store(), attributes, _labels(settings, draws))
        blocks_each = settings.samples_per_geometry // layout.block
        by_geometry = groupby(
            (block for (block,) in store.missing()), lambda block: block // blocks_each
        )
        shares = {geometry: list(blocks) for geometry, blocks in by_geometry}
        made = sum(store.layout.size((n,)) for blocks in shares.values() for n in blocks)
        done = layout.count - made
        if planned is not None:
            rooms = samples.missing_lights(settings, first) if shares else 0
            planned(Work(made, len(shares), rooms, made * layout.sample_bytes))
        maker = _Maker(settings, layout.photograph_shape, store)
        if shares and scheduler is None and estimated is not None:
            maker.backgrounds = samples.backgrounds_of(settings, first)
            number, (block, *_) = next(iter(shares.items()))
            of_geometry, geometry = timed(partial(maker.geometry, number))
            together = [(geometry, block)] * core_count()  # as many as run at once
            of_all = timed(lambda: [*ahead(maker.block, together)])[0]
            of_block = of_all / len(together) * sum(map(len, shares.values()))
            estimated((len(shares) - 1) * of_geometry + of_block)
        maker.backgrounds = samples.backgrounds_of(settings, first, rendering) if shares else {}
        for block, values in maker.made(shares, scheduler):
            # Before it is kept: an interrupt may have stopped Mitsuba in the midst of it.
            report(done, layout.count)
            if values:
                store.write((block,), values)
            done += store.layout.size((block,))
        report(done, layout.count)
    filled = {draw.split for draw in draws}
    empty = (name for name, share in settings.splits if share > 0 and name not in filled)
    return Made(layout.count, made, len(shares), tuple(empty))


def _check_shape(geometry: int, scenario: Scenario, expected: tuple[int, int]) -> None:
    if scenario.photograph_shape != expected:
        raise ConfigurationError(
            f"geometry {geometry} has photographs of {scenario.photograph_shape} pixels, "
            f"geometry 0 of {expected}; give all scenes films of one size"
        )


class _Maker:
    """What makes blocks of a data set, here or on workers.

    Workers write to a place that all reach themselves: the blocks that they return are empty.
    """

    def __init__(self, settings: Configuration, shape: tuple[int, int], store: BlockStore) -> None:
        self.settings, self.shape = settings, shape
        self.store = store if places.is_shared(store.path) else None
        self.backgrounds: samples.Backgrounds = {}
        self._latest: tuple[int, samples.RenderedGeometry] | None = None

    def made(
        self, shares: Mapping[int, Sequence[int]], scheduler: str | None
    ) -> Iterator[tuple[int, samples.Block]]:
        """Yield blocks with their numbers, geometry by geometry, each where a worker is free."""
        if scheduler is None or not shares:
            # A of a geometry is made here, beside the last photographs of the one before.
            ready = ((self.geometry(number), blocks) for number, blocks in shares.items())
            work = ((geometry, block) for geometry, blocks in ready for block in blocks)
            yield from ahead(self.block, work)
            return
        with connect(scheduler) as client:
            for _, blocks in compute(client, _Maker.share, self, shares.items()):
                yield from blocks

    def share(self, share: tuple[int, Sequence[int]]) -> list[tuple[int, samples.Block]]:
        """Return the blocks of a geometry."""
        number, blocks = share
        if self.store is not None:
            self.store.check_seen()  # before an hour's work
        geometry, made = self.geometry(number), []
        for block, values in (self.block((geometry, each)) for each in blocks):
            if self.store is not None:
                self.store.write((block,), values)
            made.append((block, values if self.store is None else {}))
        return made

    def geometry(self, number: int) -> samples.RenderedGeometry:
        """Return a geometry; the latest one is kept."""
        latest = self._latest  # a worker's threads share it
        if latest is None or latest[0] != number:
            geometry = samples.render_geometry(self.settings, number)
            _check_shape(number, geometry.scenario, self.shape)
            latest = self._latest = number, geometry
        return latest[1]

    def block(self, item: tuple[samples.RenderedGeometry, int]) -> tuple[int, samples.Block]:
        """Return the number of a block, and the block."""
        (geometry, number), size = item, self.settings.samples_per_shard
        start, stop = number * size, (number + 1) * size
        return number, samples.make_samples(self.settings, geometry, self.backgrounds, start, stop)


def _labels(settings: Configuration, draws: Sequence[samples.GeometryDraw]) -> dict[str, Label]:
    """Return each geometry's scene, split and parameters, and the channels' names."""
    variables: dict[str, list[Any]] = {
        "geometry_scene": [Path(settings.scenes[draw.source].scene).stem for draw in draws],
        "geometry_split": [draw.split for draw in draws],
    }
    for name in sorted({name for scene in settings.scenes for name in scene.parameters}):
        texts = [draw.parameters.get(name, "") for draw in draws]
        try:  # numbers, NaN for scenes without the parameter
            variables[f"parameter_{name}"] = [float(text or "nan") for text in texts]
        except ValueError:
            variables[f"parameter_{name}"] = texts
    of_geometries = {name: Label("geometries", values) for name, values in variables.items()}
    return {**of_geometries, "channel": Label("channel", [*CHANNELS])}
