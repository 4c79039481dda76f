"""Compiled loops: numba with a cache on disk, the interpreter's lock released."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function, **options: Any) -> Function:
    """Compile a function; divisions by zero give infinity or NaN, as in NumPy."""
    settings = {"nogil": True, "error_model": "numpy", **options}
    try:
        result: Function = numba.njit(cache=True, **settings)(function)
    except RuntimeError:  # no folder takes the cache: each process compiles anew
        result = numba.njit(**settings)(function)
    return result


def compiled_reordered(function: Function) -> Function:
    """Compile a function of finite numbers whose sums may be reordered, so that loops vectorize."""
    return compiled(function, fastmath={"reassoc", "nsz", "nnan", "contract"})
