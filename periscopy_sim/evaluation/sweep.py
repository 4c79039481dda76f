"""Sweeps: methods over images, ambient light, noise, and whatever else varies (Fig. 4).

A cell is one method's reconstruction of one photograph, at a value of each axis. An interrupted
sweep resumes where it stopped, and ends in the same bytes as one without interruption. A sweep of
more values computes only their cells.

A world has photographs without ambient light, ambient light, and methods fitted to both.
"""

import hashlib
import json
import math
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import SWEEP, PeriscopyError, SceneError, require_all
from periscopy_sim.evaluation.metrics import METRICS, measured
from periscopy_sim.evaluation.sweep_store import MADE, SweepStore, Values
from periscopy_sim.evaluation.workers import compute, connect
from periscopy_sim.hidden import Hidden, named
from periscopy_sim.measurement import add_noise, composite, composite_error
from periscopy_sim.methods import OwnError, estimates_by, without_addresses
from periscopy_sim.numerics import Array, Image, machine
from periscopy_sim.numerics.validation import InputError, checked
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.reconstruction.method import Method
from periscopy_sim.scene import MONITOR
from periscopy_sim.storage import outputs, places, provenance

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Unfitted:
    """A method that could not be fitted: each of its results fails for this reason."""

    why: str  # no error, whose frames hold matrices

    def fitted_to(self, photograph: Photograph) -> Self:
        """Return this."""
        del photograph
        return self

    def reconstruct(self, photograph: Image) -> Any:
        """Raise a PeriscopyError."""
        del photograph
        raise PeriscopyError(self.why)


