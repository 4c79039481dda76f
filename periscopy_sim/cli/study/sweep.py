"""`periscopy sweep`: methods over images, ambient light, noise, and whatever varies in a scene."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import GRID, Light
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.output import progress, record, say, show_table, written
from periscopy_sim.cli.session import WallSession
from periscopy_sim.cli.study.axes import (
    DARK,
    check_numbers,
    parse_ambient,
    parse_axes,
    parse_values,
)
from periscopy_sim.cli.study.study_file import ExampleOption, StudyOption
from periscopy_sim.cli.study.worlds import KNOWN, Worlds
from periscopy_sim.evaluation.workers import check_scheduler
from periscopy_sim.extras import SWEEP, require_all
from periscopy_sim.figures.sweeps import draw_sweep, surfaces_of
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.reconstruction.registry import METHODS, libraries_of
from periscopy_sim.storage.formats.table import format_of
from periscopy_sim.storage.outputs.places import mirrored
from periscopy_sim.storage.outputs.provenance import array_sha256, scene_sha256, sha256_of
from periscopy_sim.storage.outputs.resume import resumed_folder
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    import xarray as xr

RENDERED = ("**/A*.npy", "**/photograph*.exr", "**/ambient")
_VARY = (
    "An axis: sbr, snr, a <default> of the scene (assumed.NAME: of the methods' alone), assumed, "
    "ruler, hidden, samples, model, scene, METHOD.OPTION. Values as 1,2,5, 0:1:5, 1:9:log:3."
)
_PHOTOGRAPH = "A photograph without ambient light; needs --truth."
_TRUTH = "The hidden image of --photograph; of several surfaces of each."
_IMAGES = "Hidden images whose photographs are rendered, by comma; or a folder."
_RATIOS = "Signal-to-background ratios: 0.1,1,10 or 0.1:10:log:9."
_AMBIENT = "Places, by comma: all, adversarial, shipped conditions, EXR files or folders; or none."
_METHODS = "Methods by comma; yours as module:callable or file.py:callable."
_SEEDS = "Noise draws for each background and SBR."
_SNRS = "Signal-to-noise ratios of Gaussian noise: 40,60 or 40:80:5; the signal includes light."
SBRS, SNRS, PLACES = "0.1,1,10", "60", "overcast,low_sun,ceiling_panels"
RUN = ("command", "scene", "seed", "python")
"""Provenance that differs from run to run, or that no result depends on."""
RESULTS = ("sweep.zarr", "sweep.csv", "sweep.png")
CELLS = "sweep.zarr/making/finished/*.json"
VARIED = "ambient_prototypes", "light_model_sha256", "mask", "monitor_off"
"""Settings that no rendering depends on: they may change until there are results."""


def sweep(
    session: Annotated[WallSession, {"hidden": ["29x36"]}],
    light: Light,
    out: options.Store,
    vary: Annotated[list[str] | None, option("NAME=VALUES", _VARY)] = None,
    photograph: Annotated[
        Path | None, option("FILE", _PHOTOGRAPH, group=PHOTOGRAPH, exists=True)
    ] = None,
    truth: Annotated[list[str] | None, option("[ID=]IMAGE", _TRUTH)] = None,
    hidden_image: Annotated[list[str] | None, option("[ID=]IMAGE,...", _IMAGES)] = None,
    sbr: Annotated[str, option("RATIOS", _RATIOS)] = SBRS,
    ambient: Annotated[str, option("LIST", _AMBIENT)] = PLACES,
    flips: Annotated[bool, typer.Option(help="Also flip each background about each axis.")] = False,
    methods: Annotated[str, option("LIST", _METHODS)] = "noise-aware,preconditioned,differencing",
    snr: Annotated[str, option("DB", _SNRS)] = SNRS,
    seeds: Annotated[int, option("NUMBER", _SEEDS, kind="count")] = 1,
    scheduler: options.Scheduler = None,
    study: StudyOption = None,  # noqa: ARG001, it has become the other options' defaults
    example: ExampleOption = False,  # noqa: ARG001
) -> None:
    """Compare methods over ambient light, SBRs, and any other axis.

    The same command resumes an interrupted sweep; more values compute only their cells.
    """
    from periscopy_sim.evaluation import sweep as sweeps
    from periscopy_sim.evaluation.methods import find_method, source_sha256
    from periscopy_sim.evaluation.world import flipped_names

    # Reject wrong values here, before hours of rendering.
    lights, names = parse_ambient(ambient), options.parse_list("--methods", methods)
    require_all(*SWEEP, *libraries_of(*names))
    if (photograph is None) == (not hidden_image) or (photograph is None) != (not truth):
        raise ps.PeriscopyError("give either --photograph with --truth, or --hidden-image alone")
    axes = parse_axes(vary)
    given = {"sbr": sbr != SBRS, "snr": snr != SNRS, "samples": light.samples, "model": light.model}
    for name in (*session.definitions, *(name for name, value in given.items() if value)):
        if name in axes:
            raise ps.PeriscopyError(f"--vary {name}: an option gives {name}, too; give one of them")
    of = {name: f"--vary {name}" if name in axes else f"--{name}" for name in ("sbr", "snr")}
    if (is_dark := DARK in lights) and (given["sbr"] or "sbr" in axes):
        raise ps.PeriscopyError(f"{of['sbr']}: --ambient {DARK} has no SBR; leave one of them out")
    ratios = axes.pop("sbr", None) or parse_values(sbr, of["sbr"])
    ratios = [math.inf] if is_dark else check_numbers("ratio", of["sbr"], ratios)
    decibels = axes.pop("snr", None) or parse_values(snr, of["snr"])
    decibels = check_numbers("decibels", of["snr"], decibels)
    if "hidden" in axes:
        session = replace(session, hidden=[str(axes["hidden"][0])])
    light.check_methods(*names)
    check_scheduler(scheduler)
    for file in filter(None, lights.values()):
        format_of(file)
    for name in names:
        find_method(name)
    shown = _shown(session, truth or hidden_image or [], "--truth" if truth else "--hidden-image")
    wall = None if photograph is None else session.wall(photograph)
    mask, monitor_off = session.companions() if wall is None else (wall.mask, wall.monitor_off)
    measured = {n: session.photograph(p, mask).values for n, p in lights.items() if p}
    if is_dark:  # of an infinite SBR nothing is added
        flips, measured = False, {DARK: np.ones((*session.scenario.photograph_shape, 3))}
    settings = {
        **{name: value for name, value in session.provenance.items() if name not in RUN},
        "base_seed": session.seed,
        "camera": session.sensor,
        "hidden_shape": None if "hidden" in axes else session.hidden_shape,
        "model": light.model and light.model.value,
        "samples": light.samples,
        **light.origin,
        "light_model_sha256": sha256_of(Path(each) for each in light.sources if each != GRID),
        "mask": None if mask is None else array_sha256(mask),
        "monitor_off": [array_sha256(image) for image in monitor_off.values()],
    }
    sources: dict[str, dict[str, Any]] = {
        "algorithm": {name: source_sha256(name) or "built in" for name in names},
        "image": {
            name: {
                "photograph": "rendered" if wall is None else array_sha256(wall.values),
                "truth": sha256_of(map(ps.find_image, pictures.values())),
            }
            for name, pictures in shown.items()
        },
        "background": {
            name: array_sha256(measured[light]) if light in measured else "rendered"
            for light in lights
            for name in flipped_names(light, flips)
        },
        "scene": {name: scene_sha256(ps.find_scene(str(name))) for name in axes.get("scene", ())},
    }
    worlds = Worlds(
        session=session, light=light, out=out, shown=shown, flips=flips, methods=names,
        photographs={} if wall is None else dict.fromkeys(shown, wall),
        ambient={name: measured.get(name) for name in lights},
        noise=noise_to_signal(max(decibels), max(ratios)),
        conditions={"settings": settings}, conditions_of=sources, calibrates=KNOWN in axes,
        scheduler=scheduler,
    )  # fmt: skip
    worlds.check(axes)
    with (
        resumed_folder(out, settings, "sweep", (CELLS, *RESULTS, *RENDERED), VARIED),
        mirrored(out, RESULTS) as (rendered, send),
    ):
        worlds = replace(worlds, out=rendered, keep=send)
        whole = sweeps.Sweep(
            world=worlds, sbrs=ratios, snrs=decibels, seeds=range(seeds), seed=session.seed,
            vary=axes, units=worlds.units(axes),
        )  # fmt: skip
        seconds: dict[str, list[float]] = {name: [] for name in names}
        with progress("sweeping") as report:
            results = sweeps.run_sweep(
                whole, out, scheduler=scheduler, progress=report,
                planned=lambda missing: worlds.forecast.begin(
                    whole.axes, missing, worlds.parts, len(flipped_names("", flips))
                ),
                timed=lambda name, taken: seconds[name].append(taken),
            )  # fmt: skip
        with staged_file(out / "sweep.png") as file:
            draw_sweep(file, results, metadata=session.metadata)
    _show_means(results)
    medians = {name: float(np.median(each)) for name, each in seconds.items() if each}
    times = [[name, f"{median:.2g} s"] for name, median in medians.items()]
    show_table(times, ["method", "median time of a core for a photograph"])
    computed = sum(map(len, seconds.values()))
    say(f"computed {computed} of {results['failure'].size} results")
    record(seconds=medians, computed=computed, results=results["failure"].size)
    by_default = light.model is None and light.samples is None
    checked = [n for n in names if not (by_default and n in METHODS and METHODS[n].rays)]
    _check_transport(session, results.sel(algorithm=checked), worlds.noise)
    _check_photographs(session, results)
    written(*(out / name for name in RESULTS))


def _check_photographs(session: WallSession, results: "xr.Dataset") -> None:
    """Warn of the photograph whose own error is largest beside its noise."""
    error = results["photograph_error"].fillna(0)
    worst = error.isel((error * 10 ** (results["snr"] / 20)).argmax(...))
    session.check_photograph(float(worst), float(worst["snr"]))


def _check_transport(session: WallSession, results: "xr.Dataset", noise: float) -> None:
    """Warn where an A errs more than the noise, or that of one line was made in several ways."""
    from periscopy_sim.evaluation.sweep import LIGHT

    for name in results["algorithm"].values.tolist():
        of_method = results.sel(algorithm=name)
        rays = of_method["transport_samples"].fillna(0)
        if bool((rays.max(LIGHT) != rays.min(LIGHT)).any()):
            numbers = ", ".join(f"{each:g}" for each in np.unique(rays) if each)
            session.warn(
                f"{name}: A of earlier cells has other rays to a patch, of {numbers}, since the "
                "photographs had more noise; see 'samples' in sweep.csv, or name another --out"
            )
        each = of_method.stack(each=of_method["failure"].dims)
        worst = each.isel(each=int(each["transport_error"].fillna(0).values.argmax()))
        samples, error = (float(worst[f"transport_{n}"]) for n in ("samples", "error"))
        plan = {
            "model": worst["transport_model"].item(),
            "samples": None if np.isnan(samples) else int(samples),
            "transport_error": None if np.isnan(error) else error,
        }
        session.check_error(plan, noise, f"{name}: A")


def _shown(session: WallSession, entries: Sequence[str], flag: str) -> dict[str, dict[str, str]]:
    """Return the hidden images by name, each the name of a picture for each surface by its id.

    Of one surface there may be several, by comma; a folder stands for all pictures in it.
    """
    if len(session.scenario.hidden) > 1:
        pictures = session.by_surface(entries, flag)
        return {",".join(f"{name}={Path(each).stem}" for name, each in pictures.items()): pictures}
    (surface,), files = session.scenario.hidden, list[str]()
    listed = ",".join(text.removeprefix(f"{surface}=") for text in entries)
    for entry in map(str.strip, listed.split(",")):
        path = Path(entry)
        held = sorted(path.glob("[!.]*")) if path.is_dir() else [entry]
        if not held:
            raise ps.PeriscopyError(f"{flag} {entry}: the folder is empty; name one with pictures")
        files += map(str, held)
    if flag == "--truth" and len(files) > 1:
        raise ps.PeriscopyError(f"--truth {','.join(entries)}: give that of --photograph alone")
    shown = {Path(file).stem: {surface: file} for file in files}
    if len(shown) < len(files):
        raise ps.PeriscopyError(f"{flag} {listed}: two pictures have one name; rename one")
    return shown


def _show_means(results: "xr.Dataset") -> None:
    """Print the mean PSNR of each method at each SBR, the differences, and the failures."""
    from periscopy_sim.evaluation.statistics import UNITS, counted, differences, interval

    kept = [axis for axis in ("algorithm", KNOWN) if axis in results.dims]
    surfaces, shown = surfaces_of(results, "psnr"), list[list[str]]()
    for surface in surfaces:
        psnr = results[surface]  # without failures
        means = psnr.mean([axis for axis in psnr.dims if axis not in (*kept, "sbr")])
        table = means.transpose(*kept, "sbr").to_series().unstack("sbr", sort=False)
        table = table.rename(columns="{:g}".format)
        values = table.astype(object).where(np.isfinite(table), None).reset_index()
        record(**{surface: values.to_dict("records")})
        cells = table.map("{:.1f} dB".format).where(table.notna(), "failed").reset_index()
        title = surface.replace("psnr", "mean PSNR").replace("_", " of ", 1)
        lights = [
            "no ambient light" if r == "inf" else f"SBR {float(r):.3g}" for r in table.columns
        ]
        header = [title, *kept[1:], *lights]
        show_table(cells.astype(str).values.tolist(), header)
    dims = [n for n in results["failure"].dims if n not in (*kept, "sbr", *UNITS)]
    if pooled := [str(n) for n in dims if results.sizes[n] > 1]:
        say(f"all means are over {', '.join(pooled)}, too; 'periscopy plot' shows each")
    axis, names = kept[-1], results["algorithm"].values.tolist()
    first, *others = results[axis].values.tolist()
    for surface in surfaces if others else ():
        compared = differences(results, [surface], first, axis)[surface]
        found = interval(-compared.mean([n for n in compared.dims if n not in (*kept, *UNITS)]))
        for _, one in found.stack(each=kept).groupby("each", squeeze=False):
            *method, name = one["each"].item()
            mean, half = one["mean"].item(), one["half"].item()
            if name != first and np.isfinite(mean):
                within = f" ± {half:.1f}" if np.isfinite(half) else ""
                what = ", ".join([surface, *method, f"{first} minus {name}"])
                shown.append([what, f"{mean:.1f}{within} dB", counted([one])])
    show_table(shown, ["difference", "95 %", "n"])
    if "trusted" in results:  # each by one calibration for all methods
        trusted = results["trusted"].max("algorithm")
        if count := trusted.count().item():
            say(f"{trusted.sum().item():g} of {count} calibrations are trusted")
    for name in names:
        messages = results["failure"].sel({"algorithm": name}).values.ravel()
        failed = messages[messages != ""]
        if failed.size:
            say(f"{name} failed on {failed.size} of {messages.size}, first: {failed[0]}")
