"""Sweeps as figures: a metric of each method over one axis, in small multiples over another."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.figures.style import COLUMN, LETTERS, OKABE_ITO, drawn, mpl, plain_ticks, wrapped

if TYPE_CHECKING:
    import xarray as xr

MARKERS, DASHES = "os^DvPX", ("-", "--", "-.", (0, (1, 1.2)))

NAMES = {
    "psnr": "PSNR", "psnr_registered": "registered PSNR",
    "mean_squared_error": "mean squared error", "ssim": "structural similarity",
    "sbr": "signal-to-background ratio", "snr": "signal-to-noise ratio", "hidden": "patches",
    "samples": "rays to a patch", "background": "place", "seed": "noise draw",
    "assumed": "what methods know of the scene", "trusted": "trusted calibrations",
    "psnr_plain": "PSNR without a gain",
    "covered_1": "patches within a standard error", "covered_2": "patches within two",
    "within_1": "numbers within a standard error", "within_3": "numbers within three",
}  # fmt: skip
"""Metrics and axes in words."""

SHORT = {"sbr": "SBR", "snr": "SNR"}
"""Axes in titles."""


def draw_sweep(
    path: Path,
    results: "xr.Dataset",
    *,
    metric: str = "psnr",
    over: str = "",
    panels: str = "",
    width: float = COLUMN,
    metadata: Mapping[str, str] | None = None,
) -> str:
    """Draw a metric of each method over one axis, as in Fig. 4; return the figure's caption.

    Parameters
    ----------
    path
        A PNG, PDF or SVG file.
    results
        From `run_sweep`. Axes that are neither drawn nor of samples stay at their middle value,
        which the figure says.
    metric
        A variable of the results; of several surfaces each has a panel.
    over, panels
        The axis that is drawn over, and one of which each value has a panel; the first ones that
        have several values, if they are empty.
    width
        Inches: 3.5 for a column, 7.2 for a page.
    metadata
        Text of a PNG.

    Raises
    ------
    PeriscopyError
        If there is no such metric or axis.
    """
    from periscopy_sim.evaluation.statistics import UNITS, interval

    surfaces = surfaces_of(results, metric)
    dims = [str(axis) for axis in results[surfaces[0]].dims if axis != "algorithm"]
    free = [axis for axis in dims if axis not in UNITS and results.sizes[axis] > 1]
    free.sort(key=lambda axis: (-results.sizes[axis], axis != "sbr"))
    over = over or next((axis for axis in free if axis != panels), "sbr")
    few = [axis for axis in free if results.sizes[axis] <= len(ascii_lowercase)]
    panels = panels or next((axis for axis in few if axis != over), "")
    for axis in filter(None, (over, panels)):
        if axis not in dims:
            guess = did_you_mean(axis, dims) or f"there are {', '.join(dims)}"
            raise PeriscopyError(f"no axis '{axis}' in the sweep; {guess}")
    if over == panels:
        raise PeriscopyError(f"axis '{over}' has the panels already; draw over another one")
    if results[over].dtype.kind in "fiu":
        results = results.sortby(over)
    results = _in_millimetres(results)
    fixed = {
        axis: results[axis].values[(results.sizes[axis] - 1) // 2]
        for axis in free if axis not in (over, panels)
    }  # fmt: skip
    parts = [
        (title, interval(part[surface].sel(fixed), [over, panels], part["failure"].sel(fixed)))
        for surface in surfaces
        for title, part in _parts(results, panels, surface[len(metric) + 1 :])
    ]
    if len(parts) > len(ascii_lowercase):
        raise PeriscopyError(f"{len(parts)} panels of {panels} are too many; draw fewer values")
    rows = -(-len(parts) // (2 if width < 2 * COLUMN else 4))
    columns = -(-len(parts) // rows)
    if not any(means["mean"].notnull().any() for _, means in parts):
        why = next(filter(None, results["failure"].values.ravel().tolist()), "no value")
        raise PeriscopyError(f"nothing to draw, all failed: {why}")
    some = any(((part["failed"] > 0) & part["mean"].notnull()).any() for _, part in parts)
    held = "; open markers: means of the rest" * some
    held += f"; panels: {panels}" if _is_long(panels) else ""
    caption = _caption([means for _, means in parts]) + held + _held(results, fixed, [over, panels])
    room, methods = 0.7 * width / columns, results.attrs.get("algorithms", [])
    least = min(float(means["mean"].min()) for _, means in parts)
    lowest = min(float((means["mean"] - means["half"].fillna(0)).min()) for _, means in parts)
    is_log = metric == "mean_squared_error" and least > 0
    # The lowest mean limits the axis, because an interval may reach 0.
    bottom = max(least / 3, 0.8 * lowest) if is_log else -np.inf
    if lowest < bottom:
        caption += "; triangles: intervals that reach lower"
    with drawn(path, metadata if path.suffix == ".png" else None, caption) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for ax in grid.flat[len(parts) :]:
            ax.axis("off")
        for ax, letter, (title, means) in zip(grid.flat, ascii_lowercase, parts, strict=False):
            _draw(ax, means, over, methods or means["algorithm"].values.tolist(), room, bottom)
            if len(parts) > 1:
                ax.set_title(f"{letter}  {title}", loc="left")
        if is_log:
            grid[0, 0].set_yscale("log")
            grid[0, 0].set_ylim(bottom=bottom)
            plain_ticks(grid[0, 0].yaxis)
        else:
            grid[0, 0].yaxis.set_major_locator(mpl.ticker.MaxNLocator(5, min_n_ticks=4))
        for ax in grid.flat[len(grid.flat) - columns : len(parts)]:
            ax.set_xlabel(wrapped(words_of(results[over], over), room))
        handles = grid[0, 0].get_legend_handles_labels()
        longest = 8 + max(map(len, handles[1]), default=0)  # with its line
        abreast = min(max(1, int(LETTERS * width / longest)), len(handles[1]))
        figure.legend(*handles, loc="outside upper center", ncols=abreast, handlelength=2.8)
        height = 0.2 + 0.13 * -(-len(handles[1]) // abreast)
        longest = max(
            [len(each) for each in results[over].values if isinstance(each, str)], default=0
        )
        height += (0.45 + 0.6 * width / columns + 0.04 * longest) * len(grid)
        figure.supylabel(wrapped(words_of(results[surfaces[0]], metric), 0.7 * height))
        figure.set_size_inches(width, height)
    return caption


def table_of(results: "xr.Dataset", metric: str) -> Any:
    """Return a pandas table: a row for each method and values of all axes but those of samples.

    Beside the axes that have several values it has the metric, its unit, what it is compared with,
    ``mean`` and ``half_95``, half the length of the 95 % confidence interval, and the numbers of
    `periscopy_sim.evaluation.statistics.interval`; of several surfaces the surface, too.
    """
    import xarray as xr

    from periscopy_sim.evaluation.statistics import LEVEL, interval

    surfaces = surfaces_of(results, metric)
    intervals = [interval(results[name], (), results["failure"]) for name in surfaces]
    means = xr.concat(intervals, "surface")
    labels = [name[len(metric) + 1 :] for name in surfaces]
    table = means.assign_coords(surface=labels).to_dataframe().reset_index()
    table = table[table["mean"].notna() | (table["failed"] > 0)]
    single = [n for n in map(str, means.dims) if n != "algorithm" and means.sizes[n] == 1]
    table = table.drop(columns=single).rename(columns={"half": f"half_{100 * LEVEL:g}"})
    of = results[surfaces[0]].attrs
    notes = {"metric": metric, "unit": of.get("units", "1"), "minus": of.get("minus", "")}
    for place, (name, text) in enumerate(notes.items(), table.columns.get_loc("mean")):
        table.insert(place, name, text)
    return table


def latex_of(results: "xr.Dataset", metric: str, label: str) -> str:
    """Return a LaTeX table, a column for each method: means with 95 % confidence intervals.

    A mean without some results that failed says of how many it is. The table has a label, and needs
    the package booktabs.
    """
    from periscopy_sim.evaluation.statistics import LEVEL, UNITS, interval

    surfaces, results = surfaces_of(results, metric), _in_millimetres(results)
    table, half = table_of(results, metric), f"half_{100 * LEVEL:g}"
    units = [axis for axis in UNITS if axis in results["failure"].dims]
    size = math.prod(results.sizes[axis] for axis in units)
    middle = table[half].median()
    digits = 3 if np.isnan(middle) else int(np.clip(1 - np.floor(np.log10(middle or 1)), 0, 9))

    def text(row: Any) -> str:
        within = "" if np.isnan(row[half]) else f" \\pm {row[half]:.{digits}f}"
        mark = f" ({size - row['failed']} of {size})" * bool(row["failed"])
        return "failed" if np.isnan(row["mean"]) else f"${row['mean']:.{digits}f}{within}${mark}"

    axes = [*table.columns[: table.columns.get_loc("metric")]]
    cells = table.assign(text=[text(row) for _, row in table.iterrows()])
    cells[axes] = cells[axes].map(_escaped)
    cells = cells.set_index(axes)["text"]
    cells = cells.unstack("algorithm", sort=False) if len(axes) > 1 else cells.to_frame().T
    cells = cells.reset_index(drop=len(axes) == 1).rename_axis(columns=None)
    words = {a: words_of(results[a], a) for a in axes if a in results.coords and a != "algorithm"}
    caption = _caption([interval(results[n], (), results["failure"]) for n in surfaces])
    caption = f"{words_of(results[surfaces[0]], metric)}: {caption}{_held(results, {}, axes)}"
    sides = ("rl"[name in axes and cells[name].dtype.kind not in "if"] for name in cells)
    latex = cells.rename(columns={name: _escaped(each) for name, each in words.items()}).to_latex(
        index=False, na_rep="", float_format="%g", escape=False, position="tb",
        column_format="".join(sides),
        caption=_escaped(caption), label=re.sub(r"[^\w:.-]", "-", label),
    )  # fmt: skip
    return f"% needs \\usepackage{{booktabs}}\n{latex}"


def _escaped(text: Any) -> Any:
    """Return text whose characters mean themselves to LaTeX; other things as they are."""
    signs = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    if not isinstance(text, str):
        return text
    return re.sub(r"[\\~^%_&#${}]", lambda each: signs.get(each[0], rf"\{each[0]}"), text)


def labelled(results: "xr.Dataset", metric: str, labels: Mapping[str, str]) -> "xr.Dataset":
    """Return results with words of a person's own for axes, methods and the metric.

    A PeriscopyError says that there is nothing of a name.
    """
    surfaces, methods = surfaces_of(results, metric), results["algorithm"].values.tolist()
    every = results.attrs.get("algorithms", methods)  # also what all is compared with
    axes = [name for name in map(str, results["failure"].dims) if name != "algorithm"]
    known = [*dict.fromkeys([*axes, metric, *every])]
    for name, words in labels.items():
        if name not in known:
            guess = did_you_mean(name, known) or f"there are {', '.join(known)}"
            raise PeriscopyError(f"nothing called '{name}' in the sweep; {guess}")
        for each in surfaces if name == metric else {name} & {*axes}:
            results[each].attrs["label"] = words
    for each in surfaces:
        if (minus := results[each].attrs.get("minus")) in labels:
            results[each].attrs["minus"] = labels[minus]
    named = [labels.get(name, name) for name in methods]
    if len({*named}) < len(named):
        raise PeriscopyError("two methods have one label; give each its own")
    results = results.assign_coords(algorithm=named)
    return results.assign_attrs(algorithms=[labels.get(name, name) for name in every])


def _in_millimetres(results: "xr.Dataset") -> "xr.Dataset":
    """Return results whose axes of short lengths are in millimetres."""
    for axis in map(str, results["failure"].dims):
        is_length = results[axis].attrs.get("units") == "m"
        if is_length and float(abs(results[axis]).max()) < 0.1:
            millimetres = results[axis].copy(data=1e3 * results[axis].values)
            attributes = results[axis].attrs | {"units": "mm"}
            results = results.assign_coords({axis: millimetres.assign_attrs(attributes)})
    return results


def _held(results: "xr.Dataset", fixed: Mapping[str, Any], shown: Sequence[str]) -> str:
    """Return in words the values that all is of: fixed ones, and those held of axes not shown."""
    held = (axis for axis in results.attrs.get("held", ()) if axis not in shown)
    values = {**{axis: results[axis].values for axis in held}, **fixed}
    return "".join(
        f"; {', '.join(_said(results[a], a, value) for value in np.ravel(each).tolist())}"
        + f" (one of {results.sizes[a]})" * (a in fixed)
        for a, each in values.items()
    )


def surfaces_of(results: "xr.Dataset", metric: str) -> list[str]:
    """Return the variables of a metric, of several surfaces one of each.

    A PeriscopyError says that there is none.
    """
    ends = [
        str(n).removeprefix("reconstruction") for n in results.data_vars if "reconstr" in str(n)
    ]
    names = [metric] if metric in results.data_vars else [f"{metric}{end}" for end in ends]
    known = [
        str(name) for name, each in results.data_vars.items()
        if each.dtype.kind == "f" and {*each.dims} == {*results["failure"].dims}
    ]  # fmt: skip
    if not (names and {*names} <= {*known}):
        guess = did_you_mean(metric, known) or f"there are {', '.join(known)}"
        raise PeriscopyError(f"no metric '{metric}' in the sweep; {guess}")
    return names


def _parts(results: "xr.Dataset", panels: str, surface: str) -> "Iterator[tuple[str, xr.Dataset]]":
    """Yield the title and the results of each panel."""
    if not panels:
        yield surface, results
        return
    for value in results[panels].values.tolist():
        title = _said(results[panels], panels, value)
        title = title.partition(" = ")[2] if _is_long(panels) else title
        yield f"{surface} {title}".strip(), results.sel({panels: value})


def _is_long(axis: str) -> bool:
    """Return whether an axis is too long for the title of each panel."""
    return len(SHORT.get(axis, axis)) > 8


def _said(axis: "xr.DataArray", name: str, value: Any) -> str:
    """Return an axis and its value in words."""
    unit = axis.attrs.get("units", "1").replace("1", "")
    is_number = isinstance(value, int | float | np.number)
    text = f"{value:g} {unit}".strip() if is_number else str(value)
    return f"{axis.attrs.get('label') or SHORT.get(name, name)} = {text}"


def _draw(
    ax: Any, means: "xr.Dataset", over: str, methods: Sequence[str], room: float, bottom: float
) -> None:
    """Draw each method's mean and interval over the values of an axis, where there are some.

    A method looks as its place among all of them says. The panel is `room` inches wide. An interval
    that reaches below the bottom ends there in a triangle.
    """
    all_looks = zip(cycle(OKABE_ITO), cycle(MARKERS), cycle(DASHES), strict=False)
    looks = dict(zip(methods, all_looks, strict=False))
    means = means.dropna(over, how="all", subset=["mean"])
    means = means.dropna("algorithm", how="all", subset=["mean"])
    values = means[over].values
    if not values.size:
        return
    if "minus" in means["mean"].attrs:
        ax.axhline(0, color="0.4", linewidth=0.8)
    is_number = values.dtype.kind in "fiu"
    is_text = not (is_number and np.isfinite(values).all())
    places = np.arange(len(values)) if is_text else values
    if is_text and is_number:  # an infinite SBR
        values = np.array(["no ambient light" if np.isinf(v) else f"{v:g}" for v in values])
    limits = means["mean"].attrs.get("valid_range") if "minus" not in means["mean"].attrs else None
    names = means["algorithm"].values.tolist()
    for k, name in enumerate(names):
        (colour, marker, dashes), of_method = looks[name], means.sel(algorithm=name)
        mean, half = (of_method[each].values.reshape(len(values)) for each in ("mean", "half"))
        low, high = (np.clip(each, *limits or (None, None)) for each in (mean - half, mean + half))
        look = {"marker": marker, "ms": 2.8, "color": colour, "label": name}
        x = places + 0.5 * (k - (len(names) - 1) / 2) / len(names) * is_text
        if is_text:  # nothing lies between two words
            ax.errorbar(x, mean, (mean - low, high - mean), ls="", capsize=2, lw=1, **look)
        else:
            ax.plot(x, mean, ls=dashes, **look)
            # The edge keeps the band of a single value in sight.
            within = np.maximum(low, bottom), high
            ax.fill_between(x, *within, color=colour, alpha=0.18, linewidth=0.8)
        look |= {"ls": "", "zorder": 3, "label": ""}
        some = np.isfinite(mean) & (of_method["failed"].values.ravel() > 0)
        if some.any():
            ax.plot(x[some], mean[some], mfc="white", **look)
        if (cut := low < bottom).any():
            ends = np.full(cut.sum(), bottom)
            ax.plot(
                x[cut], ends, clip_on=False, **look | {"marker": mpl.markers.CARETDOWN, "ms": 5}
            )
    if is_text:
        is_wide = sum(map(len, values)) + 2 * len(values) > LETTERS * room
        ax.set_xticks(places, values, rotation=50 * is_wide, ha="right" if is_wide else "center")
        ax.set_xlim(-0.5, len(values) - 0.5)
    elif (
        values.min() > 0 and values.max() >= 10 * values.min()
        and np.ptp(steps := np.diff(values)) > 1e-6 * np.max(steps)  # even ones are as they are
    ):  # fmt: skip
        ax.set_xscale("log")
        plain_ticks(ax.xaxis)
    elif len(values) <= 5:
        ax.set_xticks(values, [f"{value:.4g}" for value in values])
    else:
        ax.xaxis.set_major_locator(mpl.ticker.MaxNLocator(4))
    ax.grid(True, which="major")


def _caption(parts: "Sequence[xr.Dataset]") -> str:
    """Return what lines and bands are, how many samples there are, and how many failed."""
    from periscopy_sim.evaluation.statistics import counted

    names = dict.fromkeys(name for means in parts for name in means["algorithm"].values.tolist())
    left_out = {
        name: int(sum(means["failed"].sel(algorithm=name).sum() for means in parts))
        for name in names
    }
    failed = "".join(f"; {count} of {name} failed" for name, count in left_out.items() if count)
    number = counted(parts)
    what = "single values" if number == "1" else f"means, 95 % confidence intervals over {number}"
    return f"{what}{failed}"


def words_of(variable: "xr.DataArray", name: str) -> str:
    """Return a metric or an axis in words, with its unit."""
    unit, minus = variable.attrs.get("units", "1"), variable.attrs.get("minus", "")
    words = variable.attrs.get("label") or NAMES.get(name, name)
    if minus:
        return f"{words}{f' in {unit}' if unit != '1' else ''} minus that of {minus}"
    return f"{words}{f', {unit}' if unit != '1' else ''}"
