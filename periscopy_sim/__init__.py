"""Computational periscopy: from a Mitsuba scene and a photograph of a wall to the hidden image.

The public names, listed in ``__init__.pyi``, are loaded when first used, so that importing the
package imports no renderer.
"""

from typing import Any
from warnings import warn

import lazy_loader

try:
    _load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
except ValueError:
    raise ImportError(f"{__file__} is in an archive; unpack it, scenes are files too") from None

_FORMER = {"World", "Sweep", "run_sweep"}
"""Names that version 0.3 has no more, for which `sweep` serves."""

_SUCCESSORS = {
    "IterativePeriscope": "ps.NoiseAware",
    "Learned": "experiments/learned/unrolled.py:Unrolled in a copy of the repository",
    "Sensor": "ps.add_noise, or NumPy's Generator.poisson of the photograph in electrons",
}
"""What takes the place of names that are gone."""


def __getattr__(name: str) -> Any:
    """Load a public name."""
    if name in _SUCCESSORS:
        raise AttributeError(f"ps.{name} is gone: use {_SUCCESSORS[name]}")
    if name in _FORMER:
        warn(f"use ps.sweep; ps.{name} goes in 0.3", DeprecationWarning, stacklevel=2)
    return _load(name)
