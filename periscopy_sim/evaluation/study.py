"""A sweep of a scenario: what it compares is checked, rendered once, reconstructed and kept.

Before it starts, its forecast lists what it lacks, and the time by the first of each part.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from periscopy_sim.errors import SWEEP, PeriscopyError, SceneError, did_you_mean, require_all
from periscopy_sim.evaluation.sweep import Sweep, cell_seconds, flipped_names, run_sweep
from periscopy_sim.evaluation.sweep_store import Values
from periscopy_sim.evaluation.workers import check_scheduler
from periscopy_sim.evaluation.worlds import KNOWN, Worlds, warn_of
from periscopy_sim.judgement import check_error
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.memo import Memo
from periscopy_sim.methods import (
    Name,
    OwnAxis,
    entry_of,
    find_method,
    label_of,
    source_sha256,
)
from periscopy_sim.numerics import Array, Mask, validation
from periscopy_sim.numerics.machine import LONG, Stage, silent
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Note
from periscopy_sim.rendering.ambient import Background
from periscopy_sim.rendering.photograph import excess_of
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import (
    ADVERSARIAL,
    CONDITIONS,
    DARK,
    REALISTIC,
    find_condition,
    find_image,
    find_scene,
    is_photograph,
)
from periscopy_sim.storage.formats import format_of
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.places import place
from periscopy_sim.storage.provenance import (
    array_sha256,
    provenance,
    resumed_folder,
    scene_sha256,
    sha256_of,
)

if TYPE_CHECKING:
    import xarray as xr

WRITING = 0.01
"""Seconds to write a cell: 0.008 measured on a local disk, for an image of 29 x 36 patches."""

SCENES = 8
"""Scenes that are loaded before a sweep starts, to see which ambient light is missing."""


@dataclass(eq=False)
class SweepWork:
    """What a sweep makes: results, of which some are missing, and what these need."""

    sweep: Sweep  # of `Worlds`
    sizes: dict[str, int]  # of the axes; backgrounds without their flips
    flips: int
    missing: int
    first: Values | None = None  # missing cell of the largest SNR whose methods need a matrix
    cells: Counter[str] = field(default_factory=Counter)  # missing, by method, without calibrations
    photographs: set[Any] = field(default_factory=set)
    lights: dict[Any, str] = field(default_factory=dict)  # names of ambient light
    matrices: set[Any] = field(default_factory=set)
    fits: set[Any] = field(default_factory=set)
    calibrations: set[Any] = field(default_factory=set)  # photographs that calibrate

    @property
    def results(self) -> int:
        """The number of results, those that are there included."""
        return self.flips * math.prod(self.sizes.values())

    @property
    def to_make(self) -> dict[str, int]:
        """Numbers of photographs, ambient light, matrices and calibrations."""
        return {
            "photograph": len(self.photographs), "ambient_light": len(self.lights),
            "matrix": len(self.matrices), "calibration": len(self.calibrations),
        }  # fmt: skip

    @classmethod
    def of(cls, sweep: Sweep, missing: Sequence[Values]) -> Self:
        """Return what missing cells of a sweep need."""
        worlds: Worlds = sweep.world
        sizes = {name: len(values) for name, values in sweep.axes.items()}
        flips = len(flipped_names("", worlds.flips))
        sizes["background"] //= flips
        work, places = cls(sweep, sizes, flips, len(missing)), dict[str, Any]()
        rendered = worlds.shown.keys() - worlds.photographs.keys()
        for cell in missing:
            values = {name: cell[name] for name in sweep.vary}
            place = worlds.place(values)
            places.setdefault(place, values)
            snr = cell["snr"]
            work.photographs |= {(place, name, snr) for name in rendered}
            if matrices := worlds.matrices(values, snr):
                work.matrices |= matrices
                work.fits.add((snr, *values.values()))
                work.cells[cell["algorithm"]] += 1
                if work.first is None or snr > work.first["snr"]:
                    work.first = cell
            else:
                work.calibrations.add((*(v for name, v in cell.items() if name != "algorithm"),))
        for values in [*places.values()][:SCENES]:
            with suppress(SceneError):  # which fails alone
                work.lights |= worlds.at(values).missing_ambient(worlds.traced)
        return work

    def seconds(self, threads: int) -> float | None:
        """Return how long the missing cells take on some threads, but for light and calibrations.

        The parts of one world of the largest SNR, which take longest and are made, and one more fit
        are timed. None where all calibrate, or that world is an error, which the sweep meets.
        """
        worlds: Worlds = self.sweep.world
        if (first := self.first) is None:
            return None
        values, snr = {name: first[name] for name in self.sweep.vary}, first["snr"]
        try:
            started = time.perf_counter()
            for name in worlds.shown:
                wall = worlds.signal(name, snr, values)
            of_photographs = time.perf_counter() - started
            of_matrices, of_fit = self._fit(worlds, snr, values, wall)
            if of_matrices + of_fit < LONG:  # without what the first one compiles
                fresh = replace(worlds, scenario=replace(worlds.scenario, memo=Memo()))
                of_matrices, of_fit = self._fit(fresh, snr, values, wall)
            even = Background(np.ones_like(wall.values), 0.0, 0.0)
            world = worlds.world(snr, values, dict.fromkeys(worlds.ambient, even))
            trial = {name: {**first, "algorithm": name} for name in self.cells}
            of_cell = cell_seconds(world, trial)
        except PeriscopyError:
            return None
        return (
            of_photographs * (len(self.photographs) / len(worlds.shown) - 1)
            + of_matrices * (len(self.matrices) / len(worlds.matrices(values, snr)) - 1)
            + of_fit * (len(self.fits) - 1)
            + sum(self.cells[n] * (each / threads + WRITING) for n, each in of_cell.items())
        )

    @staticmethod
    def _fit(worlds: Worlds, snr: float, values: Values, wall: Photograph) -> tuple[float, float]:
        """Return the seconds of the matrices, and of fits to them."""
        scene, started = worlds.assumed(values), time.perf_counter()
        for method in worlds.methods.values():
            scene.transport(noise_to_signal(snr, np.inf), method)
        made = time.perf_counter()
        worlds.fitted(snr, values, wall)
        return made - started, time.perf_counter() - made


COMPARED = "noise-aware", "preconditioned", "differencing"
PLACES = "overcast", "low_sun", "ceiling_panels"
SBRS, SNRS = (0.1, 1.0, 10.0), (60.0,)
"""What a sweep compares where nothing else is asked for."""

RUN = "command", "scene", "seed", "python"
"""Provenance that differs from run to run, or that no result depends on."""

RESULTS = "sweep.zarr", "sweep.csv", "sweep.png"
CELLS = "sweep.zarr/making/finished/*.json"


def sweep(
    scenario: Scenario,
    images: Iterable[str | Path] | Mapping[str, Any],
    out: str | Path | None = None,
    *,
    methods: Iterable[Name] | Mapping[str, Name] = COMPARED,
    ambient: Iterable[str | Path] | Mapping[str, Any] = PLACES,
    flips: bool = False,
    sbr: float | Iterable[float] = SBRS,
    snr: float | Iterable[float] = SNRS,
    seeds: int = 1,
    vary: Mapping[Any, Iterable[Any]] | None = None,
    photograph: Photograph | None = None,
    mask: Mask | None = None,
    monitor_off: Mapping[str, Array] | None = None,
    scheduler: str | None = None,
    planned: Callable[[Sweep, Sequence[Values]], None] | None = None,
    timed: Callable[[str, float], None] | None = None,
    noted: Callable[[Sequence[Note | str]], None] = warn_of,
    progress: Stage = silent,
    command: Sequence[str] = (),
) -> "xr.Dataset":
    """Compare methods over hidden images, ambient light, noise, and whatever varies in a scene.

    Photographs are rendered for each SNR, and each method is fitted to an A that is as fine. The
    same call with the same folder resumes an interrupted sweep; more values compute only their
    cells.

    Parameters
    ----------
    scenario
        The scene; its `light` and `seed` are those of A and of whatever is drawn.
    images
        Files or shipped pictures that the hidden surfaces show; a mapping gives them, and arrays,
        names, of several surfaces to mappings by id; see `Scenario.image`.
    out
        Folder, or URL that fsspec opens, of ``sweep.zarr``, ``sweep.csv`` and the photographs that
        are rendered; None keeps the results in memory alone.
    methods
        Names, ``file.py:callable``, or callables of (scenario, A, B); a mapping gives them names.
    ambient
        Shipped conditions, ``all``, ``adversarial``, scene files, EXR files or folders of these; or
        ``none``.
        A mapping has light as of `Scenario.ambient` by name.
    flips
        Whether each ambient light is also flipped about each axis and about both (Sec. 4.1).
    sbr, snr
        Signal-to-background ratios; signal-to-noise ratios in dB.
    seeds
        Noise draws for each image, background and SBR.
    vary
        Further axes: ``sbr``, ``snr``, a <default> of the scene (``assumed.NAME``: of the methods'
        scene alone), ``assumed``, ``ruler``, ``hidden``, ``samples``, ``model``, ``scene``,
        ``METHOD.OPTION``; or ``file.py:function``, or a function, of (photograph, value), which
        returns what a camera makes of each photograph with its noise.
    photograph
        A photograph without ambient light, of the only image, in place of a rendered one.
    mask, monitor_off
        The pixels that rendered photographs use, and photographs with the monitor off, by name.
    scheduler
        Address of a Dask scheduler; None uses this machine's cores.
    planned
        Called before the sweep, with it and the cells that are missing; see `SweepWork.of`.
    timed
        Called with the name of a method and a thread's seconds that it took for a photograph.
    noted
        Called with notes on scenes, or lines; by default they are warnings.
    progress
        Called with the name of each rendering, gives the function that takes the fraction done.
    command
        The words of a command, for the record.

    Returns
    -------
    xarray.Dataset
        Over ``algorithm``, ``image``, ``background``, ``sbr``, ``snr``, ``seed`` and the further
        axes; see `run_sweep`.

    Raises
    ------
    PeriscopyError
        If an axis, a method, a picture or a place does not exist, or a number is out of range.
    OutputError
        If the folder holds another sweep, or cannot be written.
    """
    validation.checked_scene(scenario)
    named = _named_methods(methods)
    require_all(*SWEEP)
    for method in named.values():
        find_method(method)
    validation.checked("seeds", seeds, "count")
    axes, own_axes = dict[str, list[Any]](), dict[str, OwnAxis]()
    for name, values in (vary or {}).items():
        axis = OwnAxis.of(name) if callable(name) or ":" in name else None
        label = str(name) if axis is None else axis.label
        if label in axes:
            raise PeriscopyError(f"vary {label}: two axes have this name; rename one")
        axes[label] = [float(v) if isinstance(v, Real) else v for v in validation.listed(values)]
        own_axes |= {} if axis is None else {label: axis}
    if "hidden" in axes:
        axes["hidden"] = ["{}x{}".format(*validation.size_of(each)) for each in axes["hidden"]]
    own = dict(ambient) if isinstance(ambient, Mapping) else {}
    lights = dict.fromkeys(own) or conditions_of(ambient)
    own |= {name: file for name, file in lights.items() if file and file.suffix == ".xml"}
    lights |= dict.fromkeys(own)
    is_dark = DARK in lights and not own
    of = {name: f"vary {name}=" if name in axes else name for name in ("sbr", "snr")}
    if is_dark and ("sbr" in axes or sbr is not SBRS):
        raise PeriscopyError(f"{of['sbr']}: ambient {DARK} has no SBR; leave one of them out")
    for name, value, default in (("sbr", sbr, SBRS), ("snr", snr, SNRS)):
        if name in axes and value is not default:
            raise PeriscopyError(f"vary {name}: the option {name} gives it, too; give one of them")
    ratios = axes.pop("sbr", sbr)
    ratios = [math.inf] if is_dark else validation.checked(of["sbr"], ratios, "ratio")
    decibels = validation.checked(of["snr"], axes.pop("snr", snr), "decibels")
    check_scheduler(scheduler)
    for file in filter(None, lights.values()):
        format_of(file)
    shown = images_by_name(scenario, images)
    off = monitor_off or {}
    if photograph is not None:
        mask, off = photograph.mask, photograph.monitor_off
        noted(photograph.warnings)
        if len(shown) > 1:
            raise PeriscopyError("photograph: it shows one image; give that alone")
    shape = scenario.photograph_shape
    read = {n: read_photograph(file, shape, mask) for n, file in lights.items() if file}
    noted([line for each in read.values() for line in each.warnings])
    seen = {n: scenario.ambient(each) for n, each in own.items() if is_photograph(each)}
    noted([line for each in seen.values() for line in each.warnings])
    measured = {name: each.photograph for name, each in seen.items()}
    measured |= {name: each.values for name, each in read.items()}
    if is_dark:  # of an infinite SBR nothing is added
        flips, measured = False, {DARK: np.ones((*shape, 3))}
    light = scenario.light
    settings = {
        **{n: v for n, v in provenance(scenario.document, scenario.seed).items() if n not in RUN},
        "base_seed": scenario.seed,
        "camera": scenario.view.camera,
        "hidden_shape": None
        if "hidden" in axes
        else scenario.hidden.unwrapped(scenario.hidden.shapes),
        "model": next((name for name, way in validation.WAYS.items() if way == light.by), None),
        "samples": light.samples,
        "bounces": validation.bounces_in_words(light.bounces),
        "ambient_prototypes": light.prototypes,
        "mask": None if mask is None else array_sha256(mask),
        "monitor_off": [array_sha256(image) for image in off.values()],
    }
    if own_axes:
        settings["axes"] = {n: source_sha256(each.name) for n, each in own_axes.items()}
    if light.matrix is not None:
        settings["transport"] = array_sha256(np.asarray(light.matrix))
    sources: dict[str, dict[str, Any]] = {
        "algorithm": {name: source_sha256(each) or "built in" for name, each in named.items()},
        "image": {
            name: {
                "photograph": "rendered" if photograph is None else array_sha256(photograph.values),
                "truth": _sha256_of(pictures.values()),
            }
            for name, pictures in shown.items()
        },
        "background": {
            name: array_sha256(measured[place])
            if place in measured
            else scene_sha256(find_condition(own[place]))
            if place in own
            else "rendered"
            for place in lights
            for name in flipped_names(place, flips)
        },
        "scene": {name: scene_sha256(find_scene(str(name))) for name in axes.get("scene", ())},
    }
    worlds = Worlds(
        scenario=scenario, shown=shown, flips=flips, methods=named,
        photographs={} if photograph is None else dict.fromkeys(shown, photograph),
        ambient={name: measured.get(name, own.get(name, name)) for name in lights},
        conditions={"settings": settings}, conditions_of=sources, mask=mask, monitor_off=off,
        own_axes=own_axes, calibrates=KNOWN in axes,
        out=None if out is None else place(out), command=command, progress=progress, noted=noted,
    )  # fmt: skip
    worlds.check(axes)
    whole = Sweep(
        world=worlds, sbrs=ratios, snrs=decibels, seeds=range(seeds), seed=scenario.seed,
        vary=axes, units=worlds.units(axes),
    )  # fmt: skip
    with TemporaryDirectory() as temporary, progress("sweeping") as report:
        folder = worlds.out or Path(temporary)
        with resumed_folder(folder, settings, "sweep", (CELLS, *RESULTS)):
            results = run_sweep(
                whole, folder, scheduler=scheduler, progress=report, timed=timed,
                planned=planned and partial(planned, whole),
            )  # fmt: skip
    noted(_notes(scenario, results, worlds, by_default=not (light.by or light.samples)))
    return results


def _names(values: Any, what: str) -> list[str]:
    """Return names, of which there may be one alone; whatever is none needs a mapping."""
    names = validation.listed(values)
    if wrong := [each for each in names if not validation.is_name(each)]:
        kind = type(wrong[0]).__name__
        raise PeriscopyError(f"{what} of type {kind}: give names, or a mapping that names each")
    return [str(each) for each in names]


def _sha256_of(pictures: Iterable[Any]) -> str:
    """Return the digest of pictures: of files, or of arrays."""
    given = [*pictures]
    if all(map(validation.is_name, given)):
        return str(sha256_of(map(find_image, given)))
    return ",".join(map(array_sha256, map(np.asarray, given)))


def _named_methods(
    methods: Iterable[Name] | Mapping[str, Name],
) -> dict[str, Name]:
    """Return methods by their names; one that is given twice is an error."""
    if isinstance(methods, Mapping):
        return dict(methods)
    names = validation.listed(methods)
    named = {label_of(each): each for each in names}
    if len(named) < len(names):
        raise PeriscopyError("methods: two have one name; give a mapping with other names")
    return named


def images_by_name(
    scenario: Scenario, images: Iterable[str | Path] | Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the picture of each surface, by its id, of each hidden image, by its name."""
    if not isinstance(images, Mapping):
        names = _names(images, "images")
        images = {Path(each).stem: each for each in names}
        if len(images) < len(names):
            raise PeriscopyError(f"images {','.join(names)}: two pictures have one name")
    shown = {
        str(name): dict(each) if isinstance(each, Mapping) else dict.fromkeys(scenario.hidden, each)
        for name, each in images.items()
    }
    for name in shown:
        scenario.image(shown[name])
    return shown


