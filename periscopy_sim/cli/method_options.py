"""The options of the registered methods, on the command line."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping
from typing import Annotated, Any

from periscopy_sim.cli.options import EXPERT, SOLVER, OptionGroup, number, option
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import METHODS, Option

Offered = Mapping[str, tuple[Option, ...]]
"""The options that each method takes, by the method's name."""

FOR_STILLS: Offered = {name: entry.options for name, entry in METHODS.items()}
_VIDEOS = {name: entry.video for name, entry in METHODS.items() if entry.video}
FOR_VIDEOS: Offered = {
    name: (*METHODS[name].options, *video.options) for name, video in _VIDEOS.items()
}
COUPLINGS = tuple(dict.fromkeys(each for video in _VIDEOS.values() for each in video.couplings))


def _one_of(words: str, names: Collection[str]) -> Any:
    """Return an option that takes one of some names, which the shell completes."""
    return option("NAME", f"{words}.", group=SOLVER, autocompletion=lambda: list(names))


def _listed(offered: Offered) -> str:
    """Return each method's help, with its certainty for stills."""
    entries = [METHODS[name] for name in offered]
    certain = [f" (with {each.certainty})" if each.certainty else "" for each in entries]
    certain = certain if offered is FOR_STILLS else [""] * len(entries)
    return "; ".join(
        f"{e.name}: {e.help}{known}" for e, known in zip(entries, certain, strict=True)
    )


_OWN = "yours as module:callable or file.py:callable"
StillMethod = Annotated[str, _one_of(f"{_listed(FOR_STILLS)}; {_OWN}", FOR_STILLS)]
VideoMethod = Annotated[str, _one_of(_listed(FOR_VIDEOS), FOR_VIDEOS)]
Coupling = Annotated[
    str, _one_of(f"Coupling of a frame to the one before: {', '.join(COUPLINGS)}", COUPLINGS)
]


def settings_for(
    method: str, given: Mapping[str, float | None], offered: Offered, coupling: str = ""
) -> dict[str, float]:
    """Return the values of a method's options: the user's, else the defaults.

    A user's own method has no options. A PeriscopyError names an option that the method, with this
    coupling of a video's frames, does not take, or not of this value.
    """
    taken = {each.name: each for each in offered.get(method, ()) if each.coupling in ("", coupling)}
    values = {name: value for name, value in given.items() if value is not None}
    for name, value in values.items():
        if name not in taken or not taken[name].least <= value <= taken[name].most:
            raise PeriscopyError(
                f"--{name.replace('_', '-')} {value:g}: --method {method} {coupling} takes "
                + (f"{taken[name].least:g} to {taken[name].most:g}" if name in taken else "none")
            )
    return {name: values.get(name, each.default) for name, each in taken.items()}


def check_coupling(method: str, coupling: str) -> None:
    """Check that a method recovers videos and knows a coupling."""
    if method not in _VIDEOS:
        raise PeriscopyError(f"no method '{method}' for videos; use {' or '.join(_VIDEOS)}")
    if coupling not in (known := _VIDEOS[method].couplings):
        raise PeriscopyError(f"--coupling {coupling}: method {method} takes {' or '.join(known)}")


def _argument(taken: Mapping[str, Option]) -> Any:
    """Return the annotation of an option that some methods take."""
    first = next(iter(taken.values()))
    defaults: dict[str, list[str]] = {}
    for method, each in taken.items():
        unit = f" ({each.unit})" if each.unit else ""
        defaults.setdefault(f"{each.default:g}{unit}", []).append(method)
    listed = "; ".join(f"{default} by {', '.join(names)}" for default, names in defaults.items())
    words = number(
        f"{first.help} Default: {listed}.",
        group=SOLVER if first.name.endswith("weight") else EXPERT,
        min=min(entry.least for entry in taken.values()),
        max=max(entry.most for entry in taken.values()),
        show_default=False,
    )
    return Annotated[float | None, words]


def _signature(offered: Offered) -> inspect.Signature:
    """Return the signature of a group of the options of some methods."""
    by_name: dict[str, dict[str, Option]] = {}
    for method, options in offered.items():
        for each in options:
            by_name.setdefault(each.name, {})[method] = each
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Signature([
        inspect.Parameter(name, kind, default=None, annotation=_argument(taken))
        for name, taken in by_name.items()
    ])  # fmt: skip


class StillNumbers(OptionGroup):
    """The values of the options of methods for stills, None where the user gave none."""

    __signature__ = _signature(FOR_STILLS)

    def __init__(self, **values: float | None) -> None:
        self.values = values


class VideoNumbers(StillNumbers):
    """The values of the options of methods for videos."""

    __signature__ = _signature(FOR_VIDEOS)
