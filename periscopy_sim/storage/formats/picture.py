"""What every decoder returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file holds, as it was saved.

    Attributes
    ----------
    values : (rows, columns) or (rows, columns, channels) of any real dtype
        Row 0 is the top.
    alpha : (rows, columns, 1) of the same dtype, or None
        Opacity, where the file has it.
    left_out : tuple of str
        Other channels of the file.
    is_display : bool
        Whether the file is made for screens, so that its integers may be encoded by the sRGB curve.
    exposure : float or None
        Exposure time of raw sensor counts, which are averaged to a photograph; None for all else.
    """

    values: NDArray[Any]
    alpha: NDArray[Any] | None = None
    left_out: tuple[str, ...] = ()
    is_display: bool = False
    exposure: float | None = None
