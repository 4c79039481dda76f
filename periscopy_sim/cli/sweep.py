"""`periscopy sweep`, methods over whatever varies in a scene, and `periscopy plot` of its results.

A study file has the options of a sweep as YAML, where they are too long for a line.
"""

import math
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.cli import options, output
from periscopy_sim.cli.session import WallSession
from periscopy_sim.errors import SWEEP, ConfigurationError, OutputError, did_you_mean, require_all
from periscopy_sim.evaluation.sweep_store import read_sweep
from periscopy_sim.figures import style, sweeps
from periscopy_sim.numerics.validation import RANGES, in_range, number_of
from periscopy_sim.storage import outputs
from periscopy_sim.storage.places import place
from periscopy_sim.storage.store import attributes_of

if TYPE_CHECKING:
    import xarray as xr

    from periscopy_sim.evaluation.study import SweepWork
    from periscopy_sim.evaluation.sweep import Sweep
    from periscopy_sim.reconstruction.method import Note

OWN = "study", "example", "quiet", "as_json"
"""Options that a study file cannot have."""

EXAMPLE = Path(__file__).with_name("example.yaml")


def _read(context: typer.Context, file: Path | None) -> Path | None:
    """Take a study file's entries for the defaults of a command's options.

    Its entries are named as the options, and their texts are those of the command line: a list has
    what stands between commas, a mapping what is repeated as ``NAME=VALUE``.
    """
    if file is None:
        return None
    from pydantic import Field, create_model

    from periscopy_sim.storage.yaml_document import Strict, read_yaml

    options = [each for each in context.command.params if each.name not in OWN]
    fields: dict[str, Any] = {
        str(each.name): (Any, Field(None, alias=str(each.name).replace("_", "-")))
        for each in options
    }
    model = create_model("Study", __base__=Strict, folder=(Path, ...), **fields)
    study = read_yaml(file, model, as_texts=True)
    given = study.model_dump(include=study.model_fields_set - {"folder"})
    context.default_map = {}
    for each in (each for each in options if each.name in given):
        value = given[each.name]
        parts = value if isinstance(value, dict) else {}
        whole = {each.name: value, **{f"{each.name}: {name}": part for name, part in parts.items()}}
        if empty := [name for name, part in whole.items() if part in ("", [], {})]:
            raise ConfigurationError(f"{file}: {empty[0]}: give a value, or leave the entry out")
        if parts and not each.multiple:
            raise ConfigurationError(f"{file}: {each.name}: give a value, or a list")
        texts = _texts(value)
        context.default_map[each.name] = texts if each.multiple else ",".join(texts)
        if isinstance(value, dict):
            each.callback = partial(_joined, texts)
    return file


def _joined(study: list[str], _context: Any, _option: Any, given: list[str]) -> list[str]:
    """Return what the command line gives as ``NAME=VALUE``, and of other names what a study has."""
    if not all("=" in entry for entry in given):
        return given
    names = {entry.partition("=")[0] for entry in given}
    return [*(entry for entry in study if entry.partition("=")[0] not in names), *given]


def _texts(value: Any) -> list[str]:
    """Return what an option is given, repeated."""
    if isinstance(value, dict):
        return [f"{name}={','.join(_texts(each))}" for name, each in value.items()]
    return [*map(str, value)] if isinstance(value, list) else [str(value)]


_STUDY = "YAML with these, SCENE and --out too; the command line's count first."
StudyOption = Annotated[
    Path | None, options.option("FILE", _STUDY, group=options.SCENE, is_eager=True, callback=_read)
]
ExampleOption = Annotated[bool, options.example_of(__name__, "a commented study file")]


