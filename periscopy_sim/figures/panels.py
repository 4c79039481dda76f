"""Pictures of images, maps and errors, side by side."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.style import drawn, mpl, plain_ticks
from periscopy_sim.numerics import Array, Image
from periscopy_sim.storage.formats.srgb import srgb_encode
from periscopy_sim.storage.pictures import write_png

if TYPE_CHECKING:
    from periscopy_sim.model.residual import Residual


Panels: TypeAlias = Sequence[tuple[str, Image]]
"""Titles and pictures, side by side."""

Rows: TypeAlias = Panels | Mapping[str, Panels]
"""One row of panels, or rows by their names."""


LONGEST = 4.0
"""Ratio of sides up to which pictures keep theirs; the patches of a longer one are stretched."""


WIDEST = 7.2
"""Inches of a page: wider pictures would print with letters below 6 points."""

CERTAINTY = 0.3, 100.0
"""Ends of the scale of standard errors, in percent of white."""


def displayable(image: Image, white: float | None = None) -> NDArray[np.float64]:
    """Scale a linear image for display: negatives and NaN black, `white` white.

    Return (..., 3) in [0, 1], still linear. A `white` of None is the 99.5th percentile. One factor
    serves all channels, so that colours stay. Grey is repeated; of more than three channels the
    first three are shown.
    """
    values = np.asarray(image, np.float64)
    level = float(np.nanpercentile(values, 99.5)) if white is None else white
    shown = values[..., :3] if values.shape[-1] >= 3 else values.mean(axis=-1, keepdims=True)
    light = np.nan_to_num(np.clip(shown / (level if level > 0 else 1.0), 0, 1))
    return np.broadcast_to(light, (*light.shape[:-1], 3))


def common_white(images: Iterable[Image]) -> float:
    """Return one white for several images of one unit: `displayable`'s, of all their values."""
    return float(np.nanpercentile(np.concatenate([np.ravel(image) for image in images]), 99.5))


