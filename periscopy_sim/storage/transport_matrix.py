"""The matrices on disk: A, the light transport, and B, the prototype backgrounds, as NPY files.

A.npy holds the channels' mean, which programs may read without this package; A.bounced.npz, where
light bounces, what `BouncedLight` holds; A.json what both were made from.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.validation import bounces_in_words, read_json
from periscopy_sim.photograph import check_real
from periscopy_sim.rendering.bounced import DIRECT, BouncedLight, BouncedTransport, channels_mean
from periscopy_sim.storage import formats, outputs, provenance, rasters
from periscopy_sim.view import Geometry

Transport = NDArray[np.float32] | BouncedTransport
"""A, (M, N): an array of direct light, or the matrices of all channels with light that bounces."""

Write = Callable[[Transport, Mapping[str, Any]], list[Path]]
"""Writes a matrix and, as JSON, the record of its origin; returns the files beside the matrix."""

BOUNCED = "over_wall", "of_patches", "relative_error"
"""The arrays of the NPZ file."""

AGAIN = "render the matrix again"


def read_record(path: Path) -> dict[str, Any]:
    """Return what the JSON file beside a matrix holds; nothing without such a file."""
    file = path.with_suffix(".json")
    if not file.is_file():
        return {}
    with rasters.decoding(file, "JSON", AGAIN):
        return dict(read_json(file))


def bounced_of(path: Path) -> Path:
    """Return the name of the NPZ file beside a matrix, which it has where light bounces."""
    return path.with_suffix(".bounced.npz")


@contextmanager
def transport_writer(path: Path, bounces: int | None) -> Iterator[Write]:
    """Yield the function that writes a matrix of some bounces; its files appear once all are whole.

    The places are tried on entry, before hours of rendering; see `staged_file`. The record holds
    the digests of the other files, by which files of two matrices differ.
    """
    beside = [path.with_suffix(".json"), *([] if bounces == DIRECT else [bounced_of(path)])]
    with ExitStack() as stack:
        staged, staged_record, *staged_bounced = (
            stack.enter_context(outputs.staged_file(file)) for file in (path, *beside)
        )

        def write(A: Transport, record: Mapping[str, Any]) -> list[Path]:
            mean = channels_mean(A)
            np.save(staged, mean)
            identity = {"bounces": bounces_in_words(bounces), "matrix_sha256": _sha256(mean)}
            if isinstance(A, BouncedTransport):
                light = A.bounced
                np.savez(staged_bounced[0], **{name: getattr(light, name) for name in BOUNCED})
                identity["bounced_sha256"] = _sha256(light.over_wall, light.of_patches)
                record = {**record, "bounced_relative_error": light.relative_error}
            staged_record.write_text(json.dumps({**record, **identity}, indent=2) + "\n", "utf-8")
            return beside

        yield write
    if bounces == DIRECT:
        bounced_of(path).unlink(missing_ok=True)  # of a matrix that stood there before


def read_prototypes(path: Path, pixels: int) -> NDArray[Any]:
    """Read B, (M, L), of a photograph of M pixels, row-major; another file is a PhotographError."""
    B = _finite_matrix(path)
    if B.ndim != 2 or B.shape[0] != pixels or not B.shape[1]:
        raise PhotographError(
            f"{path}: holds an array of shape {B.shape}; prototype backgrounds are ({pixels}, "
            "lights), a row for each pixel of the scene's camera"
        )
    return B  # of its own type, whose rounding is no light


def read_transport(path: Path, scenario: Geometry, bounces: int | None = DIRECT) -> Transport:
    """Read a matrix, (M, N), that `transport_writer` wrote, mapped, for a scene and bounces.

    Without its JSON file only the shapes are compared, and direct light is assumed. A
    PhotographError names a file that is damaged, or of another size, scene or light.
    """
    A = _finite_matrix(path)
    record, bounced = read_record(path), bounced_of(path)
    if record or bounces != DIRECT or bounced.is_file():
        record = {"bounces": "direct", **record}
        settings = {
            "scene_sha256": provenance.scene_sha256(scenario.document),
            "parameters": dict(scenario.parameters),
            "hidden_shape": scenario.hidden.unwrapped(scenario.hidden.shapes),
            "bounces": bounces_in_words(bounces),
        }
        _check(path, record, settings)
    if A.shape != scenario.transport_shape:
        raise PhotographError(
            f"{path}: holds a matrix of shape {A.shape}; the scene's camera and hidden size need "
            f"{scenario.transport_shape}"
        )
    if not record:
        return A
    digests, light = {"matrix_sha256": _sha256(A)}, None
    if bounces != DIRECT:
        over_wall, of_patches, error = (formats.npz_array(bounced, key=name) for name in BOUNCED)
        with rasters.decoding(bounced, "NPZ", AGAIN):
            light = BouncedLight(over_wall, of_patches, float(error))
        digests["bounced_sha256"] = _sha256(light.over_wall, light.of_patches)
    _check(path, record, digests)
    return A if light is None else BouncedTransport(A, light, bounces)


def _check(path: Path, record: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raise a PhotographError for the first entry in which a record differs."""
    if difference := provenance.first_difference(
        {name: record.get(name) for name in wanted}, wanted
    ):
        raise PhotographError(
            f"{path}: was made from another scene or light ({difference}); pass its options, or "
            f"{AGAIN}"
        )


def _finite_matrix(path: Path) -> NDArray[Any]:
    """Return an NPY file of finite real numbers as a memory map."""
    if formats.format_of(path).name != "NPY":
        raise PhotographError(f"{path}: is no NPY file; save the matrix by numpy.save")
    check_real((matrix := formats.mapped_stack(path)).dtype, str(path))
    if not np.isfinite(matrix).all():
        raise PhotographError(f"{path}: holds NaN or infinities; {AGAIN}")
    return matrix


def _sha256(*arrays: NDArray[Any]) -> str:
    """Return the digest of arrays; what is mapped is not read into memory as a whole."""
    digest = hashlib.sha256()
    for values in arrays:
        digest.update(f"{values.shape} {values.dtype}".encode())
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()
