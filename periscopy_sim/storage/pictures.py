"""Hidden images in, and pictures to look at out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.arrays import read_npy, read_npz
from periscopy_sim.storage.decoding import file_format
from periscopy_sim.storage.exr import decode_exr
from periscopy_sim.storage.output import staged_file
from periscopy_sim.storage.rasters import Raster, read_raster
from periscopy_sim.storage.srgb import srgb_decode, srgb_encode

__all__ = ["area_average", "read_hidden_image", "srgb_decode", "srgb_encode", "write_png"]


def read_hidden_image(path: str | Path, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Read a picture as the radiance of the hidden scene's patches.

    PNG, JPEG and TIFF of 8 or 16 bits are decoded by the sRGB curve, and what is transparent in
    them is dark; EXR, NPY and floating-point TIFF are linear light, 8- or 16-bit integers in NPY
    fractions of their largest value. An NPZ file's array `hidden` is taken likewise, but its 8-bit
    integers are what a monitor was sent, and decoded.

    Parameters
    ----------
    path : Path
        The file, of any size.
    shape : (rows, columns)
        Hidden patches; the picture is averaged over the area of each, in linear light.

    Returns
    -------
    (rows, columns, 3) float64
        Linear light, 1 for white; row 0 is the top as a viewer facing the monitor sees it.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format, or has negative or non-finite values.
    """
    path = Path(path)
    kind = file_format(path)
    if kind == "EXR":
        light: NDArray[Any] = decode_exr(path).colour
    elif kind == "NPY":
        light = _fraction(read_npy(path), path)
    elif kind == "NPZ":
        stored = read_npz(path, "hidden")
        light = _fraction(stored, path)
        if stored.dtype == np.uint8:  # what a monitor was sent
            light = srgb_decode(light)
    elif kind in ("PNG", "TIFF", "JPEG"):
        light = _raster_light(read_raster(path, kind), path)
    else:
        raise PhotographError(f"{path}: is {kind}; give a PNG, JPEG, TIFF, EXR, NPY or NPZ picture")
    if light.ndim == 2:
        light = light[..., None]
    if light.ndim != 3 or light.shape[2] not in (1, 3) or light.size == 0:
        raise PhotographError(f"{path}: has shape {light.shape}; give (rows, columns, 3), or grey")
    if not (np.isfinite(light) & (light >= 0)).all():
        raise PhotographError(f"{path}: has negative, NaN or infinite values; replace them")
    return area_average(np.broadcast_to(light, (*light.shape[:2], 3)), shape)


def write_png(path: Path, linear_image: ArrayLike, text: Mapping[str, str]) -> None:
    """Write an 8-bit sRGB PNG; the same inputs give the same bytes.

    Parameters
    ----------
    path : Path
        Appears once complete.
    linear_image : (rows, columns, 3)
        Linear light, clipped to [0, 1].
    text : mapping
        Text chunks, such as provenance.

    Raises
    ------
    ValueError
        If the image has another shape or NaN.
    OutputError
        If the path cannot be written.
    """
    from PIL import Image, PngImagePlugin

    encoded = 255 * srgb_encode(np.clip(linear_image, 0, 1))
    if encoded.ndim != 3 or encoded.shape[2] != 3 or np.isnan(encoded).any():
        raise ValueError(f"image: expected (rows, columns, 3) without NaN, got {encoded.shape}")
    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\x00")  # declares the curve; 0: perceptual intent
    for key, value in sorted(text.items()):
        chunks.add_text(key, value)
    with staged_file(path) as staged:
        Image.fromarray(np.rint(encoded).astype(np.uint8)).save(staged, "PNG", pnginfo=chunks)


def area_average(image: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Resample an image by its exact mean over the area of each new pixel.

    Parameters
    ----------
    image : (rows, columns, channels)
        Constant over each of its pixels.
    shape : (new rows, new columns)
        More or fewer than the image has.

    Returns
    -------
    (new rows, new columns, channels) float64
        W_r image W_c^T for each channel, with W of `_coverage`.
    """
    image = np.asarray(image, dtype=np.float64)
    across = _coverage(shape[1], image.shape[1])
    down = _coverage(shape[0], image.shape[0])
    return np.asarray(across @ np.tensordot(down, image, axes=1))


def _coverage(boxes: int, pixels: int) -> NDArray[np.float64]:
    """(boxes, pixels) fractions of each of equal boxes that each of equal pixels covers."""
    edges = np.arange(boxes + 1) * (pixels / boxes)
    pixel = np.arange(pixels)
    upper = np.minimum(edges[1:, None], pixel + 1)
    lower = np.maximum(edges[:-1, None], pixel)
    return np.asarray(np.maximum(upper - lower, 0) * (boxes / pixels))


def _raster_light(raster: Raster, path: Path) -> NDArray[np.float64]:
    """Linear light of a PNG, TIFF or JPEG picture before a black ground."""
    light = _fraction(raster.colour, path)
    if raster.colour.dtype.kind == "u":
        light = srgb_decode(light)
    return light if raster.alpha is None else light * _fraction(raster.alpha, path)


def _fraction(values: NDArray[Any], path: Path) -> NDArray[np.float64]:
    """Integers as fractions of the largest of their dtype; floating-point values as they are."""
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    if values.dtype not in (np.uint8, np.uint16):
        raise PhotographError(f"{path}: holds {values.dtype}; save 8- or 16-bit or float values")
    return values / float(np.iinfo(values.dtype).max)