def conditions_of(entries: Iterable[str | Path]) -> dict[str, Path | None]:
    """Return the file of each ambient light; None for a shipped condition, and for `DARK`."""
    names = _names(entries, "ambient")
    if names == [DARK]:
        return {DARK: None}
    groups = {"all": REALISTIC, "adversarial": ADVERSARIAL, **{name: [name] for name in CONDITIONS}}
    lights: dict[str, Path | None] = {}
    for entry in names:
        path = Path(entry)
        files = sorted(path.glob("*.exr")) if path.is_dir() else [path]
        added: dict[str, Path | None]
        added = {file.stem: file for file in files if file.suffix in (".exr", ".xml")}
        added = dict.fromkeys(groups[entry]) if entry in groups else added
        if not added or added.keys() & lights.keys():
            guess = "" if entry in groups else did_you_mean(entry, groups)
            raise PeriscopyError(
                f"ambient {entry}: {guess and f'{guess} '}write an EXR or a scene file, a folder "
                f"of EXR files, all, adversarial, {', '.join(CONDITIONS)}, each once, or {DARK} "
                "alone"
            )
        lights |= added
    return lights


def _notes(
    scenario: Scenario, results: "xr.Dataset", worlds: Worlds, *, by_default: bool
) -> list[Note | str]:
    """Note where an A, or a photograph, errs more than its noise."""
    notes: list[Note | str] = []
    for name in results["algorithm"].values.tolist():
        entry = entry_of(worlds.methods[name])
        if by_default and entry is not None and entry.rays:
            continue
        of_method = results.sel(algorithm=name)
        each = of_method.stack(each=of_method["failure"].dims)
        excess = each["transport_error"].fillna(0) * 10 ** (each["snr"] / 20)
        worst = each.isel(each=int(excess.values.argmax()))
        samples, error = (float(worst[f"transport_{n}"]) for n in ("samples", "error"))
        origin = {
            "model": worst["transport_model"].item(),
            "samples": None if np.isnan(samples) else int(samples),
            "transport_error": None if np.isnan(error) else error,
        }
        noise = noise_to_signal(float(worst["snr"]), np.inf)
        notes += check_error(scenario, origin, noise, f"{name}: A")
    error = results["photograph_error"].fillna(0)
    worst = error.isel((error * 10 ** (results["snr"] / 20)).argmax(...))
    return [*notes, *excess_of(float(worst), float(worst["snr"]))]
