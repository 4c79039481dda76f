"""`periscopy plot`: a figure or a table of a sweep."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from periscopy_sim.cli import options
from periscopy_sim.cli.options import OUTPUT, argument, option
from periscopy_sim.cli.output import output_files, say
from periscopy_sim.errors import OutputError, PeriscopyError, did_you_mean
from periscopy_sim.evaluation.sweep_store import read_sweep
from periscopy_sim.extras import SWEEP, require_all
from periscopy_sim.figures.style import COLUMN, PAGE
from periscopy_sim.figures.sweeps import draw_sweep, labelled, latex_of, surfaces_of, table_of
from periscopy_sim.numerics.limits import number_of
from periscopy_sim.storage.outputs.store import attributes_of

if TYPE_CHECKING:
    import xarray as xr

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
_WIDTH = f"{COLUMN:g} for a column, {PAGE:g} for a page."
_OUT = "PNG, PDF or SVG for a figure, TEX or CSV for a table."
PICTURES, TABLES = (".png", ".pdf", ".svg"), (".tex", ".csv")


def plot(
    folder: Annotated[Path, argument("SWEEP", _SWEEP, parser=options.place_of)],
    out: Annotated[Path, option("FILE", _OUT, group=OUTPUT)],
    metric: Annotated[str, option("NAME", _METRIC)] = "psnr",
    over: Annotated[str, option("AXIS", _OVER)] = "",
    panels: Annotated[str, option("AXIS", _PANELS)] = "",
    at: Annotated[list[str] | None, option("NAME=VALUES", _AT)] = None,
    label: Annotated[list[str] | None, option("NAME=WORDS", _LABEL)] = None,
    reference: Annotated[str, option("METHOD", _REFERENCE)] = "",
    width: Annotated[float, option("INCHES", _WIDTH, kind="inches")] = COLUMN,
) -> None:
    """Draw what the last sweep asked for, or write its table."""
    require_all(*SWEEP)
    if out.suffix in TABLES and (over or panels):
        raise PeriscopyError("--over and --panels are of figures: a table has a row for each value")
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
        raise PeriscopyError(f"{folder}: holds no sweep; name a folder of 'periscopy sweep'")
    asked = {name: values for name, values in store.get("asked", {}).items() if name not in texts}
    if reference and axis in asked:
        kept = [*asked[axis], *(v for v in store["axes"][axis] if v in (value, number_of(value)))]
        asked[axis] = [*dict.fromkeys(kept)]
    results = _complete(_held(read_sweep(folder / "sweep.zarr", asked), texts))
    if others := [each for each in asked if len(asked[each]) < len(store["axes"][each])]:
        say(
            f"as the last sweep asked; {folder} holds more values of {', '.join(others)}, which "
            "--at NAME=VALUES draws"
        )
    if reference:
        from periscopy_sim.evaluation.statistics import differences

        results = differences(results, surfaces_of(results, metric), value, axis)
    results = labelled(results, metric, options.parse_definitions(label, "--label"))
    with output_files(out) as (file,):
        if out.suffix == ".csv":
            table_of(results, metric).to_csv(file, index=False, lineterminator="\n")
        elif out.suffix == ".tex":
            file.write_text(latex_of(results, metric, f"tab:{out.stem}"), "utf-8")
        else:
            say(draw_sweep(file, results, metric=metric, over=over, panels=panels, width=width))


def _held(results: "xr.Dataset", at: Mapping[str, Sequence[str]]) -> "xr.Dataset":
    """Return results at values of some axes, written as texts."""
    for axis, texts in at.items():
        if axis not in results.coords:
            axes = [str(name) for name in results.psnr.dims] if "psnr" in results else []
            raise PeriscopyError(f"--at {axis}: {did_you_mean(axis, axes) or 'no such axis'}")
        values: list[Any] = results[axis].values.tolist()
        matches = [[each for each in values if each in (t, number_of(t))] for t in texts]
        kept = [*dict.fromkeys(each for match in matches for each in match)]
        if not all(matches):
            text = ",".join(texts)
            raise PeriscopyError(f"--at {axis}={text}: there are {', '.join(map(str, values))}")
        results = results.sel({axis: kept})
    return results.assign_attrs(held=[*at])


def _complete(results: "xr.Dataset") -> "xr.Dataset":
    """Return results without values that no run has got to; a PeriscopyError if others lack."""
    metric = next(str(n) for n in results.data_vars if str(n).startswith("mean_squared_error"))
    lacks = results[metric].isnull() & (results["failure"] == "")
    begun = {
        axis: results[axis].values[~lacks.all([each for each in lacks.dims if each != axis])]
        for axis in lacks.dims
    }
    if lacks.all():
        raise PeriscopyError("the sweep has no result yet; run it again, it goes on")
    if left := int(lacks.sum()):
        say(f"{left} of {lacks.size} results are not there yet: run the same 'periscopy sweep'")
    results, lacks = results.sel(begun), lacks.sel(begun)
    if left := int(lacks.sum()):
        raise PeriscopyError(
            f"{left} of {lacks.size} results are missing; run the same 'periscopy sweep' "
            "again, which goes on, or hold some values by --at"
        )
    return results
