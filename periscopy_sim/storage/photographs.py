"""Photographs of the relay wall, alone and in sequences, from every format of a camera, and masks.

Each is decoded as its format asks, prepared as what it is, and checked as all of its kind are. A
sequence, or what the hidden scene showed meanwhile, is decoded frame by frame.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph, blackened, check_real, check_size, with_channels
from periscopy_sim.photographs.develop import SensorImage, plateaus, sensor_image
from periscopy_sim.storage import formats
from periscopy_sim.storage.pictures import area_average, hidden_light, read_hidden_image
from periscopy_sim.storage.rasters import GAMMA, SRGB, Picture, decoding, listed, srgb_light


def read_photograph(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of a known size; its contents decide its format.

    EXR, NPY, NPZ (key `photograph`) and TIFF of floating-point numbers are linear light, and so are
    arrays of 8-bit integers, with a warning. PNG, TIFF and JPEG are what they declare, linear light
    or, with a warning, encoded by the sRGB curve; if they declare nothing, 16 bits are linear and 8
    bits encoded.

    Parameters
    ----------
    shape : (rows, columns)
        Size that the photograph must have.
    mask : (rows, columns) bool
        True where the wall is used; elsewhere the photograph may hold anything, also NaN, and
        keeps it. Give the mask to the method too, which leaves those pixels out. None: everywhere.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format, or fails `Photograph.of`.
    """
    picture, warnings = _linear_light(path)
    values = picture.values
    values = values.astype(float) if values.dtype == np.uint8 else values  # known to be linear
    return Photograph.of(values, shape, str(path), mask=mask, warnings=tuple(warnings))


def read_sensor_image(
    path: str | Path,
    white: float | None = None,
    *,
    has_black: bool = False,
    encoding: str | None = None,
) -> tuple[SensorImage, tuple[str, ...]]:
    """Read a photograph of any size, as `read_photograph` does, and where it is saturated.

    Raw files of cameras are linear, their black level off, without white balance, one pixel for
    each cell of the mosaic, without interpolation.

    Parameters
    ----------
    white : float
        The value from which on a pixel is saturated. None: what a raw file says, and the largest
        integer, if a converter's range ends there. A warning names other plateaus at the top.
    has_black : bool
        Whether a black level is still to be taken off, which is an error for pictures that are
        encoded for screens.
    encoding : str
        That of the frames whose companion the photograph is, and so of its integers. None: what
        the file declares.

    Returns
    -------
    (SensorImage, tuple of str)
        The photograph, and what had to be assumed or left out, one line each.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format or of another encoding.
    """
    picture, warnings = _linear_light(path, encoding)
    if picture.encoding == SRGB and (has_black or white is not None):
        raise PhotographError(
            f"{path}: is encoded for screens; give a raw file, or leave out the black level and "
            "the saturation"
        )
    exposure = sensor_image(picture.values, str(path), white, picture.saturated, picture.cell)
    is_known = white is not None or exposure.saturated.any()
    return exposure, (*warnings, *([] if is_known else plateaus(exposure.values, str(path))))


def _linear_light(path: str | Path, encoding: str | None = None) -> tuple[Picture, list[str]]:
    """Decode a photograph as linear light.

    Return it with the encoding that the file has, and what was assumed or left out, one line each.
    """
    row = formats.format_of(Path(path))
    picture = row.decode(Path(path), formats.PHOTOGRAPH)
    values, full, wanted = picture.values, picture.saturated, encoding
    encoding = picture.encoding
    is_8_bits, kind = values.dtype == np.uint8, f"{8 * values.dtype.itemsize}-bit {row.name}"
    warnings = []
    if left_out := (*picture.left_out, *(() if picture.alpha is None else ("alpha",))):
        warnings.append(f"{path}: left out the channels {', '.join(left_out)}")
    if picture.unapplied:
        warnings.append(
            f"{path}: taken as the sensor counted, without the file's corrections "
            f"({', '.join(picture.unapplied)}); give a flat field, or export corrected linear TIFF"
        )
    if wanted is not None and values.dtype.kind in "iu":
        if wanted == SRGB != encoding and not is_8_bits:
            raise PhotographError(
                f"{path}: {kind}, but the frames are encoded for screens; save it as they are, or "
                "declare them linear"
            )
        encoding = wanted
    elif picture.is_display and is_8_bits and encoding in (None, GAMMA):
        encoding = SRGB
    if encoding == SRGB:
        white = np.iinfo(values.dtype).max
        values, full = srgb_light(values), (values == white).any(axis=2)
    if encoding in (SRGB, GAMMA) or (encoding is None and is_8_bits):
        how = "decoded by the sRGB curve" if encoding == SRGB else "taken as linear light"
        warnings.append(f"{path}: {kind}, {how}; if it is not so, export linear light as EXR")
    return replace(picture, values=values, encoding=encoding, saturated=full), warnings


