"""Folders that one command fills over many runs, beside a record of what all results depend on."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from periscopy_sim.errors import OutputError
from periscopy_sim.numerics.limits import read_json
from periscopy_sim.storage.outputs.staging import alone_in, out_of_space_reported, staged_file

SETTINGS = "settings.json"
"""File that holds what a folder's results were made with."""


@contextmanager
def resumed_folder(
    out: Path,
    settings: Mapping[str, Any],
    what: str,
    files: Sequence[str],
) -> Iterator[None]:
    """Fill a folder over many runs of the same settings, alone in it.

    A folder of other settings, or with `files`, names or patterns, of unknown settings, is an
    OutputError. Until the first of its files exists, the settings may differ.
    """

    def is_new() -> bool:
        return next(out.glob(files[0]), None) is None

    def check() -> None:
        try:
            recorded = dict(read_json(out / SETTINGS))
        except FileNotFoundError:
            for file in (file for pattern in files for file in out.glob(pattern)):
                reason = f"{file.relative_to(out)}, and no {SETTINGS} that says how it was made"
                raise OutputError(f"{out}: holds {reason}; name another folder") from None
            return
        except (ValueError, TypeError, OSError) as error:
            reason = getattr(error, "strerror", None) or "is damaged"
            raise OutputError(f"{out / SETTINGS}: {reason}; name another folder") from None
        if not is_new():
            check_settings(recorded, settings, str(out), what)

    with out_of_space_reported(out):
        check()  # before the folder is made
    with alone_in(out):
        check()
        if is_new():
            with staged_file(out / SETTINGS) as staged:
                staged.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
        yield


def check_settings(
    recorded: Mapping[str, Any], wanted: Mapping[str, Any], where: str, what: str
) -> None:
    """Raise an `OutputError` if results, `what`, in a folder, `where`, have other settings."""
    if difference := first_difference(recorded, wanted):
        raise OutputError(
            f"{where} holds another {what} ({difference}); name another folder, or remove it to "
            "start anew"
        )


def first_difference(recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return the first entry in which settings of JSON's types differ, and both; empty if none."""
    old: Any = recorded
    new: Any = json.loads(json.dumps(wanted))
    path: list[str] = []
    while old != new and isinstance(old, Mapping) and isinstance(new, Mapping):
        path.append(next(name for name in (*new, *old) if old.get(name) != new.get(name)))
        old, new = old.get(path[-1]), new.get(path[-1])
    values = f"{json.dumps(old)[:48]}, here {json.dumps(new)[:48]}"
    return f"{'.'.join(path)} {values}" if path else ""
