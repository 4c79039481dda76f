"""A calibration, its residual and where each parameter ended; a silhouette and its image."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.calibration.result import DeterminedBy
from periscopy_sim.figures.panels import show, show_light, show_signed
from periscopy_sim.figures.style import OKABE_ITO, drawn
from periscopy_sim.model.residual import percentages, with_error
from periscopy_sim.numerics import Array

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration
    from periscopy_sim.calibration.silhouette.result import Silhouette

_COLOURS = {
    DeterminedBy.PHOTOGRAPH: OKABE_ITO[1],
    DeterminedBy.PHOTOGRAPH_ALONE: OKABE_ITO[4],
    DeterminedBy.RULER: "0.55",
    DeterminedBy.NOTHING: "0.55",
}


def draw_calibration(
    path: Path,
    photograph: Array,
    calibration: "Calibration",
    units: Mapping[str, str],
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, its residual before and after, rivals' images, and the parameters.

    The photograph is (rows, columns, 3), linear; `units` are those of the parameters that have one.
    """
    warning = 0.2 * (1 + 2 * len(calibration.doubts)) if calibration.doubts else 0.0
    images = _images(calibration)
    rows = [2.4 * len(images)] if images else []
    heights = [2.9 + warning, *rows, 1.1 + 0.22 * len(calibration.parameters)]
    with drawn(path, metadata) as figure:
        figure.set_size_inches(9.3, sum(heights))
        above, *middle, beneath = figure.subfigures(
            len(heights), 1, height_ratios=heights, squeeze=False
        )[:, 0]
        _draw_residuals(above.subplots(1, 3), photograph, calibration)
        if calibration.doubts:
            reasons = "\n".join(textwrap.fill(doubt, 120) for doubt in calibration.doubts)
            above.suptitle(f"NOT TO BE TRUSTED\n{reasons}", color="#cb181d")
        probabilities = [rival.probability for rival in calibration.rivals]
        for part in middle:
            axes = part.subplots(len(images), len(calibration.images), squeeze=False)
            for row, (name, shown) in zip(axes, images.items(), strict=True):
                shares = zip(row, shown, [1 - sum(probabilities), *probabilities], strict=True)
                for k, (ax, image, share) in enumerate(shares):
                    place = "aside" if k else "calibrated"
                    show_light(ax, f"{name} {place} ({100 * share:.0f} %)", image)
        _draw_parameters(beneath.subplots(), calibration, units)


def _images(calibration: "Calibration") -> dict[str, list[Array]]:
    """Return, by surface, the images of the calibrated scene and of its rivals, if it has any."""
    each = [i if isinstance(i, Mapping) else {"image": i} for i in calibration.images]
    return {name: [images[name] for images in each] for name in (each[0] if each else ())}


def _draw_residuals(axes: Any, photograph: Array, calibration: "Calibration") -> None:
    """Show the photograph and the mean residual over its channels, in percent, twice."""
    times = "at the start", "after calibration"
    residuals = calibration.residual_before, calibration.residual
    numbers = percentages(*calibration.unexplained)
    maps = {
        f"unexplained {time}: {number} %": 100 * residual.mean(axis=2)
        for time, number, residual in zip(times, numbers, residuals, strict=True)
    }
    show_light(axes[0], "photograph", photograph)
    show_signed(axes[1:], maps, "% of the photograph's root mean square")


def _draw_parameters(ax: Any, calibration: "Calibration", units: Mapping[str, str]) -> None:
    """Show values and errors over those of the ruler, a row each, and the fine descents' path."""
    parameters = calibration.parameters
    rows = np.arange(len(parameters))
    numbers = [(p.start, p.ruler_error, p.value, p.standard_error) for p in parameters]
    starts, errors, values, widths = np.array(numbers).T
    path = (np.concatenate(calibration.path[-2:])[:, :-1] - starts) / errors
    ax.axvspan(-1, 1, color="0.93", label="± standard error of the measured value")
    ax.axvline(0, color="black", linewidth=0.8)
    search = {"color": OKABE_ITO[0], "ms": 3, "zorder": 3, "label": "search"}
    ax.plot(path.ravel(), np.tile(rows, len(path)), ".", **search)
    places, widths = (values - starts) / errors, widths / errors
    for source, colour in _COLOURS.items():
        kept = [k for k in rows if parameters[k].determined_by == source]
        if kept:
            look = {"fmt": "o", "color": colour, "markersize": 4, "capsize": 2}
            label = f"value ± standard error, {source}"
            ax.errorbar(places[kept], kept, xerr=widths[kept], label=label, **look)
    names = [
        f"{p.name} = {with_error(p.value, p.standard_error, units.get(p.name, ''))}"
        for p in parameters
    ]
    ax.set_yticks(rows, names)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlabel("value − measured value, over the measured value's standard error")
    ax.figure.legend(loc="outside upper center", ncols=3)


def draw_silhouette(
    path: Path, photograph: Array, solution: "Silhouette", metadata: Mapping[str, str] | None = None
) -> None:
    """Draw the photograph, the mask as seen facing the wall, each image, and the residual.

    The photograph is (rows, columns, 3), linear.
    """
    residual = 100 * solution.residual.mean(axis=2)
    with drawn(path, metadata) as figure:
        image = solution.image
        images = image if isinstance(image, Mapping) else {"image": image}
        figure.set_size_inches(9 + 3 * len(images), 3.4)
        axes = figure.subplots(1, 3 + len(images))
        show_light(axes[0], "photograph", photograph)
        cells = np.where(solution.opaque, 0.1, np.where(solution.seen, 1.0, 0.8))
        height, width = solution.plane.sides
        title = "silhouette of {}, {} x {}".format(solution.name, *solution.opaque.shape)
        show(axes[1], title, cells, cmap="gray", vmin=0, vmax=1, extent=(0, width, 0, height))
        axes[1].set_axis_on()
        axes[1].set_xlabel("metres, facing the wall; grey: no shadow in view")
        for ax, (name, image) in zip(axes[2:-1], images.items(), strict=True):
            show_light(ax, f"{name} with this silhouette", image)
        title = f"unexplained: {100 * solution.unexplained:.2f} %"
        show_signed(axes[-1:], {title: residual}, "% of the photograph's rms")
        figure.suptitle("\n".join(solution.doubts), color="#cb181d")
