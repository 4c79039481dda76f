"""The process that reads the cases of `python -m experiments.fuzz`, one by one.

It takes pickled cases from its standard input, each behind 8 bytes of length, and answers with a
line of JSON: a verdict and its detail. A case may hang or end the process.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import sys
import traceback
import warnings
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from experiments.fuzz.sound import HIDDEN, SHAPE, Case
from periscopy_sim.errors import PeriscopyError

HEADROOM = 3 << 29
"""Bytes that a case may allocate before allocations fail."""

GROWTH = (300 << 20) + 8 * (1 << 25)
"""Bytes that a case may occupy: 300 MB, and the largest array that a small file may announce."""

LONGEST_LINE = 1000
"""Characters of an error."""

ACCEPTED, REFUSED = "accepted", "refused"


def readers() -> dict[str, Callable[[Path], Any]]:
    """Return the readers by name; each returns arrays, or None."""
    from periscopy_sim.dataset.configuration import load_configuration
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.storage.photographs import read_mask, read_photograph
    from periscopy_sim.storage.pictures import read_hidden_image
    from periscopy_sim.storage.sequences import open_frames, read_hidden_frames

    return {
        "photograph": lambda path: [read_photograph(path, SHAPE).values],
        "hidden image": lambda path: [read_hidden_image(path, HIDDEN)],
        "mask": lambda path: [read_mask(path, SHAPE).astype(float)],
        "frames": lambda path: [f.values for f in islice(open_frames(path, SHAPE), 100)],
        "hidden frames": lambda path: list(read_hidden_frames(path, HIDDEN, 3)),
        "scene": lambda path: [
            array
            for array in vars(load_scenario(path, HIDDEN)).values()
            if isinstance(array, np.ndarray)
        ],
        "configuration": lambda path: [np.asarray(load_configuration(path).sbr.bounds)],
    }


def outcome(reader: Callable[[Path], Any], case: Case) -> tuple[str, str]:
    """Read a case, and tell the verdict and its detail: the error's line, or the defect."""
    with TemporaryDirectory() as folder:
        path = case.write(Path(folder))
        limit_memory(HEADROOM)
        before = reset_peak()
        verdict, detail = _read(reader, path)
        growth = status("VmHWM") - before
        detail = detail.replace(folder, "")
        if verdict not in (ACCEPTED, REFUSED):
            return verdict, detail
        if growth > GROWTH:
            return "memory", f"{growth >> 20} MB: {detail}"
        return verdict, detail


def _read(reader: Callable[[Path], Any], path: Path) -> tuple[str, str]:
    try:
        for array in reader(path):
            if array.dtype != np.float64 or not np.isfinite(array).all():
                return "values", f"{array.dtype}, not all finite"
    except PeriscopyError as error:
        return _refusal(error)
    except MemoryError as error:
        return "allocation", repr(error)
    except Warning as warning:
        return "warning", f"{type(warning).__name__}: {warning} at {_origin(warning)}"
    except BaseException as error:
        return "exception", f"{type(error).__name__}: {error} at {_origin(error)}"
    return ACCEPTED, ""


def _refusal(error: PeriscopyError) -> tuple[str, str]:
    text = str(error)
    if not text.isprintable() or len(text) > LONGEST_LINE:
        return "line", f"{len(text)} characters: {text[:LONGEST_LINE]!r}"
    return REFUSED, text


def _origin(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "periscopy_sim" in frame.filename] or frames
    return ", ".join(f"{Path(f.filename).name}:{f.lineno}" for f in (ours[-1], frames[-1]))


def status(entry: str) -> int:
    """Read an entry of this process's memory in bytes."""
    with Path("/proc/self/status").open(encoding="ascii") as lines:
        return next(int(line.split()[1]) << 10 for line in lines if line.startswith(f"{entry}:"))


def limit_memory(headroom: int) -> None:
    """Let allocations fail beyond what is held now and the headroom."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (status("VmData") + headroom, hard))


def reset_peak() -> int:
    """Start the measurement of the largest resident size anew, and give the size now."""
    Path("/proc/self/clear_refs").write_text("5", "ascii")
    return status("VmRSS")


def main() -> None:
    """Answer cases until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    sink = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    for descriptor in (1, 2):
        os.dup2(sink, descriptor)
    os.close(sink)
    warnings.simplefilter("error")
    known = readers()
    while head := sys.stdin.buffer.read(8):
        case = pickle.loads(sys.stdin.buffer.read(int.from_bytes(head, "little")))
        print(json.dumps(outcome(known[case.reader], case)), file=answers, flush=True)


if __name__ == "__main__":
    main()
