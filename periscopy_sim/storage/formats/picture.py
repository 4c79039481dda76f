"""What every decoder returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file holds, as it was saved; row 0 is the top."""

    values: NDArray[Any]  # (rows, columns[, channels]) of any real dtype
    alpha: NDArray[Any] | None = None  # opacity, (rows, columns, 1) of that dtype
    left_out: tuple[str, ...] = ()  # other channels of the file
    is_display: bool = False  # made for screens: integers may be encoded by the sRGB curve
    exposure: float | None = None  # time, of raw sensor counts, which are averaged; else None
