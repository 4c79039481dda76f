"""Results that a folder holds, and the settings that they are of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from periscopy_sim.errors import OutputError


def check_settings(
    held: Mapping[str, Any], wanted: Mapping[str, Any], where: str, what: str
) -> None:
    """Refuse to add to results of other settings; the message names the first entry that differs.

    Settings are of JSON's types. `where` is what holds the results, `what` they are: a sweep.
    """
    plain = json.loads(json.dumps(wanted))
    if held == plain:
        return
    key, there, here = _first_difference(held, plain)
    raise OutputError(
        f"{where} holds another {what} ({key} {_short(there)}, here {_short(here)}); name another "
        "folder, or remove it to start anew"
    )


def _first_difference(held: Any, wanted: Any, key: str = "") -> tuple[str, Any, Any]:
    if isinstance(held, Mapping) and isinstance(wanted, Mapping):
        for name in (*wanted, *(name for name in held if name not in wanted)):
            if held.get(name) != wanted.get(name):
                inner = f"{key}.{name}" if key else name
                return _first_difference(held.get(name), wanted.get(name), inner)
    if isinstance(held, list) and isinstance(wanted, list) and len(held) == len(wanted):
        for number, (there, here) in enumerate(zip(held, wanted, strict=True)):
            if there != here and isinstance(there, Mapping):
                return _first_difference(there, here, f"{key}[{number}]")
    return key, held, wanted


def _short(value: Any) -> str:
    text = "unset" if value is None else json.dumps(value)
    return text if len(text) <= 48 else f"{text[:45]}..."
