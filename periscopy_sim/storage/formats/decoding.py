"""Reading untrusted files: bounds on what they announce, and every failure as one error."""

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


def listed(names: Sequence[str]) -> str:
    """Return the first four names for a message, and how many follow."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def place_of(path: Path, frame: int | str) -> Path:
    """Return what to call a frame of a file, or several, in a message."""
    return Path(f"{path}, frame {frame}")


def check_count(shape: Sequence[int], path: Path) -> None:
    """Refuse a header that announces too many values, before allocating them.

    These are more than `LARGEST_COUNT`, or more than `UNPACKED_COUNT` and more than `LARGEST_RATIO`
    for each byte of the file. Nor may an extent be negative.
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
        """Unpack the next bytes, and forget them; refuse what unpacks to more than `most` in all.

        Damaged ones are a zlib.error.
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
def decoding(path: Path, kind: str, remedy: str = "save or copy it again") -> Iterator[None]:
    """Read an untrusted file: quietly, and whatever the block raises becomes a `PhotographError`.

    Decoders meet damaged bytes with all kinds of exceptions. The message says the file, the `kind`
    of its format, and what a user can do about it.
    """
    try:
        with _silenced(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except PhotographError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {remedy}") from error


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
