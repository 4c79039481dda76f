"""Where a result comes from: versions, scene, variant, seed and command."""

import hashlib
import platform
import shlex
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.numerics import Image
from periscopy_sim.numerics.limits import MOST_BYTES, read_regular
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.variant import mi
from periscopy_sim.scene import SceneDocument

_PACKAGES = ("periscopy-sim", "numpy", "scipy", "mitsuba", "drjit")


def provenance(
    scene: SceneDocument | None, seed: int | None = None, command: Sequence[str] = ()
) -> dict[str, object]:
    """Return what a result was made from, flat and ready for JSON.

    The entries are versions by package, `scene`, `scene_sha256`, `parameters`, Mitsuba's `variant`,
    `seed`, and `command` without ``--out``: results are the same wherever they lie. What there is
    not is None.
    """
    pairs = zip(("", *command), command, strict=False)
    words = [w for before, w in pairs if "--out" not in (before, w) and not w.startswith("--out=")]
    return {
        **{package: metadata.version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "scene": None if scene is None else str(scene.path),
        "scene_sha256": None if scene is None else scene_sha256(scene),
        "parameters": None if scene is None else dict(scene.given),
        "variant": mi.variant(),
        "seed": seed,
        "command": shlex.join(words),
    }


def as_text(record: Mapping[str, object]) -> dict[str, str]:
    """Return a record as text for the metadata of an image, without its empty entries."""
    return {name: str(value) for name, value in record.items() if value is not None}


def scene_sha256(scene: Path | SceneDocument) -> str:
    """Return the digest of a scene file and of every file that it names, in the text's order.

    The scene's own folder does not matter.
    """
    return sha256_of((read_document(scene) if isinstance(scene, Path) else scene).files)


def sha256_of(files: Iterable[Path]) -> str:
    """Return the digest of the contents of files, in their order."""
    digest = hashlib.sha256()
    for file in files:
        try:
            digest.update(hashlib.sha256(read_regular(file, MOST_BYTES)).digest())
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}; check the path") from error
    return digest.hexdigest()


def array_sha256(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values."""
    state = hashlib.sha256(f"{array.shape} {array.dtype.str}".encode())
    state.update(np.ascontiguousarray(array).data)
    return state.hexdigest()


def image_sha256(image: Image | Mapping[str, Image]) -> Any:
    """Return the digest of a hidden image to single precision; of several images each by its id.

    Its last bits follow how many threads resampled it.
    """
    if isinstance(image, Mapping):
        return {name: image_sha256(each) for name, each in image.items()}
    return array_sha256(image.astype(np.float32))
