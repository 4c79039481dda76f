"""Pictures of images, maps and errors, side by side."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures import style
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.storage import outputs, pictures, rasters

if TYPE_CHECKING:
    from periscopy_sim.model.residual import Residual

Pixels: TypeAlias = NDArray[np.uint8]

Panels: TypeAlias = Sequence[tuple[str, Image]]
"""Titles and pictures, side by side."""

Rows: TypeAlias = Panels | Mapping[str, Panels]
"""One row of panels, or rows by their names."""

LONGEST = 4.0
"""Ratio of sides up to which pictures keep theirs; the patches of a longer one are stretched."""

ABREAST, LEAST, TALLEST = 3, 0.8, 2.2
"""Panels side by side in a column, and inches that they are high at least, in the mean, and at
most."""

GAP, BAR = 0.08, 0.65
"""Inches between panels, and of a colour bar with its numbers and its label."""

NARROWER = 0.95
"""Fraction of a figure's width that panels have beside gaps and names."""

CERTAINTY = 0.3, 100.0
"""Ends of the scale of standard errors, in percent of white."""

STRIPES, GREYS = 8, (150, 217)
"""Pixels from one stripe of a hatching to the next, and its two greys."""


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


def exposed(image: Image, white: float | None = None) -> NDArray[np.float64]:
    """Return `displayable` light that is NaN where the image is: there, figures are hatched."""
    return np.where(_known(image)[..., None], displayable(image, white), np.nan)


def _known(image: Image) -> Mask:
    return np.asarray(~np.isnan(np.asarray(image, np.float64)).any(axis=-1))


def hatching(rows: int = STRIPES, columns: int = STRIPES) -> Pixels:
    """Return what stands where nothing is known, (rows, columns, 3); by default, one tile of it."""
    stripe = np.indices((rows, columns)).sum(axis=0) % STRIPES < STRIPES // 2
    return np.where(stripe[..., None], *GREYS).astype(np.uint8).repeat(3, axis=2)


def enlarged(image: Image, down: int, across: int) -> Pixels:
    """Return 8-bit sRGB of linear light in [0, 1], pixels repeated down and across, NaN hatched."""
    known = _known(image).repeat(down, axis=0).repeat(across, axis=1)
    pixels = rasters.srgb_bytes(np.nan_to_num(image)).repeat(down, axis=0).repeat(across, axis=1)
    return np.where(known[..., None], pixels, hatching(*known.shape))


def common_white(images: Iterable[Image]) -> float:
    """Return one white for several images of one unit: `displayable`'s, of all their values."""
    return float(np.nanpercentile(np.concatenate([np.ravel(image) for image in images]), 99.5))