def read_mask(path: str | Path, shape: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """Read where the wall is used from a picture: bright there, black where it is left out.

    Bright is what lies above half of the picture's largest value, whatever the bit depth; truth
    values are taken as they are. What is transparent is left out.

    Parameters
    ----------
    path : Path
        PNG, TIFF, JPEG, EXR, NPY, or NPZ (key `mask`): grey, or with equal channels.
    shape : (rows, columns)
        Size of the photograph, which the mask must have. None: any.

    Returns
    -------
    (rows, columns) bool
        True where the wall is used.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format or size, coloured, not finite, or leaves
        out every pixel.
    """
    path = Path(path)
    picture = formats.decode_picture(path, "mask")
    values = with_channels(picture.values, str(path))
    if picture.alpha is not None:
        values = np.where(picture.alpha > picture.alpha.max() / 2, values, 0)
    if shape is not None:
        check_size(values.shape[:2], shape, str(path))
    grey, largest = values[..., :1], values.max(initial=0)
    if largest == 0 and not values.any():
        raise PhotographError(f"{path}: a black mask leaves no pixel. Save the wall white")
    if (values != grey).any() or not 0 < largest < np.inf:  # also where one is NaN
        raise PhotographError(f"{path}: not a greyscale mask. Save the wall white, the rest black")
    # A quotient, since half of the largest integer may be no integer.
    return np.asarray(grey[..., 0] / largest > 0.5)


@dataclass(frozen=True, eq=False)
class Frames:
    """Photographs in time's order, each decoded and checked when it is read."""

    names: tuple[str, ...]  # the file or the number of each
    read: Callable[[int], Photograph]  # returns a frame by its number

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Photograph]:
        return map(self.read, range(len(self)))