@dataclass(frozen=True, eq=False)
class World:
    """A laboratory whose photographs methods reconstruct.

    Attributes
    ----------
    signals
        Name of a hidden image to its `Photograph` without ambient light, or such an array, (rows,
        columns, channels), in any unit. One mask, the same for all, says where the wall is used:
        only there must photographs be finite, and only there count the SBR, the exposure and the
        noise; elsewhere a measurement is zero.
    truths
        Name to (R, C, channels) hidden image in [0, 1]; of several surfaces a mapping by id.
    backgrounds
        Name to `Photograph` or array of ambient light, like the signals, in any unit. Their masks
        exclude more pixels.
    methods
        Name to method; anything with ``reconstruct(photograph) -> (R, C, channels)`` that pickle
        takes. The package's methods are fitted to the photographs' conditions; a method of your own
        must have been fitted to them.
    transport
        How each method's A was made, by the method's name: `TransportPlan.origin`.
    draw
        A world that differs from others by chance, as by what a ruler reads, has noise of its own.
    measures
        Further numbers that some methods return by ``measures(photograph)``: long names and units.
    response
        What the camera makes of a photograph with its noise, (rows, columns, channels).

    Raises
    ------
    PeriscopyError
        If something is missing, or shapes differ.
    """

    signals: Mapping[str, Any]
    truths: Mapping[str, Any]
    backgrounds: Mapping[str, Any]
    methods: Mapping[str, Method]
    transport: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    draw: int = 0
    measures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    response: Callable[[Image], Image] | None = None

    def __post_init__(self) -> None:
        """Fit the methods to all of the photographs, which must show one wall."""
        if self.signals.keys() != self.truths.keys():
            raise PeriscopyError(
                f"photographs of {', '.join(self.signals)}, but hidden images "
                f"{', '.join(self.truths)}; give both of each"
            )
        given = {**self.signals, **{f"ambient {n}": b for n, b in self.backgrounds.items()}}
        photographs = of_one_wall([*given.values()], names=given)
        signals, ambient = photographs[: len(self.signals)], photographs[len(self.signals) :]
        first = signals[0]
        for name, each in zip(given, photographs, strict=True):
            if each.values.shape != first.values.shape or not each.used.sum() > 0:
                raise PeriscopyError(
                    f"'{name}': give finite values of shape {first.values.shape} and positive mean"
                )
        vars(self).update(  # the fields are frozen
            signals=dict(zip(self.signals, signals, strict=True)),
            backgrounds=dict(zip(self.backgrounds, ambient, strict=True)),
            methods={
                name: each.fitted_to(first) if hasattr(each, "fitted_to") else each
                for name, each in self.methods.items()
            },
        )

    @property
    def wall(self) -> Photograph:
        """The first photograph without ambient light, with the conditions of all."""
        first: Photograph = next(iter(self.signals.values()))
        return first

    @property
    def hidden(self) -> Hidden:
        """The hidden surfaces, by their sizes alone."""
        truth = self.truth(next(iter(self.truths)))
        return Hidden.of({name: each.shape[:2] for name, each in truth.items()})

    @property
    def channels(self) -> int:
        """Channels of the images, in the monitor's primaries."""
        matrix = self.wall.colour_matrix
        return self.wall.channels if matrix is None else int(matrix.matrix.shape[1])

    def truth(self, image: str) -> Mapping[str, Image]:
        """Return the hidden image of each surface, (R, C, channels), by its id."""
        truth = self.truths[image]
        return truth if isinstance(truth, Mapping) else {MONITOR: truth}

    def photograph(
        self, image: str, background: str, sbr: float, snr: float, seed: int, base: int = 0
    ) -> Array:
        """Return a measurement (Sec. 4.1), (rows, columns, channels), of mean 1, plus noise.

        It is zero where the wall is not used. Its noise follows from `base`, image, background,
        SBR, seed and `draw`: the same whatever else is swept, but for its strength.
        """
        signal, ambient = self.signals[image], self.backgrounds[background]
        exposed = composite(signal.used, ambient.used, sbr)
        labels = [base, image, background, float(sbr), int(seed), *filter(None, [self.draw])]
        entropy = int.from_bytes(hashlib.sha256(json.dumps(labels).encode()).digest()[:16])
        photograph = np.zeros(signal.values.shape)
        photograph[signal.pixels] = add_noise(exposed, snr, entropy)
        if self.response is not None:
            photograph[signal.pixels] = self.response(photograph)[signal.pixels]
        return photograph

    def own_error(self, image: str, background: str, sbr: float) -> float | None:
        """Return the own error of a `photograph` before noise, over its root mean square.

        None where nothing is known of it.
        """
        signal, ambient = self.signals[image], self.backgrounds[background]
        errors = signal.relative_error, ambient.relative_error
        if errors == (None, None):
            return None
        own = (each or 0.0 for each in errors)
        return composite_error(signal.used, ambient.used, sbr, *own)

    def scale(self, image: str, sbr: float) -> float:
        """Return what `photograph` multiplies a signal by."""
        return float(1 / (self.signals[image].used.mean() * (1 + 1 / sbr)))

    def __call__(self, snr: float, **values: Any) -> Self:  # noqa: ARG002  of all SNRs
        """Return the world, of a sweep that varies nothing in it."""
        if values:
            raise PeriscopyError(f"a world has no {', '.join(values)}; give what makes worlds")
        return self

    @property
    def axes(self) -> dict[str, list[str]]:
        """The names of methods, images and ambient light, by the names of a sweep's axes."""
        return {
            "algorithm": list(self.methods),
            "image": list(self.signals),
            "background": list(self.backgrounds),
        }

    @property
    def conditions(self) -> dict[str, Any]:
        """What all photographs depend on, of JSON's types; arrays by their digests."""
        off, mask, matrix = self.wall.monitor_off, self.wall.mask, self.wall.colour_matrix
        return {
            "monitor_off_sha256": {
                name: provenance.array_sha256(each) for name, each in off.items()
            },
            "mask_sha256": None if mask is None else provenance.array_sha256(mask),
            "colour_matrix": None if matrix is None else matrix.matrix.tolist(),
        }

    @property
    def conditions_of(self) -> dict[str, dict[str, Any]]:
        """The digests of what the photographs of one image or ambient light depend on."""
        return {
            "image": {
                name: {
                    "photograph": provenance.array_sha256(each.values),
                    "truth": provenance.image_sha256(self.truths[name]),
                }
                for name, each in self.signals.items()
            },
            "background": {
                n: provenance.array_sha256(each.values) for n, each in self.backgrounds.items()
            },
        }


