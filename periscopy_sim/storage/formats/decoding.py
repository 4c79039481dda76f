"""Telling file formats apart, and reading them without letting a damaged file surprise."""

from __future__ import annotations

import io
import math
import os
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path

from periscopy_sim.errors import PhotographError

LARGEST_COUNT = 2**28
"""Most values (rows x columns x channels) that a file may announce."""

UNPACKED_COUNT = 2**25
"""Most values that a file may announce however small it is: few colours pack well."""

LARGEST_RATIO = 64
"""Most values that a larger file may announce for each of its bytes."""

_PIECE = 1 << 20  # bytes unpacked at once

_SIGNATURES = (
    (b"\x76\x2f\x31\x01", "EXR"),
    (b"\x93NUMPY", "NPY"),
    (b"PK\x03\x04", "NPZ"),
    (b"PK\x05\x06", "NPZ"),  # an archive without entries
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"II*\x00", "TIFF"),
    (b"MM\x00*", "TIFF"),
    (b"II+\x00", "TIFF"),  # BigTIFF
    (b"MM\x00+", "TIFF"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"\x89HDF\r\n\x1a\n", "MATLAB 7.3"),
)
_MATLAB_VERSIONS = {  # bytes 124 to 127 of the header, of either endianness
    b"\x00\x01IM": "MATLAB",
    b"\x01\x00MI": "MATLAB",
    b"\x00\x02IM": "MATLAB 7.3",
    b"\x02\x00MI": "MATLAB 7.3",
}


def file_format(path: Path) -> str:
    """Name the format of a file by its first bytes, whatever its suffix.

    Returns
    -------
    str
        EXR, NPY, NPZ, PNG, TIFF, JPEG, MATLAB or MATLAB 7.3.

    Raises
    ------
    PhotographError
        If there is no such file, it cannot be opened, or its first bytes fit no format.
    """
    try:
        if path.is_dir():
            raise PhotographError(f"{path}: is a folder; name a file in it")
        if path.exists() and not path.is_file():  # a pipe can be read but once
            raise PhotographError(f"{path}: is not a regular file; save it to one")
        with path.open("rb") as stream:
            head = stream.read(128)
    except FileNotFoundError as error:
        raise PhotographError(f"{path}: no such file; check the path") from error
    except OSError as error:
        reason = error.strerror or error
        raise PhotographError(f"{path}: cannot be opened: {reason}; check the path") from error
    if not head:
        raise PhotographError(f"{path}: is empty; save or copy it again")
    for signature, name in _SIGNATURES:
        if head.startswith(signature):
            return name
    if head[124:] in _MATLAB_VERSIONS:
        return _MATLAB_VERSIONS[head[124:]]
    raise PhotographError(
        f"{path}: is no EXR, NPY, NPZ, PNG, TIFF, JPEG or MATLAB 5 to 7 file, or is damaged "
        "at its start; save it as one of these"
    )


def check_count(shape: Sequence[int], path: Path) -> None:
    """Refuse a header that announces too many values, before allocating them.

    Raises
    ------
    PhotographError
        If the product of `shape` is more than `LARGEST_COUNT`, or more than `UNPACKED_COUNT` and
        more than `LARGEST_RATIO` for each byte of the file, or an extent is negative.
    """
    count, size = math.prod(shape), " x ".join(map(str, shape))
    if min(shape, default=1) < 0 or count > LARGEST_COUNT:
        raise PhotographError(
            f"{path}: its header announces {size} values, more than {LARGEST_COUNT}; "
            "the file is damaged, or average its pixels first"
        )
    if count > UNPACKED_COUNT and path.is_file() and count > LARGEST_RATIO * path.stat().st_size:
        raise PhotographError(
            f"{path}: its header announces {size} values, more than {LARGEST_RATIO} for each byte "
            "of the file; it is damaged, or average its pixels first"
        )


class Inflater:
    """Unpack deflated bytes piece by piece, to see that they are not more than they should be."""

    def __init__(self, most: int, path: Path) -> None:
        self._left, self._path = most, path
        self._inflate = zlib.decompressobj()

    def feed(self, packed: bytes) -> None:
        """Unpack the next bytes, and forget them.

        Raises
        ------
        PhotographError
            If all so far unpack to more than `most`.
        zlib.error
            If they are damaged.
        """
        while packed:
            self._left -= len(self._inflate.decompress(packed, _PIECE))
            if self._left < 0:
                raise PhotographError(
                    f"{self._path}: unpacks to more pixels than its header announces; save or "
                    "copy it again"
                )
            packed = self._inflate.unconsumed_tail


@contextmanager
def decoding(path: Path, kind: str, mend: str = "save or copy it again") -> Iterator[None]:
    """Read an untrusted file: quietly, and every failure becomes a `PhotographError`.

    Parameters
    ----------
    path : Path
        The file, for the message.
    kind : str
        Its format, for the message.
    mend : str
        What a user can do about it, for the message.

    Raises
    ------
    PhotographError
        For whatever the block raises: decoders meet damaged bytes with all kinds of exceptions.
    """
    try:
        with _silenced(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except PhotographError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {mend}") from error


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep decoders off the terminal: OpenEXR and libtiff print from C++ as well as Python."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), ExitStack() as restore:
        sink = os.open(os.devnull, os.O_WRONLY)
        restore.callback(os.close, sink)
        for descriptor in (1, 2):
            with suppress(OSError):  # a stream that was closed stays so
                saved = os.dup(descriptor)
                restore.callback(os.close, saved)
                restore.callback(os.dup2, saved, descriptor)
                os.dup2(sink, descriptor)
        yield