def write_enlarged(path: Path, image: Image, text: Mapping[str, str]) -> None:
    """Write linear light by `write_png`, patches repeated to about 720 pixels across in all."""
    rows, columns = image.shape[:2]
    tall = int(np.ceil(columns / rows / LONGEST))  # of a strip
    write_png(path, np.repeat(image, tall, axis=0), text, max(1, 720 // columns))


def show(ax: Any, title: str, picture: NDArray[Any], **colours: Any) -> Any:
    """Show (rows, columns, 3) in sRGB or (rows, columns) in false colour, pixel by pixel.

    Pixels are square, but for those of a strip, see `LONGEST`, which has a frame with an axis.
    What is transparent, or NaN, is hatched. The false colours are as `imshow` takes them. Return
    the image, for a colour bar.
    """
    ax.set_title(title)
    ax.set_axis_off()
    aspect = picture.shape[1] / picture.shape[0] / proportions(picture)
    if not np.isclose(aspect, 1):
        ax.set_axis_on()
        ax.spines[:].set_visible(True)
        for axis, size in zip((ax.yaxis, ax.xaxis), picture.shape, strict=False):
            axis.set_visible(size > 1)
    if picture.shape[2:] == (4,) or (picture.ndim == 2 and np.isnan(picture).any()):
        ax.add_patch(_hatched(transform=ax.transAxes, zorder=-1))  # behind it
    return ax.imshow(picture, interpolation="nearest", aspect=aspect, **colours)


def _hatched(**settings: Any) -> Any:
    look = {"facecolor": "0.85", "edgecolor": "0.55", "hatch": "////////", "linewidth": 0}
    return mpl.patches.Rectangle((0, 0), 1, 1, **look, **settings)


def hatching() -> NDArray[np.uint8]:
    """Return the hatching of `show` as a tile, (72, 72, 4) RGBA, for pictures in a browser."""
    figure = mpl.figure.Figure((1, 1), dpi=72)  # the hatching has a period of an inch
    figure.add_artist(_hatched())
    canvas = mpl.backends.backend_agg.FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())


def proportions(picture: NDArray[Any]) -> float:
    """Return the width of a picture over its height as it is drawn; a strip is stretched."""
    return float(np.clip(picture.shape[1] / picture.shape[0], 1 / LONGEST, LONGEST))


def show_light(ax: Any, title: str, image: Image, white: float | None = None) -> None:
    """Show linear light, (rows, columns, 3), exposed by `displayable`; NaN is hatched."""
    show(ax, title, encoded(image, white))


def encoded(image: Image, white: float | None) -> NDArray[np.float64]:
    """Return light exposed by `displayable`, in sRGB; with a fourth channel, 0 where NaN is."""
    known = ~np.isnan(np.asarray(image, np.float64)).any(axis=-1, keepdims=True)
    picture = srgb_encode(displayable(image, white))
    return picture if known.all() else np.concatenate([picture, known], axis=-1)


def show_signed(
    axes: Sequence[Any], maps: Mapping[str, Image], unit: str, bound: float = 0.0
) -> None:
    """Show maps, (rows, columns), by their titles, red above 0 and blue below, with a colour bar.

    Colours end at `bound` either way, or at the first map's 99th percentile; NaN is hatched.
    """
    bound = bound or float(np.percentile(np.abs(next(iter(maps.values()))), 99)) or 1.0
    colours = mpl.colormaps["RdBu_r"].with_extremes(bad=(0, 0, 0, 0))
    for ax, (title, values) in zip(axes, maps.items(), strict=True):
        picture = show(ax, title, values, cmap=colours, vmin=-bound, vmax=bound)
    axes[0].figure.colorbar(picture, ax=list(axes), shrink=0.8, label=unit)


def show_rows(figure: Any, rows: Rows, height: float) -> None:
    """Show pictures, (rows, columns, 3) in sRGB, side by side under their titles, in named rows.

    The figure becomes as large as pictures of `height` inches need, but no wider than a page. A
    single row has no name.
    """
    named = rows if isinstance(rows, Mapping) else {"": rows}
    aspects = {name: [proportions(p) for _, p in panels] for name, panels in named.items()}
    height = min(height, *((WIDEST - 0.2) / sum(each) for each in aspects.values()))
    width = height * max(sum(each) for each in aspects.values())
    figure.set_size_inches(width + 0.2, len(named) * (height + 0.4))
    parts = [figure]
    if len(named) > 1:
        parts = figure.subfigures(len(named), 1)
    for part, (name, panels) in zip(parts, named.items(), strict=True):
        axes = part.subplots(1, len(panels), width_ratios=aspects[name], squeeze=False)[0]
        for ax, (title, picture) in zip(axes, panels, strict=True):
            show(ax, title, picture)
        if len(named) > 1:
            part.supylabel(name)


def draw_panels(
    path: Path,
    panels: Rows,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images, (rows, columns, channels) in [0, 1], side by side under their titles.

    NaN is hatched.

    The panels are one row, or rows by their names.
    """
    named = panels if isinstance(panels, Mapping) else {"": panels}
    encoded = {
        name: [(title, encoded(image, 1)) for title, image in row] for name, row in named.items()
    }
    with drawn(path, metadata) as figure:
        show_rows(figure, encoded, 2.6)
        if caption:
            width, height = figure.get_size_inches()
            figure.set_size_inches(width, height + 0.1 + 0.15 * len(caption.split("\n")))
            figure.supxlabel(caption)


def draw_bounds(
    path: Path,
    alone: Mapping[str, Array],
    both: Mapping[str, Array],
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw bounds of the standard errors of patches, by A alone and by [A, B], and their ratio.

    All are (R, C), by the surfaces' ids, white being 1.
    """
    values = 100 * np.concatenate(
        [np.ravel(each) for maps in (alone, both) for each in maps.values()]
    )
    norm = mpl.colors.LogNorm(float(values.min()), float(values.max()))
    aspects = [each.shape[0] / each.shape[1] for each in alone.values()]
    with drawn(path, metadata) as figure:
        figure.set_size_inches(WIDEST, 2.1 * sum(aspects) + 0.9 + 0.3 * len(alone))
        axes = figure.subplots(len(alone), 3, squeeze=False, height_ratios=aspects)
        for line, name in zip(axes, alone, strict=True):
            maps = {"A alone": 100 * alone[name], "[A, B]": 100 * both[name]}
            for ax, (title, percent) in zip(line, maps.items(), strict=False):
                bounds = show(ax, title, percent, norm=norm, cmap="viridis")
            ratio = show(line[2], "[A, B] over A alone", both[name] / alone[name], vmin=1)
            figure.colorbar(ratio, ax=line[2], shrink=0.8, label="ratio")
            if len(alone) > 1:
                line[0].text(0, 1.2, name, transform=line[0].transAxes)
        bar = figure.colorbar(
            bounds, ax=axes[:, :2], label="standard error, % of white", shrink=0.8
        )
        plain_ticks(bar.ax.yaxis)
        figure.supxlabel(caption)


def draw_certainty(
    path: Path,
    images: Mapping[str, Image],
    standard_errors: Mapping[str, Image],
    assumed: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw reconstructions beside the standard errors of their patches, and their assumption.

    Both are (R, C, 3) by the surfaces' ids, in one unit; the errors are shown as the root mean
    square over the channels, in percent of the 99th percentile of all images, on one scale for
    all pictures: bright is certain.
    """
    white = float(np.percentile(np.concatenate([np.ravel(f) for f in images.values()]), 99)) or 1.0
    width = min(max(5.2 * max(map(proportions, images.values())) + 1.0, 4.5), WIDEST)
    colours = {"cmap": "magma_r", "norm": mpl.colors.LogNorm(*CERTAINTY)}
    with drawn(path, metadata) as figure:
        figure.set_size_inches(width, 0.6 + 2.8 * len(images))
        axes = figure.subplots(len(images), 2, squeeze=False)
        for (left, right), (name, image) in zip(axes, images.items(), strict=True):
            show_light(left, name if len(images) > 1 else "reconstruction", image, white)
            error = np.sqrt(np.mean(np.asarray(standard_errors[name]) ** 2, axis=2))
            shown = show(right, "certainty", 100 / white * error, **colours)
        label = "standard error, % of white"
        bar = figure.colorbar(shown, ax=axes[:, 1], shrink=0.9, label=label, extend="both")
        bar.set_ticks(ticks := [0.3, 1, 3, 10, 30, 100], labels=[f"{each:g}" for each in ticks])
        bar.ax.minorticks_off()
        bar.ax.invert_yaxis()
        sentences = ["Right: the standard error of each patch (one standard deviation)."]
        sentences += [f"This assumes that {assumed}."] * bool(assumed)
        figure.supxlabel("\n".join(fill(each, int(16 * width)) for each in sentences))


def draw_residual(
    path: Path,
    photograph: Array,
    residual: "Residual",
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a photograph, (rows, columns, 3), linear, beside its residual; see `Residual`."""
    values, bound, unit = residual_map(residual)
    with drawn(path, metadata) as figure:
        figure.set_size_inches(6.4 * values.shape[1] / values.shape[0] + 1.3, 3.6)
        axes = figure.subplots(1, 2)
        unused = np.isnan(values)[..., np.newaxis]
        show_light(axes[0], "photograph", np.where(unused, np.nan, photograph))
        show_signed(axes[1:], {"unexplained": values}, unit, bound)
        figure.supxlabel(caption)


def residual_map(residual: "Residual") -> tuple[Array, float, str]:
    """Return the map of a residual, (rows, columns), the bound of its colours, and its unit.

    The map is the mean over the channels, divided by the standard deviation of its noise, or, if
    noise is not known, in percent of the photograph's root mean square. Masked pixels are NaN.
    """
    level = float(np.sqrt(np.nanmean(residual.light**2))) / (residual.unexplained or 1) or 1.0
    values, unit, least = residual.light.mean(axis=2) / level, "standard deviations of noise", 4.0
    if residual.noise_alone:  # at 4 deviations or more, noise alone looks pale
        values *= np.sqrt(residual.light.shape[2]) / residual.noise_alone
    else:
        values, unit, least = 100 * values, "% of the photograph's root mean square", 0.0
    return values, max(least, float(np.nanpercentile(np.abs(values), 99))) or 1.0, unit