TURNS = {"": (1, 1), " up-down": (-1, 1), " left-right": (1, -1), " both": (-1, -1)}
"""What the names of flipped backgrounds end in, with the step along rows and columns."""


def flipped_names(name: str, is_flipped: bool) -> list[str]:
    """Return the names of a background and of its flips, if there are any."""
    return [f"{name}{turn}" for turn in (TURNS if is_flipped else [""])]


def flips(backgrounds: Mapping[str, Image]) -> dict[str, Image]:
    """Flip each background about each axis and about both: four times as many (Sec. 4.1).

    They are (rows, columns, channels) each, by name. Return each under its own name, then with
    the endings of `TURNS`.
    """
    if not isinstance(backgrounds, Mapping):
        raise InputError("flips: give backgrounds by name, such as {'overcast': array}")
    return {
        f"{name}{turn}": image[::down, ::right]
        for name, image in backgrounds.items()
        for turn, (down, right) in TURNS.items()
    }


LIGHT = ("image", "background", "sbr", "snr", "seed")
"""Axes of a world's photographs. The axis of methods is `algorithm`, not `method`: xarray's `sel`
would read `method` as a keyword of its own, and select nothing."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep varies.

    Attributes
    ----------
    world
        A `World`, or what makes one of an SNR and values of `vary`, and has its `axes`, `hidden`,
        `channels`, `measures`, `conditions` and `conditions_of`.
    sbrs, snrs
        Signal-to-background ratios, infinite without ambient light, and signal-to-noise ratios in
        dB.
    seeds
        Labels of the noise draws for each image, background and SBR.
    seed
        Changes every noise draw.
    vary
        Names of further axes to their values, numbers or texts. An axis ``hidden`` has the sizes of
        the only hidden surface, as ``29x36``.
    units
        Units of the values of these axes.
    conditions
        Other settings of the results, of JSON's types, such as the scene that the methods fit.
        A store with other conditions is not resumed, so name everything that may change.

    Raises
    ------
    PeriscopyError
        If something to vary is missing or doubled, or a number is out of range.
    """

    world: Any
    sbrs: Sequence[float]
    snrs: Sequence[float] = (60.0,)
    seeds: Sequence[int] = (0,)
    seed: int = 0
    vary: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Reject settings that no sweep can have."""
        for name, kind in (("sbrs", "sbr"), ("snrs", "decibels"), ("seeds", "seed")):
            checked(name, getattr(self, name), kind)
        for name, values in self.axes.items():
            if not values or len({*values}) < len(values):
                raise PeriscopyError(f"{name} of the sweep: give at least one, and each once")

    @property
    def axes(self) -> dict[str, list[Any]]:
        """The values of each axis, the methods' first, by its name in the singular."""
        names = self.world.axes
        return {
            "algorithm": list(names["algorithm"]),
            **{name: np.asarray(values).tolist() for name, values in self.vary.items()},
            "image": list(names["image"]),
            "background": list(names["background"]),
            "sbr": [float(sbr) for sbr in self.sbrs],
            "snr": [float(snr) for snr in self.snrs],
            "seed": [int(seed) for seed in self.seeds],
        }

    def photograph(self, cell: Values) -> Array:
        """Return the measurement of a cell; see `World.photograph`."""
        values = {name: cell[name] for name in LIGHT}
        world: World = self.world(cell["snr"], **{n: cell[n] for n in self.vary})
        return world.photograph(**values, base=self.seed)


