"""Cases of a study, kept as NPZ files with what they were made from: a run that stops goes on."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Case = TypeVar("Case", bound=DataclassInstance)


def write_case(case: DataclassInstance, file: Path, made_from: str) -> None:
    """Keep a dataclass of arrays and of JSON's types, with the digest of what it was made from."""
    held = {field.name: getattr(case, field.name) for field in fields(case)}
    arrays = {name: value for name, value in held.items() if isinstance(value, np.ndarray)}
    record = {name: value for name, value in held.items() if name not in arrays}
    with staged_file(file) as staged:
        np.savez_compressed(staged, record=json.dumps([made_from, record]), **arrays)


def read_case(kind: type[Case], file: Path, made_from: str) -> Case | None:
    """Return what was kept, if it was made from the same."""
    if not file.is_file():
        return None
    with np.load(file) as kept:
        source, record = json.loads(str(kept["record"]))
        if source != made_from:
            return None
        return kind(**record, **{name: kept[name] for name in kept.files if name != "record"})
