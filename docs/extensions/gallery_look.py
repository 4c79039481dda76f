"""The look of the gallery's pictures, set before each script."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def reset(gallery: dict[str, Any], script: str) -> None:
    """Forget what the last script set, and take the gallery's style."""
    import matplotlib as mpl

    mpl.rcdefaults()
    mpl.use("agg")
    mpl.rc_file(Path(__file__).with_name("gallery.mplstyle"), use_default_template=False)