def run_sweep(
    sweep: Sweep,
    folder: str | Path,
    *,
    scheduler: str | None = None,
    planned: Callable[[Sequence[Values]], None] | None = None,
    progress: Callable[[float], None] | None = None,
    timed: Callable[[str, float], None] | None = None,
) -> "xr.Dataset":
    """Reconstruct every measurement by every method; resume where an earlier run stopped.

    A method that cannot be fitted, raises, or returns another shape or values that are not finite
    fails alone; so do values of `Sweep.vary` of which there is no scene. If nothing can be fitted
    the error is raised.

    Parameters
    ----------
    sweep
        Methods, photographs and what varies.
    folder
        Gets ``sweep.zarr`` and ``sweep.csv``, a row for each cell; or a URL that fsspec opens.
    scheduler
        Address of a Dask scheduler; None uses this machine's cores.
    planned
        Called with the cells that are missing, before the first world is made.
    progress
        Called with the fraction done.
    timed
        Called with the name of a method and a thread's seconds that it took for a photograph.

    Returns
    -------
    xarray.Dataset
        Over `Sweep.axes`: `METRICS`, NaN where the method failed; ``failure``, why it did;
        ``reconstruction``, float32, with (row, column, channel) besides. Of several surfaces there
        is each for each, as ``psnr_ID`` and ``row_ID``; of several sizes ``reconstruction_29x36``.

    Raises
    ------
    OutputError
        If the folder holds a sweep of another configuration, or cannot be written.
    PeriscopyError
        If the scheduler does not answer, its workers die, or the extra ``sweep`` is not installed.
    """
    require_all(*SWEEP)
    folder, worlds, axes = places.place(folder), sweep.world, sweep.axes
    store = _store(sweep, folder)
    missing, count = store.missing(), math.prod(map(len, axes.values()))
    done, failed = count - len(missing), list[tuple[Values, str]]()
    if planned is not None:
        planned(missing)
    for (*values, snr), cells in _by([*sweep.vary, "snr"], missing).items():
        at = dict(zip(sweep.vary, values, strict=True))
        try:
            methods = (world := worlds(snr, **at)).methods
            unfit = {n: each.why for n, each in methods.items() if isinstance(each, Unfitted)}
        except SceneError as error:
            unfit = dict.fromkeys(axes["algorithm"], str(error))
        failed += [(c, unfit[c["algorithm"]]) for c in cells if c["algorithm"] in unfit]
        if len(failed) == count:
            raise PeriscopyError(failed[0][1])
        fitted = [cell for cell in cells if cell["algorithm"] not in unfit]
        done += len(cells) - len(fitted)
        if not fitted:
            continue
        with closing(_outcomes(sweep, world, at, fitted, scheduler)) as found:
            for cell, outcome in found:
                seconds = outcome.pop("seconds", None)
                if timed is not None and seconds is not None:
                    timed(cell["algorithm"], seconds)
                store.write(cell, outcome)
                done += 1
                if progress is not None:
                    progress(done / count)
    for cell, why in failed:
        store.write(cell, {"failure": why})
    results = store.load()
    surfaces = named("", worlds.hidden)
    metrics = [*(f"{name}{of}" for of in surfaces for name in METRICS), *worlds.measures]
    table = results[[*metrics, "failure", *MADE]].to_dataframe([*axes])
    table["transport_samples"] = table["transport_samples"].astype("Int64")
    columns = {f"transport_{name}": name for name in ("model", "samples") if name not in axes}
    with outputs.staged_file(folder / "sweep.csv") as staged:
        table.rename(columns=columns).to_csv(staged, na_rep="nan", lineterminator="\n")
    return results


