"""The gallery's order, and the look of its pictures, set before each script."""

from __future__ import annotations

from pathlib import Path
from typing import Any

FIRST = (
    "what_the_chair_casts",
    "singular_values",
    "first_reconstruction",
    "two_methods",
    "sbr_sweep",
)
"""Scripts that their section begins with; the others follow by name."""


class Order:
    """Sorts the scripts of a section."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, file: str) -> tuple[int, str]:
        """Return what a script is sorted by."""
        name = Path(file).stem
        return (FIRST.index(name) if name in FIRST else len(FIRST)), name


def reset(gallery: dict[str, Any], script: str) -> None:
    """Forget what the last script set, and take the gallery's style."""
    import matplotlib as mpl

    mpl.rcdefaults()
    mpl.use("agg")
    mpl.rc_file(Path(__file__).with_name("gallery.mplstyle"), use_default_template=False)
