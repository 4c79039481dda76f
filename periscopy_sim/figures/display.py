"""Images to look at in Python: an exposure that knows no truth, on the screen or in a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures import panels, style
from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.storage.pictures import write_png
from periscopy_sim.storage.rasters import srgb_encode


def to_srgb(image: Any, white: float | None = None) -> NDArray[np.float64]:
    """Return linear light as a screen wants it: encoded by the sRGB curve, in [0, 1].

    Parameters
    ----------
    image
        (rows, columns, channels) or, grey, (rows, columns) linear light of any unit, such as a
        reconstruction or a photograph; or what ``solve`` or ``read_photograph`` returned, or
        anything that holds such an array as its ``image``, ``photograph`` or ``values``.
    white
        What is shown white; None for the 99.5th percentile. Negatives and NaN are black.

    Returns
    -------
    (rows, columns, 3) float64

    Raises
    ------
    ValueError
        If it is no such image, or holds no finite number.
    """
    return srgb_encode(_exposed(image, white))


def save_png(
    path: str | Path,
    image: Any,
    white: float | None = None,
    *,
    text: Mapping[str, str] | None = None,
) -> None:
    """Write linear light as an 8-bit sRGB PNG, exposed as by `to_srgb`; see there.

    Pixels of small images are repeated, so that the shorter side has 256 pixels at least. `text`
    holds text chunks, such as provenance. An `OutputError` says that the file cannot be written.
    """
    light = _exposed(image, white)
    write_png(Path(path), light, text or {}, -(-256 // min(light.shape[:2])))


def show(
    *images: Any, titles: Sequence[str] | None = None, white: float | None = None, **titled: Any
) -> Any:
    """Show linear images side by side, by matplotlib, pixel by pixel.

    Parameters
    ----------
    *images
        As for `to_srgb`.
    titles
        One for each; None for their sizes.
    white
        As for `to_srgb`: one number for all, or None to expose each by itself.
    **titled
        Further images by title, such as ``truth=f, photograph=y``; underscores become spaces.

    Returns
    -------
    Figure
        The figure; its ``axes`` are there to draw on. Where matplotlib has a window, this function
        returns when the user closes it. A notebook shows the figure by itself.

    Raises
    ------
    ValueError
        As by `to_srgb`, or if there is no image, or another number of titles.
    """
    if not (images or titled) or (titles is not None and len(titles) != len(images)):
        raise ValueError(f"{len(images)} images and {len(titles or ())} titles: give one for each")
    pictures = [to_srgb(image, white) for image in (*images, *titled.values())]
    names = [*(titles or ("{} x {}".format(*picture.shape) for picture in pictures[: len(images)]))]
    names += [title.replace("_", " ") for title in titled]
    plt = style.mpl.pyplot
    figure: Any = plt.figure()
    with style.mpl.rc_context(style.STYLE):
        panels.show_rows(figure, list(zip(names, pictures, strict=True)))
    if figure.canvas.required_interactive_framework:  # a window, not a file or a notebook
        plt.show()
    elif plt.get_backend().endswith("inline"):
        figure._ipython_display_ = lambda: _display_once(figure)
    return figure


def _exposed(image: Any, white: float | None) -> NDArray[np.float64]:
    """Return an image scaled to [0, 1], still linear, (rows, columns, 3)."""
    if isinstance(image, Photograph):
        image = blackened(image.values, image.mask)
    held = (getattr(image, name, None) for name in ("image", "photograph", "values"))
    values = np.asarray(next((each for each in held if isinstance(each, np.ndarray)), image))
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or not np.isfinite(values).any():
        raise ValueError(
            f"{values.dtype} of shape {values.shape} is no image; give finite numbers, "
            "(rows, columns, channels) or (rows, columns)"
        )
    return panels.displayable(values, white)


def _display_once(figure: Any) -> None:
    """Display a figure, and close it: notebooks display open figures again after each cell."""
    from IPython import display

    del figure._ipython_display_
    style.mpl.pyplot.close(figure)
    display.display(figure)
