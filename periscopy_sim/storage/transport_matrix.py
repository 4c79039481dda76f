"""A transport matrix on disk: an NPY file, a JSON record beside it, and an NPZ of what bounced.

A.npy holds the channels' mean, which programs may read without this package; A.bounced.npz, where
light bounces, what `BouncedLight` holds; A.json what both were made from.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError, PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.rendering.transport.bounced import (
    DIRECT,
    BouncedLight,
    BouncedTransport,
    bounces_in_words,
    channels_mean,
)
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.formats.decoding import decoding
from periscopy_sim.storage.formats.table import format_of
from periscopy_sim.storage.outputs.provenance import scene_sha256
from periscopy_sim.storage.outputs.staging import staged_file

Transport = NDArray[np.float32] | BouncedTransport
"""A, (M, N): an array of direct light, or the matrices of all channels with light that bounces."""

AGAIN = "render the matrix again"
CHUNK = 1 << 24
"""Bytes of a matrix that are read at once."""


def record_of(path: Path) -> Path:
    """Return the name of the JSON file beside a matrix."""
    return path.with_suffix(".json")


def bounced_of(path: Path) -> Path:
    """Return the name of the NPZ file beside a matrix, which it has where light bounces."""
    return path.with_suffix(".bounced.npz")


Write = Callable[[Transport, Mapping[str, Any]], None]
"""Writes a matrix and the record of what it was made from, as JSON has it."""


@contextmanager
def transport_writer(path: Path, bounces: int | None) -> Iterator[Write]:
    """Yield the function that writes a matrix of some bounces; its files appear once all are whole.

    That they can be written is tried on entry, before hours of rendering; see `staged_file`. The
    record holds the digests of the others, so that those of two matrices are not taken for one.
    """
    with ExitStack() as stack:
        staged, staged_record = (
            stack.enter_context(staged_file(file)) for file in (path, record_of(path))
        )
        staged_bounced = None
        if bounces != DIRECT:
            staged_bounced = stack.enter_context(staged_file(bounced_of(path)))

        def write(A: Transport, record: Mapping[str, Any]) -> None:
            mean = channels_mean(A)
            told = {"bounces": bounces_in_words(bounces), "matrix_sha256": _sha256(mean)}
            np.save(staged, mean)
            if staged_bounced is not None:
                assert isinstance(A, BouncedTransport)
                held = A.bounced
                np.savez(staged_bounced, over_wall=held.over_wall, of_patches=held.of_patches,
                         relative_error=held.relative_error)  # fmt: skip
                told["bounced_sha256"] = _sha256(held.over_wall, held.of_patches)
                record = {**record, "bounced_relative_error": held.relative_error}
            staged_record.write_text(json.dumps({**record, **told}, indent=2) + "\n", "utf-8")

        yield write
    if bounces == DIRECT:
        try:  # of a matrix that stood there before
            bounced_of(path).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot remove {bounced_of(path)}, of another matrix: {error}"
            ) from None


def read_transport(path: Path, scenario: Scenario, bounces: int | None = DIRECT) -> Transport:
    """Read a matrix, (M, N), that `transport_writer` wrote, mapped, for a scene and bounces.

    Without the JSON file that was written beside it, only the shapes can be compared, and direct
    light is assumed. A PhotographError says that it is damaged, of another scene or size, or holds
    other bounces.
    """
    if format_of(path).name != "NPY":
        raise PhotographError(f"{path}: is no NPY file; make one by `periscopy transport`")
    with decoding(path, "NPY"):
        # Mapped, not read: it may be large, and its shape is told by the header.
        A: NDArray[np.float32] = np.load(path, mmap_mode="r", allow_pickle=False)
    check_real(A.dtype, str(path))
    if A.shape != scenario.transport_shape:
        raise PhotographError(
            f"{path}: holds a matrix of shape {A.shape}; the scene's camera and hidden size need "
            f"{scenario.transport_shape}"
        )
    if not np.isfinite(A).all():
        raise PhotographError(f"{path}: holds NaN or infinities; {AGAIN}")
    record = _checked_record(path, scenario)
    held, asked = record.get("bounces", "direct"), bounces_in_words(bounces)
    if held != asked:
        raise PhotographError(
            f"{path}: was rendered by --bounces {held}, and --bounces {asked} is asked for; ask "
            f"for {held}, or {AGAIN}"
        )
    if record.get("matrix_sha256", digest := _sha256(A)) != digest:
        raise PhotographError(f"{path}: is of another matrix than {record_of(path)}; {AGAIN}")
    if bounces == DIRECT:
        return A
    return BouncedTransport(A, _bounced(path, record), bounces)


def _checked_record(path: Path, scenario: Scenario) -> dict[str, Any]:
    """Return the JSON beside a matrix, of the scene that it shall serve; empty without one."""
    record_file = record_of(path)
    if not record_file.is_file():
        if bounced_of(path).is_file():
            raise PhotographError(f"{record_file}: is missing, and {bounced_of(path)} needs it")
        return {}
    try:
        record: dict[str, Any] = json.loads(record_file.read_text("utf-8"))
        held = {name: record[name] for name in ("scene_sha256", "parameters", "hidden_shape")}
    except (ValueError, KeyError, TypeError, OSError):
        raise PhotographError(f"{record_file}: is damaged; {AGAIN}") from None
    wanted = {
        "scene_sha256": scene_sha256(scenario.path, scenario.parameters),
        "parameters": dict(scenario.parameters),
        "hidden_shape": list(scenario.hidden_shape),
    }
    for name, value in wanted.items():
        if held[name] != value:
            raise PhotographError(
                f"{path}: was made from another scene ({name.replace('_', ' ')} {held[name]}, here "
                f"{value}); render it again"
            )
    return record


def _bounced(path: Path, record: Mapping[str, Any]) -> BouncedLight:
    """Read what bounced, of the record's digest."""
    file = bounced_of(path)
    if not file.is_file():
        raise PhotographError(f"{file}: is missing, and {path} needs it; {AGAIN}")
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as data:
            light = BouncedLight(
                data["over_wall"], data["of_patches"], float(data["relative_error"])
            )
        intact = _sha256(light.over_wall, light.of_patches) == record["bounced_sha256"]
    except Exception:
        intact = False
    if not intact:
        raise PhotographError(f"{file}: is damaged, or of another matrix than {path}; {AGAIN}")
    return light


def _sha256(*arrays: NDArray[Any]) -> str:
    """Return the digest of arrays, a part of each at a time."""
    digest = hashlib.sha256()
    for values in arrays:
        digest.update(f"{values.shape} {values.dtype}".encode())
        for rows in np.array_split(values, max(1, values.nbytes // CHUNK)):
            digest.update(np.ascontiguousarray(rows).data)
    return digest.hexdigest()
