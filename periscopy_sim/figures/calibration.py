"""A calibration, its residual and where each parameter ended; a silhouette and its image."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.calibration.result import ParameterSource
from periscopy_sim.figures.panels import show, show_light, show_signed
from periscopy_sim.figures.style import COLUMN, LINE, OKABE_ITO, drawn, wrapped
from periscopy_sim.numerics import Array, validation
from periscopy_sim.storage.pictures import averaged_photograph

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration
    from periscopy_sim.calibration.silhouette import Silhouette
    from periscopy_sim.photograph import Photograph

WARNING = "#cb181d"

_COLOURS = {
    ParameterSource.PHOTOGRAPH: OKABE_ITO[1],
    ParameterSource.PHOTOGRAPH_ALONE: OKABE_ITO[4],
    ParameterSource.RULER: "0.55",
    ParameterSource.NOTHING: "0.55",
}


def draw_calibration(
    path: Path,
    photograph: "Photograph",
    calibration: "Calibration",
    units: Mapping[str, str],
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, its residual before and after, rivals' images, and the parameters.

    `units` are those of the parameters that have one.
    """
    doubts = ["DO NOT TRUST THIS CALIBRATION", *(f"• {each}" for each in calibration.doubts)]
    warning = wrapped("\n".join(doubts), COLUMN) if calibration.doubts else ""
    images = _images(calibration)
    heights = [1.3 + LINE * len(warning.split("\n"))]
    heights += [1.4 * len(images)] if images else []
    heights += [1.3 + 0.2 * len(calibration.parameters)]
    with drawn(path, metadata) as figure:
        figure.set_size_inches(COLUMN, sum(heights))
        above, *middle, beneath = figure.subfigures(
            len(heights), 1, height_ratios=heights, squeeze=False
        )[:, 0]
        _draw_residuals(above.subplots(1, 3), photograph, calibration)
        above.suptitle(warning, color=WARNING)
        probabilities = [rival.probability for rival in calibration.rivals]
        for part in middle:
            axes = part.subplots(len(images), len(calibration.images), squeeze=False)
            for row, (name, shown) in zip(axes, images.items(), strict=True):
                shares = zip(row, shown, [1 - sum(probabilities), *probabilities], strict=True)
                for k, (ax, image, share) in enumerate(shares):
                    place = "aside" if k else "calibrated"
                    title = f"{name} {place} ({100 * share:.0f} %)"
                    show_light(ax, wrapped(title, COLUMN / len(shown)), image)
        _draw_parameters(beneath.subplots(), calibration, units)


def _images(calibration: "Calibration") -> dict[str, list[Array]]:
    """Return, by surface, the images of the calibrated scene and of its rivals, if it has any."""
    each = [i if isinstance(i, Mapping) else {"image": i} for i in calibration.images]
    return {name: [images[name] for images in each] for name in (each[0] if each else ())}


def _draw_residuals(axes: Any, photograph: "Photograph", calibration: "Calibration") -> None:
    """Show the photograph and the mean residual over its channels, in percent, twice."""
    residuals = calibration.residual_before, calibration.residual
    numbers = validation.percentages(*calibration.unexplained)
    maps = {
        f"{time}\n{number} %": _percent(residual, photograph)
        for time, number, residual in zip(("start", "calibrated"), numbers, residuals, strict=True)
    }
    show_light(axes[0], "photograph", np.moveaxis(photograph.planes, 0, -1))
    show_signed(axes[1:], maps, "unexplained,\n% of rms")


def _percent(residual: Array, photograph: "Photograph") -> Array:
    """Return the mean of a residual over its channels, in percent; NaN outside the mask.

    The residual may have fewer pixels than the photograph.
    """
    used = averaged_photograph(photograph, residual.shape[:2]).pixels
    return np.where(used, 100 * residual.mean(axis=2), np.nan)


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
        kept = [k for k in rows if parameters[k].source == source]
        if kept:
            look = {"fmt": "o", "color": colour, "markersize": 4, "capsize": 2}
            label = f"value ± standard error: {source}"
            ax.errorbar(places[kept], kept, xerr=widths[kept], label=label, **look)
    names = [
        f"{p.name} = {validation.with_error(p.value, p.standard_error, units.get(p.name, ''))}"
        for p in parameters
    ]
    ax.set_yticks(rows, names)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlabel("(value − measured value) /\nits standard error")
    ax.figure.legend(loc="outside upper center")


def draw_silhouette(
    path: Path,
    photograph: "Photograph",
    solution: "Silhouette",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, its residual, the mask as seen facing the wall, and each image."""
    image = solution.image
    images = image if isinstance(image, Mapping) else {"image": image}
    lines = 1 + -(-(1 + len(images)) // 2)
    with drawn(path, metadata) as figure:
        figure.set_layout_engine("compressed")
        figure.set_size_inches(COLUMN, 1.75 * lines + 0.3 * len(solution.doubts))
        axes = figure.subplots(lines, 2)
        show_light(axes[0, 0], "photograph", np.moveaxis(photograph.planes, 0, -1))
        title = f"unexplained:\n{100 * solution.unexplained:.2f} %"
        show_signed(axes[0, 1:], {title: _percent(solution.residual, photograph)}, "% of rms")
        cells = np.where(solution.opaque, 0.1, np.where(solution.seen, 1.0, 0.8))
        height, width = solution.plane.sides
        mask, *others = axes[1:].flat
        title = "silhouette of {},\n{} x {}".format(solution.name, *solution.opaque.shape)
        show(mask, title, cells, cmap="gray", vmin=0, vmax=1, extent=(0, width, 0, height))
        mask.set_axis_on()
        mask.set_xlabel("metres, facing the wall;\ngrey: no shadow in view")
        for ax, (name, image) in zip(others, images.items(), strict=False):
            show_light(ax, f"{name} with\nthis silhouette", image)
        for ax in others[len(images) :]:
            ax.remove()
        figure.suptitle(wrapped("\n".join(solution.doubts), COLUMN), color=WARNING)