_VARY = (
    "An axis: sbr, snr, a <default> of the scene (assumed.NAME: of the methods' alone), assumed, "
    "ruler, hidden, samples, model, scene, METHOD.OPTION; yours as file.py:function. Values as "
    "1,2,5, 0:1:5, 1:9:log:3."
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
PATCHES = "29x36"
OPTIONS = "sbr", "snr", "samples", "model", "hidden"
"""Options that are axes, too."""

AXES = {
    "algorithm": "method", "image": "image", "background": "place", "sbr": "SBR", "snr": "SNR",
    "seed": "seed",
}  # fmt: skip
"""Axes that every sweep has, in words."""


def sweep(
    context: typer.Context,
    session: Annotated[WallSession, {"hidden": [PATCHES]}],
    light: options.LightOptions,
    out: options.Store,
    vary: Annotated[list[str] | None, options.option("NAME=VALUES", _VARY)] = None,
    photograph: Annotated[
        Path | None, options.option("FILE", _PHOTOGRAPH, group=options.PHOTOGRAPH, exists=True)
    ] = None,
    truth: Annotated[list[str] | None, options.option("[ID=]IMAGE", _TRUTH)] = None,
    hidden_image: Annotated[list[str] | None, options.option("[ID=]IMAGE,...", _IMAGES)] = None,
    sbr: Annotated[str, options.option("RATIOS", _RATIOS)] = SBRS,
    ambient: Annotated[str, options.option("LIST", _AMBIENT)] = PLACES,
    flips: Annotated[bool, typer.Option(help="Also flip each background about each axis.")] = False,
    methods: Annotated[
        str, options.option("LIST", _METHODS)
    ] = "noise-aware,preconditioned,differencing",
    snr: Annotated[str, options.option("DB", _SNRS)] = SNRS,
    seeds: Annotated[int, options.option("NUMBER", _SEEDS, kind="count")] = 1,
    scheduler: options.Scheduler = None,
    study: StudyOption = None,
    example: ExampleOption = False,  # noqa: ARG001
) -> None:
    """Compare methods over ambient light, SBRs, and any other axis.

    The same command resumes an interrupted sweep; more values compute only their cells.
    """
    from periscopy_sim.evaluation.study import SweepWork
    from periscopy_sim.evaluation.workers import thread_count

    names = options.parse_list("--methods", methods)
    require_all(*SWEEP)
    if (photograph is None) == (not hidden_image) or (photograph is None) != (not truth):
        raise ps.PeriscopyError("give either --photograph with --truth, or --hidden-image alone")
    axes = parse_axes(vary)
    # A study's entries have become the other options' defaults.
    source = context.get_parameter_source("vary")
    varies = f"{study}: vary" if source and source.name == "DEFAULT_MAP" else "--vary"
    sources = {name: context.get_parameter_source(name) for name in OPTIONS}
    names_of = {"DEFAULT": "", "DEFAULT_MAP": str(study)}
    given = {n: names_of.get(each.name, f"--{n}") for n, each in sources.items() if each}
    for name, by in {**dict.fromkeys(session.definitions, "-D"), **given}.items():
        if by and name in axes:
            raise ps.PeriscopyError(f"{varies} {name}: {by} gives {name}, too; give one of them")
    if "hidden" in axes:
        session = replace(session, hidden=[str(axes["hidden"][0])])
    light.check_methods(*names)
    shown = _shown(session, truth or hidden_image or [], "--truth" if truth else "--hidden-image")
    wall = None if photograph is None else session.wall(photograph)
    mask, monitor_off = session.companions() if wall is None else (None, None)
    texts = {"sbr": sbr, "snr": snr}
    levels = {name: parse_values(texts[name], f"--{name}") for name in texts if given[name]}
    seconds = defaultdict[str, list[float]](list)

    def planned(swept: "Sweep", missing: Sequence[Mapping[str, Any]]) -> None:
        _show_work(work := SweepWork.of(swept, missing))
        if (total := work.seconds(thread_count(scheduler))) is not None:
            apart = {"ambient light": len(work.lights), "calibration": len(work.calibrations)}
            output.show_time(total, *(output.counted(n, noun) for noun, n in apart.items() if n))

    def noted(notes: "Sequence[Note | str]") -> None:
        for each in notes:
            session.warn(each) if isinstance(each, str) else session.warn_of([each])

    results = ps.sweep(
        session.lit(light), shown, out, methods=names,
        ambient=options.parse_list("--ambient", ambient), flips=flips, seeds=seeds,
        vary=axes, **levels, photograph=wall, mask=mask, monitor_off=monitor_off,
        scheduler=scheduler, planned=planned,
        timed=lambda method, taken: seconds[method].append(taken), noted=noted,
        progress=output.progress, command=["periscopy", *sys.argv[1:]],
    )  # fmt: skip
    with outputs.staged_file(out / "sweep.png") as file:
        sweeps.draw_sweep(file, results, metadata=session.metadata)
    _show_means(results)
    medians = {name: float(np.median(seconds[name])) for name in names if name in seconds}
    times = [[name, f"{median:.2g} s"] for name, median in medians.items()]
    output.show_table(times, ["method", "median time of a core for a photograph"])
    computed = sum(map(len, seconds.values()))
    failed = int((results["failure"] != "").sum())
    again = f"; the same command tries the {failed} again that failed" * bool(failed)
    output.say(f"computed {computed} of {results['failure'].size} results{again}")
    output.record(seconds=medians, computed=computed, results=results["failure"].size)
    output.written(*(out / name for name in ("sweep.zarr", "sweep.csv", "sweep.png")))


def _show_work(work: "SweepWork") -> None:
    """Print the results as a product over the axes, and what those that are missing need."""
    output.record(missing=work.missing, results=work.results)
    if not work.missing:
        return
    words = [
        output.counted(size, AXES[name]) if name in AXES else f"{size} values of {name}"
        for name, size in work.sizes.items() if size > 1 or name in ("algorithm", "image")
    ] + [output.counted(work.flips, "flip")] * (work.flips > 1)  # fmt: skip
    left = f"{work.missing:,} of " if work.missing < work.results else ""
    output.say(f"{left}{output.counted(work.results, 'result')}: {' x '.join(words)}")
    output.show_parts(**work.to_make)


def _shown(session: WallSession, entries: Sequence[str], flag: str) -> dict[str, dict[str, str]]:
    """Return the hidden images by name, each the name of a picture for each surface by its id.

    Of one surface there may be several, by comma; a folder stands for all pictures in it.
    """
    if len(session.scenario.hidden) > 1:
        pictures = session.by_surface(entries, flag)
        return {",".join(f"{name}={Path(each).stem}" for name, each in pictures.items()): pictures}
    (surface,), files = session.scenario.hidden, list[str]()
    listed = ",".join(options.by_name(flag, entries, [surface], str)[surface])
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
    from periscopy_sim.evaluation.statistics import UNITS, differences, interval
    from periscopy_sim.evaluation.statistics import counted as counted_units
    from periscopy_sim.evaluation.worlds import KNOWN

    kept = [axis for axis in ("algorithm", KNOWN) if axis in results.dims]
    surfaces, shown = sweeps.surfaces_of(results, "psnr"), list[list[str]]()
    over = [axis for axis in results["failure"].dims if axis not in (*kept, "sbr")]

    def by_ratio(values: "xr.DataArray") -> Any:
        table = values.transpose(*kept, "sbr").to_series().unstack("sbr", sort=False)
        return table.rename(columns="{:g}".format)

    failed = by_ratio((results["failure"] != "").sum(over))
    size = math.prod(results.sizes[axis] for axis in over)
    marks = failed.map(lambda count: f" ({size - count} of {size})" * bool(count))
    for surface in surfaces:
        table = by_ratio(results[surface].mean(over))  # without failures
        values = table.astype(object).where(np.isfinite(table), None).reset_index()
        output.record(**{surface: values.to_dict("records")})
        texts = table.map("{:.1f} dB".format) + marks
        cells = texts.where(table.notna(), "failed").reset_index()
        title = surface.replace("psnr", "mean PSNR").replace("_", " of ", 1)
        lights = [
            "no ambient light" if ratio == "inf" else f"SBR {ratio}" for ratio in table.columns
        ]
        header = [title, *kept[1:], *lights]
        output.show_table(cells.astype(str).values.tolist(), header)
    dims = [n for n in results["failure"].dims if n not in (*kept, "sbr", *UNITS)]
    if pooled := [str(n) for n in dims if results.sizes[n] > 1]:
        output.say(f"all means are over {', '.join(pooled)}, too; 'periscopy plot' shows each")
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
                shown.append([what, f"{mean:.1f}{within} dB", counted_units([one])])
    output.show_table(shown, ["difference", "95 %", "n"])
    if "trusted" in results:  # each by one calibration for all methods
        trusted = results["trusted"].max("algorithm")
        if count := trusted.count().item():
            output.say(f"{trusted.sum().item():g} of {count} calibrations are trusted")
    for name in names:
        messages = results["failure"].sel({"algorithm": name}).values.ravel()
        reasons = messages[messages != ""]
        if reasons.size:
            output.say(f"{name} failed on {reasons.size} of {messages.size}, first: {reasons[0]}")


def parse_values(text: str, flag: str) -> list[Any]:
    """Read the values of an axis: ``1,2,5`` or words, ``0:1:5``, or ``0.1:10:log:9`` (or ``lin``).

    Values that are all numbers become such.
    """
    steps = re.fullmatch("(.+?):(.+?):(?:(log|lin):)?([0-9]{1,4})", text)
    words = [*steps.groups()[:2]] if steps else text.split(",")
    values: list[Any] = [number_of(each) for each in words]
    if steps:
        valid = np.isfinite(values).all() and (steps[3] != "log" or min(values) > 0)
        space: Any = np.geomspace if steps[3] == "log" else np.linspace
        values = [float(f"{each:.6g}") for each in space(*values, int(steps[4]))] if valid else []
    elif not np.isfinite(values).all():
        is_range = ":" in text and np.isfinite([number_of(each) for each in text.split(":")]).all()
        values = [] if is_range else [each.strip() for each in words]
    if not (in_range("count", len(values)) and all(map(str, values))):
        form = "1,2,5, or 0:1:5, or 0.1:10:log:9, at most {:,}".format(RANGES["count"].most)
        raise ps.PeriscopyError(f"{flag} '{text}': write values as {form}")
    if len({*values}) < len(values):
        raise ps.PeriscopyError(f"{flag} '{text}': give each value once")
    return values


def parse_axes(entries: Iterable[str] | None) -> dict[str, list[Any]]:
    """Read ``--vary NAME=VALUES``, each name once."""
    axes = options.parse_definitions(entries, "--vary")
    return {name: parse_values(text, f"--vary {name}") for name, text in axes.items()}


_SWEEP = "What 'periscopy sweep' wrote."
_METRIC = (
    "psnr, psnr_plain, psnr_registered, mean_squared_error, ssim, covered_1, covered_2; of "
    "calibrations trusted, within_1, within_3, error.NUMBER, claimed.NUMBER."
)
_OVER = "Axis to draw over. [default: the SBR, or what has several values]"
_PANELS = "Axis of which each value has a panel. [default: the next one]"
_AT = "Values of an axis to keep, by comma; repeatable."
_LABEL = "What to call an axis, a metric or a method; repeatable."
_REFERENCE = "Show differences to this method, or to AXIS=VALUE, photograph by photograph."
_WIDTH = f"{style.COLUMN:g} for a column, {style.PAGE:g} for a page."
_OUT = "PNG, PDF or SVG for a figure, TEX or CSV for a table."
PICTURES, TABLES = (".png", ".pdf", ".svg"), (".tex", ".csv")


def plot(
    folder: Annotated[Path, options.argument("SWEEP", _SWEEP, parser=str, callback=place)],
    out: Annotated[Path, options.option("FILE", _OUT, group=options.OUTPUT)],
    metric: Annotated[str, options.option("NAME", _METRIC)] = "psnr",
    over: Annotated[str, options.option("AXIS", _OVER)] = "",
    panels: Annotated[str, options.option("AXIS", _PANELS)] = "",
    at: Annotated[list[str] | None, options.option("NAME=VALUES", _AT)] = None,
    label: Annotated[list[str] | None, options.option("NAME=WORDS", _LABEL)] = None,
    reference: Annotated[str, options.option("METHOD", _REFERENCE)] = "",
    width: Annotated[float, options.option("INCHES", _WIDTH, kind="inches")] = style.COLUMN,
) -> None:
    """Draw what the last sweep asked for, or write its table."""
    require_all(*SWEEP)
    if out.suffix in TABLES and (over or panels):
        raise ps.PeriscopyError("--over and --panels are of figures; leave them out")
    if out.suffix not in (endings := (*PICTURES, *TABLES)):
        raise OutputError(f"--out {out}: name a file that ends in {', '.join(endings)}")
    held = options.parse_definitions(at, "--at")
    texts = {axis: options.parse_list("--at", values) for axis, values in held.items()}
    axis, equals, value = reference.rpartition("=")
    axis = axis if equals else "algorithm"
    if reference and axis in texts:
        texts[axis].append(value)
    store = attributes_of(folder / "sweep.zarr")
    if "axes" not in store:
        raise ps.PeriscopyError(f"{folder}: holds no sweep; name a folder of 'periscopy sweep'")
    last: dict[str, list[Any]] = store.get("asked", {})
    asked = {name: values for name, values in last.items() if name not in texts}
    if reference and axis in asked:
        kept = [*asked[axis], *(v for v in store["axes"][axis] if v in (value, number_of(value)))]
        asked[axis] = [*dict.fromkeys(kept)]
    results = _held(read_sweep(folder / "sweep.zarr", asked), texts)
    if any(_begun(results)[held].size < results.sizes[held] for held in texts):
        asked = {}  # an earlier sweep gave these values, with other ones of other axes
        results = _held(read_sweep(folder / "sweep.zarr"), texts)
    results = _complete(results, last)
    if others := [each for each in asked if len(asked[each]) < len(store["axes"][each])]:
        output.say(
            f"as the last sweep asked; {folder} holds more values of {', '.join(others)}, which "
            "--at NAME=VALUES draws"
        )
    if reference:
        from periscopy_sim.evaluation.statistics import differences

        results = differences(results, sweeps.surfaces_of(results, metric), value, axis)
    results = sweeps.labelled(results, metric, options.parse_definitions(label, "--label"))
    with output.output_files(out) as (file,):
        if out.suffix == ".csv":
            sweeps.table_of(results, metric).to_csv(file, index=False, lineterminator="\n")
        elif out.suffix == ".tex":
            file.write_text(sweeps.latex_of(results, metric, f"tab:{out.stem}"), "utf-8")
        else:
            output.say(
                sweeps.draw_sweep(
                    file, results, metric=metric, over=over, panels=panels, width=width
                )
            )


def _held(results: "xr.Dataset", at: Mapping[str, Sequence[str]]) -> "xr.Dataset":
    """Return results at values of some axes, written as texts."""
    for axis, texts in at.items():
        if axis not in results.coords:
            axes = [str(name) for name in results.psnr.dims] if "psnr" in results else []
            raise ps.PeriscopyError(f"--at {axis}: {did_you_mean(axis, axes) or 'no such axis'}")
        values: list[Any] = results[axis].values.tolist()
        matches = [[each for each in values if each in (t, number_of(t))] for t in texts]
        kept = [*dict.fromkeys(each for match in matches for each in match)]
        if not all(matches):
            text = ",".join(texts)
            raise ps.PeriscopyError(f"--at {axis}={text}: there are {', '.join(map(str, values))}")
        results = results.sel({axis: kept})
    return results.assign_attrs(held=[*at])


def _lacking(results: "xr.Dataset") -> "xr.DataArray":
    """Return which results are missing."""
    metric = next(str(n) for n in results.data_vars if str(n).startswith("mean_squared_error"))
    return results[metric].isnull() & (results["failure"] == "")


def _begun(results: "xr.Dataset") -> dict[str, Any]:
    """Return the values of each axis that have results."""
    lacks = _lacking(results)
    return {
        str(axis): results[axis].values[~lacks.all([each for each in lacks.dims if each != axis])]
        for axis in lacks.dims
    }


def _complete(results: "xr.Dataset", asked: Mapping[str, Sequence[Any]]) -> "xr.Dataset":
    """Return results without values that no run has got to; a PeriscopyError if others lack.

    A line counts those that the last sweep asked for.
    """
    lacks = _lacking(results)
    if lacks.all():
        raise ps.PeriscopyError("the sweep has no result yet; run it again, it goes on")
    last = lacks.sel({n: [v for v in lacks[n].values if v in of] for n, of in asked.items()})
    if left := int(last.sum()):
        output.say(f"{left} of {last.size} results are missing: run the same 'periscopy sweep'")
    results = results.sel(_begun(results))
    if left := int((lacks := _lacking(results)).sum()):
        raise ps.PeriscopyError(
            f"{left} of {lacks.size} results are missing; run the same 'periscopy sweep' "
            "again, which goes on, or hold some values by --at"
        )
    return results
