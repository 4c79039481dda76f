"""Hidden images in, and pictures to look at out."""

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.validation import plain_array, size_of
from periscopy_sim.photograph import Photograph, blackened, with_channels
from periscopy_sim.storage import formats, outputs
from periscopy_sim.storage.rasters import LINEAR, Picture, srgb_bytes, srgb_light


def read_hidden_image(path: str | Path | ArrayLike, shape: Any) -> NDArray[np.float64]:
    """Read a picture as the radiance of the hidden scene's patches.

    Floating-point values are linear light. Integers of 8 or 16 bits, of files and arrays alike, are
    decoded by the sRGB curve, but for a PNG that declares linear light; what is transparent is
    dark. Of an NPZ file, the array `hidden` is read.

    Parameters
    ----------
    path : Path or array
        The file, of any size; or what an NPY file holds.
    shape : (rows, columns) or text
        Hidden patches, (29, 36) or ``29x36``; the picture is averaged over the area of each, in
        linear light.

    Returns
    -------
    (rows, columns, channels) float64
        Linear light, 1 for white; row 0 is the top as a viewer facing the monitor sees it. It has
        three channels, or as many more as an array has.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format, or has negative or non-finite values.
    """
    if isinstance(path, str | Path):
        name, picture = str(path), formats.decode_picture(Path(path), "hidden")
    else:
        name = "the hidden image"
        picture = Picture(plain_array(path, name))
    values = with_channels(picture.values, name)
    if values.size == 0:
        raise PhotographError(f"{name}: has shape {values.shape}; give one pixel at least")
    light = hidden_light(values, name, is_linear=picture.encoding == LINEAR)
    if picture.alpha is not None:
        light = light * hidden_light(picture.alpha, name, is_linear=True)  # on black
    return area_average(light, size_of(shape))


def hidden_light(
    values: NDArray[Any], place: str | Path, *, is_linear: bool = False
) -> NDArray[np.float64]:
    """Return (rows, columns, 1, 3 or more) values as light of three channels or more, 1 for white.

    Integers, of 8 or 16 bits, are decoded by the sRGB curve, or are fractions of their largest
    value. Values that are negative or not finite are a `PhotographError`.
    """
    if values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16):
        raise PhotographError(f"{place}: holds {values.dtype}; save 8- or 16-bit or float values")
    if values.dtype.kind == "f":
        with np.errstate(over="ignore", invalid="ignore"):  # long doubles, signalling NaNs
            light = values.astype(np.float64)
    else:
        light = values / np.iinfo(values.dtype).max if is_linear else srgb_light(values)
    if not (np.isfinite(light) & (light >= 0)).all():
        raise PhotographError(f"{place}: has negative, NaN or infinite values; replace them")
    if light.shape[2] == 2:
        raise PhotographError(f"{place}: has 2 channels; give three or more, or one of grey")
    return np.broadcast_to(light, (*light.shape[:2], max(3, light.shape[2])))


def write_png(
    path: Path, linear_image: ArrayLike, text: Mapping[str, str], factor: int = 1
) -> None:
    """Write (rows, columns[, 3]) linear light, clipped to [0, 1], as an 8-bit sRGB PNG.

    The same inputs give the same bytes. `text` holds text chunks, such as provenance; of each
    pixel, factor by factor are written. An image of another shape or with NaN is a ValueError.
    """
    image = np.asarray(linear_image)
    image = np.stack([image] * 3, axis=2) if image.ndim == 2 else image  # a mask
    if image.ndim != 3 or image.shape[2] != 3 or np.isnan(image).any():
        raise ValueError(f"image: expected (rows, columns, 3) without NaN, got {image.shape}")
    pixels = srgb_bytes(image).repeat(factor, axis=0).repeat(factor, axis=1)
    with outputs.staged_file(path) as staged:
        staged.write_bytes(png_bytes(pixels, text))


def png_bytes(pixels: NDArray[np.uint8], text: Mapping[str, str]) -> bytes:
    """Return the PNG file of 8-bit sRGB values, (rows, columns, 3)."""
    from PIL import Image, PngImagePlugin

    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\x00")  # declares the curve; 0: perceptual intent
    for key, value in sorted(text.items()):
        chunks.add_text(key, value)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", pnginfo=chunks)
    return stream.getvalue()


MAJORITY = 0.5 + 1e-6
"""Fraction of a pixel that a mask must leave; ties are decided alike in mirror images."""


def area_average(image: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image resampled by its exact mean over the area of each new pixel.

    The image is (rows, columns, channels), constant over each of its pixels; the result is W_r
    image W_c^T for each channel, with W of `coverage`, and has more or fewer pixels.
    """
    image = np.asarray(image, np.float64)
    down, across = (coverage(*sizes) for sizes in zip(shape, image.shape, strict=False))
    return np.asarray(across @ np.tensordot(down, image, axes=1))


def coverage(boxes: int, pixels: int) -> NDArray[np.float64]:
    """Return (boxes, pixels) fractions of each of equal boxes that each of equal pixels covers."""
    edges, pixel = np.arange(boxes + 1) * (pixels / boxes), np.arange(pixels)
    covered = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    return np.asarray(np.maximum(covered, 0) * (boxes / pixels))


def averaged_photograph(photograph: Photograph, shape: tuple[int, int]) -> Photograph:
    """Return a photograph averaged to fewer pixels, those of which the mask leaves the `MAJORITY`.

    Its photographs with the monitor off are averaged alike.
    """
    if shape == photograph.shape:
        return photograph
    covered = area_average(photograph.pixels[..., None], shape)
    inside = covered > MAJORITY

    def means(values: NDArray[np.float64]) -> NDArray[np.float64]:
        light = area_average(blackened(values, photograph.mask), shape)
        return np.asarray(light / np.where(inside, covered, np.inf))

    off = {name: means(each) for name, each in photograph.monitor_off.items()}
    mask = None if inside.all() else inside[..., 0]
    return replace(photograph, values=means(photograph.values), mask=mask, monitor_off=off)
