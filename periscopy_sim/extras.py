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
    "torch": "torch",
    "deepinv": "deepinv",
    "websockets": "live",
    "av": "video",
    "h5py": "published",
}
"""The extra that brings each library."""


def installation(*extras: str) -> str:
    """Return the command that installs extras: `periscopy` on PyPI is another project."""
    return f"in a copy of the repository: pip install -e '.[{','.join(extras)}]'"


def missing(*modules: str) -> str:
    """Return one line that says which extras bring modules."""
    are = "are" if modules[1:] else "is"
    extras = dict.fromkeys(EXTRA_OF[module] for module in modules)
    return f"this needs {', '.join(modules)}, which {are} not installed; {installation(*extras)}"


def require_all(*modules: str) -> None:
    """Raise a PeriscopyError that names all modules that are not installed; none is imported."""
    if lacking := [module for module in modules if find_spec(module) is None]:
        raise PeriscopyError(missing(*lacking))


def require(module: str) -> Any:
    """Import a library that an extra brings; a PeriscopyError says how to install it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise PeriscopyError(missing(module)) from None