def cell_seconds(world: World, cells: Mapping[str, Values]) -> dict[str, float]:
    """Measure how long a thread takes for each method's cell, by its name."""
    seconds = dict[str, float]()
    with threadpool_limits(1):
        for name, cell in cells.items():
            asked = tuple(cell[axis] for axis in LIGHT), (name,)
            seconds[name], _ = machine.timed(partial(_evaluate, (world, 0, ""), asked))
    return seconds


def _store(sweep: Sweep, folder: Path) -> SweepStore:
    """Return the store of a sweep's results in a folder."""
    worlds, shapes = sweep.world, named("", sweep.world.hidden.shapes)
    images = {of: (*shape, worlds.channels) for of, shape in shapes.items()}
    conditions = {**sweep.conditions, **worlds.conditions, "base_seed": int(sweep.seed)}
    conditions["metrics"] = [*METRICS]
    return SweepStore(
        folder / "sweep.zarr", sweep.axes, images, conditions, worlds.conditions_of, sweep.units,
        worlds.measures,
    )  # fmt: skip


def _outcomes(
    sweep: Sweep, world: World, at: Values, cells: Iterable[Values], scheduler: str | None
) -> Generator[tuple[Values, dict[str, Any]], None, None]:
    """Yield cells of a world with the variables of each as they come, photograph by photograph."""
    shared = world, sweep.seed, f"_{at['hidden']}" if "hidden" in at else ""
    trials = {trial: _by(["algorithm"], of) for trial, of in _by(LIGHT, cells).items()}
    asked = [(trial, tuple(name for (name,) in each)) for trial, each in trials.items()]
    with connect(scheduler) as client:
        for (trial, names), outcomes in compute(client, _evaluate, shared, asked):
            for name, outcome in zip(names, outcomes, strict=True):
                (cell,) = trials[trial][(name,)]
                yield cell, outcome


def _by(names: Collection[str], cells: Iterable[Values]) -> dict[tuple[Any, ...], list[Values]]:
    """Return cells by their values of some axes."""
    groups: dict[tuple[Any, ...], list[Values]] = {}
    for cell in cells:
        groups.setdefault(tuple(cell[name] for name in names), []).append(cell)
    return groups


def _evaluate(
    shared: tuple[World, int, str], asked: tuple[tuple[Any, ...], tuple[str, ...]]
) -> list[dict[str, Any]]:
    """Reconstruct one photograph by some methods; return the variables of each one's cell."""
    (world, base, size), (trial, methods) = shared, asked
    of_trial = dict(zip(LIGHT, trial, strict=True))
    y, truth = world.photograph(**of_trial, base=base), world.truth(of_trial["image"])
    scale, surfaces = world.scale(of_trial["image"], of_trial["sbr"]), world.hidden.shapes
    outcomes = []
    own_error = world.own_error(*(of_trial[each] for each in ("image", "background", "sbr")))
    for name in methods:
        made = {**world.transport.get(name, {}), "photograph_error": own_error}
        of_A = {variable: made.get(variable, made.get(variable[10:])) for variable in MADE}
        values: dict[str, Any] = {n: v for n, v in of_A.items() if v is not None}
        try:
            found = estimates_by(world.methods[name], y.copy(), world.hidden, world.channels)
            measures = getattr(world.methods[name], "measures", None)
            if world.measures and measures:
                values |= {n: each for n, each in measures(y).items() if n in world.measures}
        except MemoryError:  # says more about the worker than about the method
            raise
        except OwnError as error:  # whatever a user's own method raises
            failure = without_addresses(f"{type(error).__name__}: {error}")
            outcomes.append({**values, "failure": failure})
            continue
        for of, surface in named("", {surface: surface for surface in surfaces}).items():
            image, errors = found.images[surface], found.errors.get(surface)
            metrics = measured(image, truth[surface], errors, scale)
            values |= {f"{metric}{of}": each for metric, each in metrics.items()}
            values[f"reconstruction{of}{size}"] = image
        outcomes.append({**values, "failure": "", "seconds": found.seconds})
    return outcomes
