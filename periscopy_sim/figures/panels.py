"""Pictures of images, maps and errors, side by side."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.style import OKABE_ITO, drawn, mpl, plain_ticks
from periscopy_sim.numerics import Array, Image
from periscopy_sim.storage.formats.srgb import srgb_encode
from periscopy_sim.storage.pictures import write_png

if TYPE_CHECKING:
    import xarray as xr

    from periscopy_sim.model.residual import Residual


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


def write_enlarged(path: Path, image: Image, text: Mapping[str, str]) -> None:
    """Write linear light by `write_png`, patches repeated to about 720 pixels across in all."""
    write_png(path, image, text, max(1, 720 // image.shape[1]))


def show(ax: Any, title: str, picture: NDArray[Any], **colours: Any) -> Any:
    """Show (rows, columns, 3) in sRGB or (rows, columns) in false colour, pixel by pixel.

    The false colours are as `imshow` takes them. Return the image, for a colour bar.
    """
    ax.set_title(title)
    ax.set_axis_off()
    return ax.imshow(picture, interpolation="nearest", aspect="equal", **colours)


def show_light(ax: Any, title: str, image: Image, white: float | None = None) -> None:
    """Show linear light, (rows, columns, 3), exposed by `displayable`."""
    show(ax, title, srgb_encode(displayable(image, white)))


def show_signed(
    axes: Sequence[Any], maps: Mapping[str, Image], unit: str, bound: float = 0.0
) -> None:
    """Show maps, (rows, columns), by their titles, red above 0 and blue below, with a colour bar.

    Colours end at `bound` either way, or at the first map's 99th percentile; NaN is grey.
    """
    bound = bound or float(np.percentile(np.abs(next(iter(maps.values()))), 99)) or 1.0
    colours = mpl.colormaps["RdBu_r"].with_extremes(bad="0.6")
    for ax, (title, values) in zip(axes, maps.items(), strict=True):
        picture = show(ax, title, values, cmap=colours, vmin=-bound, vmax=bound)
    axes[0].figure.colorbar(picture, ax=list(axes), shrink=0.8, label=unit)


def panel_row(figure: Any, panels: Sequence[tuple[str, Image]], height: float) -> Any:
    """Show pictures, (rows, columns, 3) in sRGB, side by side under their titles; return the axes.

    The figure becomes as large as pictures of `height` inches need, but no wider than a page.
    """
    aspects = [picture.shape[1] / picture.shape[0] for _, picture in panels]
    height = min(height, 8 / sum(aspects))
    figure.set_size_inches(height * sum(aspects) + 0.2, height + 0.4)
    axes = figure.subplots(1, len(panels), width_ratios=aspects, squeeze=False)[0]
    for ax, (title, picture) in zip(axes, panels, strict=True):
        show(ax, title, picture)
    return axes


def draw_panels(
    path: Path,
    panels: Sequence[tuple[str, Image]],
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images, (rows, columns, 3) in [0, 1], side by side, each under its title."""
    with drawn(path, metadata) as figure:
        panel_row(figure, [(title, srgb_encode(image)) for title, image in panels], 2.6)
        if caption:
            width, height = figure.get_size_inches()
            figure.set_size_inches(width, height + 0.25)
            figure.supxlabel(caption)


def draw_maps(
    path: Path,
    maps: Sequence[tuple[str, Image]],
    label: str,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw maps of one positive quantity on one logarithmic colour scale, with a colour bar.

    The maps are (rows, columns). The label is the quantity and its unit.
    """
    values = np.concatenate([np.ravel(values) for _, values in maps])
    norm = mpl.colors.LogNorm(float(values.min()), float(values.max()))
    aspect = max(each.shape[0] / each.shape[1] for _, each in maps)
    with drawn(path, metadata) as figure:
        figure.set_size_inches(3.6 * len(maps) + 0.9, 3.1 * aspect + 1.1)
        axes = figure.subplots(1, len(maps), squeeze=False)[0]
        for ax, (title, values) in zip(axes, maps, strict=True):
            picture = ax.imshow(values, norm=norm, cmap="viridis")
            ax.set(title=title, xlabel="patch column")
        axes[0].set_ylabel("patch row")
        bar = figure.colorbar(picture, ax=axes, label=label, shrink=0.9)
        plain_ticks(bar.ax.yaxis)
        figure.supxlabel(caption)


def draw_certainty(
    path: Path,
    image: Image,
    standard_errors: Image,
    assumed: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a reconstruction beside the standard errors of its patches, and their assumption.

    Both are (R, C, 3) in one unit; the errors are shown as the root mean square over the channels,
    in percent of the image's 99th percentile.
    """
    white = float(np.percentile(image, 99)) or 1.0
    errors = 100 / white * np.sqrt(np.mean(np.asarray(standard_errors) ** 2, axis=2))
    width = max(5.2 * image.shape[1] / image.shape[0] + 1.0, 4.5)
    with drawn(path, metadata) as figure:
        figure.set_size_inches(width, 3.4)
        left, right = figure.subplots(1, 2)
        show_light(left, "reconstruction", image, white)
        top = float(errors.max()) or 1.0
        shown = show(right, "standard error", errors, cmap="magma", vmin=0, vmax=top)
        figure.colorbar(shown, ax=right, shrink=0.9, label="% of white")
        sentences = ["Right: the standard error of each patch (one standard deviation)."]
        sentences += [f"This assumes that {assumed}."] * bool(assumed)
        figure.supxlabel("\n".join(fill(each, int(16 * width)) for each in sentences))


def draw_sweep(
    path: Path, results: "xr.Dataset", *, metadata: Mapping[str, str] | None = None
) -> None:
    """Draw each method's error against the signal-to-background ratio, as in Fig. 4.

    The results are `run_sweep`'s. Lines are means over backgrounds and seeds, bands reach from
    their 10th to their 90th percentile. Where a method failed it is left out.
    """
    errors = results["mean_squared_error"].sortby("sbr").stack(draw=("background", "seed"))
    looks = zip(cycle(OKABE_ITO), cycle(("-", "--", "-.", (0, (1, 1.2)))), strict=False)
    with drawn(path, metadata) as figure:
        ax = figure.subplots()
        for method, (colour, dashes) in zip(errors, looks, strict=False):
            finite = method.dropna("sbr", how="all")
            if not finite.size:
                continue
            low, high = finite.quantile((0.1, 0.9), "draw").values
            look: dict[str, Any] = {"color": colour, "label": method["algorithm"].item()}
            ax.plot(finite["sbr"], finite.mean("draw"), "o", ls=dashes, ms=2.6, **look)
            # The edge keeps the band of a single SBR in sight.
            ax.fill_between(finite["sbr"], low, high, color=colour, alpha=0.18, linewidth=0.8)
        ax.set(
            xscale="log", yscale="log",
            xlabel="signal-to-background ratio", ylabel="mean squared error (white is 1)",
        )  # fmt: skip
        for axis in (ax.xaxis, ax.yaxis):
            plain_ticks(axis)
        ax.grid(True, which="major")
        names = [str(line.get_label()) for line in ax.lines]
        columns = 2 if max(map(len, names), default=0) <= 22 else 1
        if names:  # above the axes: inside, it would hide a curve
            figure.legend(loc="outside upper center", ncols=columns, handlelength=2.8)
        figure.supxlabel("lines: means; bands: 10th to 90th percentile", fontsize=7)
        figure.set_size_inches(3.5, 2.75 + 0.13 * -(-len(names) // columns))


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
        show_light(axes[0], "photograph", photograph)
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
