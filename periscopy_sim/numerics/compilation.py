"""Compiled loops: numba with a cache on disk, the interpreter's lock released."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function as it stands; divisions by zero give infinity or NaN, as in NumPy."""
    result: Function = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    return result


def compiled_reordered(function: Function) -> Function:
    """Compile a function of finite numbers whose sums may be reordered, so that loops vectorize."""
    options = {"reassoc", "nsz", "nnan", "contract"}
    result: Function = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=options)(
        function
    )
    return result
