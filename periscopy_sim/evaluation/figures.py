"""Pictures that a person can read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.storage.srgb import srgb_encode

Image = NDArray[np.floating[Any]]


def displayable(image: Image, white: float | None = None) -> NDArray[np.float64]:
    """Scale a linear image for display: negatives black, the brightest half percent white.

    Parameters
    ----------
    image
        (rows, columns, 3) linear.
    white
        Value shown as white; None for the 99.5th percentile. One factor for all channels, so that
        colours stay.

    Returns
    -------
    ndarray
        (rows, columns, 3) in [0, 1], linear.
    """
    level = float(np.percentile(image, 99.5)) if white is None else white
    return np.clip(np.asarray(image, np.float64) / (level if level > 0 else 1.0), 0, 1)


def enlarged(image: Image, width: int = 720) -> Image:
    """Repeat patches until the image is about `width` pixels wide."""
    factor = max(1, width // image.shape[1])
    return np.repeat(np.repeat(image, factor, axis=0), factor, axis=1)


def draw_panels(
    path: Path,
    panels: Sequence[tuple[str, Image]],
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side, each under its title.

    Parameters
    ----------
    path
        A PNG or PDF file.
    panels
        Titles and (rows, columns, 3) linear images in [0, 1].
    caption
        A line below.
    metadata
        Text chunks of a PNG, such as provenance.
    """
    from matplotlib.figure import Figure

    aspects = [image.shape[1] / image.shape[0] for _, image in panels]
    height = 2.6
    size = (height * sum(aspects) + 0.2, height + (0.65 if caption else 0.4))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(panels), width_ratios=aspects, squeeze=False)[0]
    for ax, (title, image) in zip(axes, panels, strict=True):
        ax.imshow(srgb_encode(image), interpolation="nearest", aspect="equal")
        ax.set_title(title, fontsize=10)
        ax.set_axis_off()
    if caption:
        figure.supxlabel(caption, fontsize=9)
    figure.savefig(path, dpi=200, metadata=dict(metadata or {}))


def draw_maps(
    path: Path,
    maps: Sequence[tuple[str, Image]],
    label: str,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw maps of one positive quantity on one logarithmic colour scale, with a colour bar.

    Parameters
    ----------
    path
        A PNG or PDF file.
    maps
        Titles and (rows, columns) positive values.
    label
        The quantity and its unit.
    caption
        A line below.
    metadata
        Text chunks of a PNG.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    values = np.concatenate([np.ravel(values) for _, values in maps])
    norm = LogNorm(float(values.min()), float(values.max()))
    figure = Figure(figsize=(3.6 * len(maps) + 0.9, 3.4), layout="constrained")
    axes = figure.subplots(1, len(maps), squeeze=False)[0]
    for ax, (title, values) in zip(axes, maps, strict=True):
        picture = ax.imshow(values, norm=norm, cmap="viridis", interpolation="nearest")
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("patch column", fontsize=9)
        ax.tick_params(labelsize=8)
    axes[0].set_ylabel("patch row", fontsize=9)
    bar = figure.colorbar(picture, ax=axes, label=label, shrink=0.9)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_major_formatter(plain)
    bar.ax.yaxis.set_minor_formatter(plain)
    bar.ax.tick_params(labelsize=8, which="both")
    if caption:
        figure.supxlabel(caption, fontsize=9)
    figure.savefig(path, dpi=200, metadata=dict(metadata or {}))
