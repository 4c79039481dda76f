"""What the core install lacks: libraries that an extra brings, imported where they are needed."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from periscopy_sim.errors import PeriscopyError

SWEEP = ("xarray", "zarr", "google_crc32c", "distributed", "cloudpickle", "skimage")
EXTRA_OF = {
    **dict.fromkeys(SWEEP, "sweep"),
    "upath": "s3",
    "rawpy": "raw",
    "cv2": "tags",
    **dict.fromkeys(("torch", "safetensors"), "torch"),
    "deepinv": "deepinv",
    "websockets": "live",
    "av": "video",
    "h5py": "published",
}
"""The extra that brings each library."""


def installation(extra: str) -> str:
    """Return the command that installs an extra: `periscopy` on PyPI is another project."""
    return f"in a copy of the repository: pip install -e '.[{extra}]'"


def missing(module: str) -> str:
    """Return one line that says which extra brings a module."""
    return f"this needs {module}, which is not installed; {installation(EXTRA_OF[module])}"


def require_all() -> None:
    """Raise a PeriscopyError for a module of `SWEEP` that is not installed; none is imported."""
    for module in SWEEP:
        if find_spec(module) is None:
            raise PeriscopyError(missing(module))


def require(module: str) -> Any:
    """Import a library that an extra brings; a PeriscopyError says how to install it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise PeriscopyError(missing(module)) from None