def open_frames(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Frames:
    """Open a sequence of photographs; each is read and checked when its turn comes.

    A folder holds one photograph a file, of any format of `read_photograph` but one alone, in the
    natural order of their names: frame2 before frame10; other files and subfolders do not count. An
    array (frames, rows, columns, C) named `photograph` is in an NPZ file, which is decoded as a
    whole, or in a Zarr group of format 3, as a data set has it; an NPY file holds one, too.

    Parameters
    ----------
    path : Path
        The folder or file.
    shape : (rows, columns)
        Size that each photograph must have.
    mask : (rows, columns) bool
        Where the wall is used, see `read_photograph`; None: everywhere.

    Returns
    -------
    Frames
        At least one.

    Raises
    ------
    PhotographError
        Here if the sequence as a whole is missing, damaged, empty or of another form or size; while
        iterating as `read_photograph`, naming the frame, the first being 0.
    """
    path = Path(path)
    if path.is_dir() and not (path / "zarr.json").exists():
        files = files_of_one_kind(path)
        names = tuple(file.name for file in files)
        return Frames(names, lambda k: read_photograph(files[k], shape, mask))
    if path.is_dir():
        stack = formats.zarr_stack(path)
    elif open_stack := formats.format_of(path).open_stack:
        stack = open_stack(path)
    else:
        raise PhotographError(
            f"{path}: is a single {formats.format_of(path).name} file; give a folder of "
            "photographs, a Zarr archive, or an NPY or NPZ stack"
        )
    check_size(_checked(stack, path).shape[1:3], shape, str(path))

    def read(k: int) -> Photograph:
        place = f"{path}, frame {k}"
        with decoding(place, "part of a stack"):
            values = np.asarray(stack[k])
        return Photograph.of(values, shape, place, mask=mask)

    return Frames(tuple(map(str, range(stack.shape[0]))), read)


def read_clip(sequence: Frames, progress: Callable[[float], None]) -> tuple[Array, list[str]]:
    """Read all photographs of a sequence, and the first warning of each kind, counted.

    The photographs are (frames, rows, columns, C), black where the mask leaves them out, as they
    are drawn. One that cannot serve is a `PhotographError` that names it.
    """
    of_kind: dict[str, list[str]] = {}
    frames = []
    for photograph in sequence:
        frames.append(blackened(photograph.values, photograph.mask))
        for warning in photograph.warnings:
            of_kind.setdefault(warning.partition(": ")[2], []).append(warning)
        progress(len(frames) / len(sequence))
    counted = (f"{w[0]} (likewise {len(w) - 1} more)" if w[1:] else w[0] for w in of_kind.values())
    return np.stack(frames), [*counted]


def read_hidden_frames(path: str | Path, shape: tuple[int, int], count: int) -> Iterator[Array]:
    """Yield what the hidden scene showed at each of `count` photographs: light, 1 for white.

    `path` is a folder of pictures of one format, in natural order, each read by
    `read_hidden_image`; an NPY stack (frames, any rows, any columns, 3) of such; or one picture,
    which stands for every frame. Each is averaged over the area of each patch: (rows, columns, 3).
    Neither one frame nor `count` is a `PhotographError`.
    """
    path = Path(path)
    images: Iterator[Array]
    if path.is_dir():
        files = files_of_one_kind(path)
        number, images = len(files), (read_hidden_image(file, shape) for file in files)
    elif formats.format_of(path).name == "NPY" and formats.mapped_stack(path).ndim == 4:
        stack = _checked(formats.mapped_stack(path), path)
        lights = (hidden_light(each, f"{path}, frame {k}") for k, each in enumerate(stack))
        number, images = len(stack), (area_average(light, shape) for light in lights)
    else:
        number, images = 1, iter([read_hidden_image(path, shape)])
    if number not in (1, count):
        raise PhotographError(
            f"{path}: holds {number} hidden images for {count} photographs; give as many, or one"
        )
    return images if number == count else repeat(next(images), count)


def files_of_one_kind(folder: Path) -> list[Path]:
    """Return the pictures in a folder, known by their formats.suffixes, in natural order.

    A folder with no picture, or with those of several formats, is a `PhotographError`.
    """
    known = formats.suffixes()
    files = [each for each in folder.iterdir() if each.name[0] != "." and not each.is_dir()]
    of_kind: dict[str, list[Path]] = {}
    for file in sorted(files, key=lambda file: _natural(file.name)):
        if kind := known.get(file.suffix.lower()):
            of_kind.setdefault(kind, []).append(file)
    if len(of_kind) != 1:
        examples = listed([f"{kind} ({files[0].name})" for kind, files in of_kind.items()])
        raise PhotographError(
            f"{folder}: holds {examples or 'no picture'}; keep frames of one format alone there"
        )
    return next(iter(of_kind.values()))


def _natural(name: str) -> tuple[list[str | int], str]:
    """Return a sort key by which frame2 comes before frame10: text and numbers in turn."""
    pieces = re.split("([0-9]+)", name.lower())
    return [int(piece) if i % 2 else piece for i, piece in enumerate(pieces)], name


def _checked(stack: Any, path: Path) -> Any:
    """Return an array, mapped or in Zarr, if it is a stack of pictures."""
    check_real(stack.dtype, str(path))
    if len(stack.shape) != 4 or 0 in stack.shape:
        raise PhotographError(
            f"{path}: has shape {stack.shape}; give a stack (frames, rows, columns, channels)"
        )
    return stack