def write_enlarged(path: Path, image: Image, text: Mapping[str, str]) -> None:
    """Write linear light as a PNG, patches repeated to about 720 pixels across, NaN hatched."""
    rows, columns = image.shape[:2]
    across = max(1, 720 // columns)
    down = across * int(np.ceil(columns / rows / LONGEST))  # of a strip
    with outputs.staged_file(path) as staged:
        staged.write_bytes(pictures.png_bytes(enlarged(image, down, across), text))


def show(ax: Any, title: str, picture: NDArray[Any], **colours: Any) -> Any:
    """Show (rows, columns, 3) in sRGB or (rows, columns) in false colour, pixel by pixel.

    Pixels are square, but for those of a strip, see `LONGEST`, which has a frame with an axis.
    What is transparent, or NaN, is hatched. The false colours are as `imshow` takes them. Return
    the image, for a colour bar.
    """
    ax.set_title(title)
    ax.set_axis_off()
    width = proportions(picture)
    aspect = picture.shape[1] / picture.shape[0] / width
    if _is_strip(picture):
        ax.set_axis_on()
        ax.spines[:].set_visible(True)
        for axis, size in zip((ax.yaxis, ax.xaxis), picture.shape, strict=False):
            axis.set_visible(size > 1)
    shown = ax.imshow(picture, interpolation="nearest", aspect=aspect, **colours)
    if picture.shape[2:] == (4,) or (picture.ndim == 2 and np.isnan(picture).any()):
        stripes = hatching(200, round(200 * width))
        ax.imshow(stripes, extent=shown.get_extent(), aspect=aspect, zorder=-1)  # behind it
    return shown


def proportions(picture: NDArray[Any]) -> float:
    """Return the width of a picture over its height as it is drawn; a strip is stretched."""
    return float(np.clip(picture.shape[1] / picture.shape[0], 1 / LONGEST, LONGEST))


def _is_strip(picture: NDArray[Any]) -> bool:
    return not np.isclose(proportions(picture), picture.shape[1] / picture.shape[0])


def show_light(ax: Any, title: str, image: Image, white: float | None = None) -> None:
    """Show linear light, (rows, columns, 3), exposed by `displayable`; NaN is hatched."""
    show(ax, title, encoded(image, white))


def encoded(image: Image, white: float | None) -> NDArray[np.float64]:
    """Return light exposed by `displayable`, in sRGB; with a fourth channel, 0 where NaN is."""
    known = _known(image)[..., None]
    picture = rasters.srgb_encode(displayable(image, white))
    return picture if known.all() else np.concatenate([picture, known], axis=-1)


def show_signed(
    axes: Sequence[Any], maps: Mapping[str, Image], unit: str, bound: float = 0.0
) -> None:
    """Show maps, (rows, columns), by their titles, red above 0 and blue below, with a colour bar.

    Colours end at `bound` either way, or at the first map's 99th percentile; NaN is hatched.
    """
    bound = bound or float(np.nanpercentile(np.abs(next(iter(maps.values()))), 99)) or 1.0
    colours = style.mpl.colormaps["RdBu_r"].with_extremes(bad=(0, 0, 0, 0))
    for ax, (title, values) in zip(axes, maps.items(), strict=True):
        picture = show(ax, title, values, cmap=colours, vmin=-bound, vmax=bound)
    axes[0].figure.colorbar(picture, ax=list(axes), shrink=0.9, label=unit)


def show_rows(figure: Any, rows: Rows) -> None:
    """Show pictures, (rows, columns, 3) in sRGB, side by side under their titles, in named rows.

    The figure is as wide as a column; if a named row has more than `ABREAST`, as a page. A single
    row has no name, and continues below. Pictures of a line are equally high.
    """
    lines = list((rows if isinstance(rows, Mapping) else {"": rows}).items())
    if len(lines) == 1:
        ((_, panels),) = lines
        width = float(np.mean([proportions(picture) for _, picture in panels]))
        columns = int(np.clip(style.COLUMN / (LEAST * width), 1, ABREAST))
        columns = -(-len(panels) // -(-len(panels) // columns))  # even lines
        lines = [("", panels[k : k + columns]) for k in range(0, len(panels), columns)]
    aspects = [[proportions(picture) for _, picture in panels] for _, panels in lines]
    columns = max(map(len, aspects))
    ratios = [max(each[k] for each in aspects if len(each) > k) for k in range(columns)]
    width = style.COLUMN if columns <= ABREAST else style.PAGE
    slots = min(NARROWER * width / sum(ratios), TALLEST) * np.array(ratios)
    heights = [min([TALLEST, *(slots[: len(each)] / each)]) for each in aspects]
    titles = [
        [style.wrapped(t, slot) for (t, _), slot in zip(panels, slots, strict=False)]
        for _, panels in lines
    ]
    above = [style.LINE * max(len(t.split("\n")) for t in each) + GAP for each in titles]
    figure.set_layout_engine("compressed", w_pad=GAP / 2, h_pad=GAP / 2, wspace=0, hspace=0)
    figure.set_size_inches(width, sum(heights) + sum(above))
    grid: Any = {"width_ratios": ratios, "height_ratios": heights, "squeeze": False}
    axes = figure.subplots(len(lines), columns, **grid)
    side = {"rotation": 90, "ha": "right", "va": "center", "multialignment": "center"}
    for line, (name, panels), height, row in zip(axes, lines, heights, titles, strict=True):
        for ax, title, (_, picture) in zip(line, row, panels, strict=False):
            show(ax, title, picture)
        for ax in line[len(panels) :]:
            ax.remove()
        name = style.wrapped(name, height)
        line[0].text(-0.05, 0.5, name, transform=line[0].transAxes, **side)


def draw_panels(
    path: Path,
    panels: Rows,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images, (rows, columns, channels) in [0, 1], side by side under their titles.

    NaN is hatched. The panels are one row, or rows by their names.
    """
    named = panels if isinstance(panels, Mapping) else {"": panels}
    rows = {
        name: [(title, encoded(image, 1)) for title, image in row] for name, row in named.items()
    }
    with style.drawn(path, metadata, caption) as figure:
        show_rows(figure, rows)


def draw_bounds(
    path: Path,
    alone: Mapping[str, Array],
    both: Mapping[str, Array],
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw bounds of the standard errors of patches, by A alone and by [A, B], and their ratio.

    All are (R, C), by the surfaces' ids, white being 1. What no logarithmic scale shows, as a bound
    of 0, is hatched, and the caption says so.
    """
    maps = {
        name: [100 * style.positive(each) for each in (alone[name], both[name])] for name in alone
    }
    values = np.concatenate([np.ravel(each) for pair in maps.values() for each in pair])
    norm = style.log_norm(values)
    if np.isnan(values).any():
        caption = f"{caption}; hatched: no bound above 0".removeprefix("; ")
    heights = [1 / proportions(each) for each in alone.values()]
    with style.drawn(path, metadata, caption) as figure:
        figure.set_size_inches(
            style.COLUMN, 1.1 * sum(heights) + 0.3 * len(alone) + BAR * len(alone)
        )
        axes = figure.subplots(len(alone), 3, squeeze=False, height_ratios=heights)
        for line, (name, pair) in zip(axes, maps.items(), strict=True):
            for ax, title, percent in zip(line, ("A alone", "[A, B]"), pair, strict=False):
                bounds = show(ax, title, percent, norm=norm, cmap="viridis")
            ratio = show(line[2], "ratio", pair[1] / pair[0], vmin=1)
            beneath: dict[str, Any] = {"location": "bottom", "aspect": 12}
            figure.colorbar(ratio, ax=line[2], label="[A, B] over A", **beneath)
            label = "standard error, % of white"
            bar = figure.colorbar(bounds, ax=line[:2], label=label, **beneath)
            style.plain_ticks(bar.ax.xaxis)
            if len(alone) > 1:
                line[0].set_title(f"{name}\nA alone")


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
    colours = {"cmap": "magma_r", "norm": style.mpl.colors.LogNorm(*CERTAINTY)}
    caption = f"The standard errors assume that {assumed}." if assumed else ""
    with style.drawn(path, metadata, caption) as figure:
        heights = [min(1.4 / proportions(each), TALLEST) for each in images.values()]
        figure.set_size_inches(style.COLUMN, max(1.3, sum(heights) + 0.25 * len(images)))
        axes = figure.subplots(len(images), 2, squeeze=False, height_ratios=heights)
        for (left, right), (name, image) in zip(axes, images.items(), strict=True):
            show_light(left, name if len(images) > 1 else "reconstruction", image, white)
            error = np.sqrt(np.mean(np.asarray(standard_errors[name]) ** 2, axis=2))
            shown = show(right, "standard error", 100 / white * error, **colours)
        look: dict[str, Any] = {"shrink": 0.9, "label": "% of white", "extend": "both"}
        bar = figure.colorbar(shown, ax=axes[:, 1], **look)
        bar.set_ticks(ticks := [0.3, 1, 3, 10, 30, 100], labels=[f"{each:g}" for each in ticks])
        bar.ax.minorticks_off()
        bar.ax.invert_yaxis()


def draw_residual(
    path: Path,
    photograph: Array,
    residual: "Residual",
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a photograph, (rows, columns, 3), linear, beside its residual; see `Residual`."""
    values, bound, unit = residual_map(residual)
    with style.drawn(path, metadata, caption) as figure:
        figure.set_size_inches(style.COLUMN, min(1.4 / proportions(values), TALLEST) + 0.25)
        axes = figure.subplots(1, 2)
        unused = np.isnan(values)[..., np.newaxis]
        show_light(axes[0], "photograph", np.where(unused, np.nan, photograph))
        show_signed(axes[1:], {"unexplained": values}, style.wrapped(unit, 1.3), bound)


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
