"""The options of the registered methods, on the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, TypeVar

from periscopy_sim.cli.options import EXPERT, SOLVER, number, option
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import METHODS, Option

Command = TypeVar("Command", bound=Callable[..., None])
Offered = Mapping[str, tuple[Option, ...]]
"""The options that each method takes, by the method's name."""

FOR_STILLS: Offered = {name: entry.options for name, entry in METHODS.items()}
_COUPLINGS = {name: entry.video.couplings for name, entry in METHODS.items() if entry.video}
FOR_VIDEOS: Offered = {
    name: (*entry.options, *entry.video.options) for name, entry in METHODS.items() if entry.video
}
COUPLINGS = tuple(dict.fromkeys(each for taken in _COUPLINGS.values() for each in taken))


def method_help(offered: Offered) -> str:
    """Return the help of ``--method``: each method's help, and its certainty for stills."""
    words = []
    for name in offered:
        entry = METHODS[name]
        certainty = entry.certainty if offered is FOR_STILLS else ""
        words.append(f"{name}: {entry.help}" + (f" (with {certainty})" if certainty else ""))
    return "; ".join(words)


def _name_of(words: str, names: Collection[str]) -> Any:
    """Return an option that takes one of some names, which the shell completes."""
    return option("NAME", f"{words}.", group=SOLVER, autocompletion=lambda: list(names))


_OWN = "yours as module:callable or file.py:callable"
StillMethod = Annotated[str, _name_of(f"{method_help(FOR_STILLS)}; {_OWN}", FOR_STILLS)]
VideoMethod = Annotated[str, _name_of(method_help(FOR_VIDEOS), FOR_VIDEOS)]
Coupling = Annotated[
    str, _name_of(f"Coupling of a frame to the one before: {', '.join(COUPLINGS)}", COUPLINGS)
]


def takes_options_of(offered: Offered) -> Callable[[Command], Command]:
    """Give a command's ``**numbers`` the names, bounds and help of the methods' options."""

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        own = list(signature.parameters.values())[:-1]
        options = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_argument(taken)
            )
            for name, taken in _by_name(offered).items()
        ]
        described: Any = command
        described.__signature__ = signature.replace(parameters=[*own, *options])
        annotations = {p.name: p.annotation for p in [*own, *options]}
        described.__annotations__ = annotations | {"return": None}
        return command

    return decorate


def settings_for(
    method: str, given: Mapping[str, float | None], offered: Offered, coupling: str = ""
) -> dict[str, float]:
    """Return the values of a method's options: the user's, else the defaults.

    A user's own method has no options. A PeriscopyError names an option that belongs to another
    method or coupling of a video's frames.
    """
    options = {
        option.name: option
        for option in offered.get(method, ())
        if option.coupling in ("", coupling)
    }
    values = {name: value for name, value in given.items() if value is not None}
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        owners = _by_name(offered)[name]
        if name not in options:
            belongs = next(iter(owners.values())).coupling
            other = f"--coupling {belongs}" if belongs else f"--method {' or '.join(owners)}"
            raise PeriscopyError(
                f"{flag} belongs to {other}, not to {coupling if belongs else method}; leave it out"
            )
        if not options[name].least <= value <= options[name].most:
            raise PeriscopyError(
                f"{flag} {value:g}: --method {method} takes {options[name].least:g} to "
                f"{options[name].most:g}"
            )
    return {name: values.get(name, option.default) for name, option in options.items()}


def check_coupling(method: str, coupling: str) -> None:
    """Check that a method recovers videos and knows a coupling."""
    if method not in FOR_VIDEOS:
        raise PeriscopyError(f"no method '{method}' for videos; use {' or '.join(FOR_VIDEOS)}")
    if coupling not in _COUPLINGS[method]:
        raise PeriscopyError(
            f"--coupling {coupling}: method {method} takes {' or '.join(_COUPLINGS[method])}"
        )


def _by_name(offered: Offered) -> dict[str, dict[str, Option]]:
    """Return, for each option's name, the methods that take it and its entry there."""
    taken: dict[str, dict[str, Option]] = {}
    for method, options in offered.items():
        for each in options:
            taken.setdefault(each.name, {})[method] = each
    return taken


def _argument(taken: Mapping[str, Option]) -> Any:
    """Return the annotation of an option that some methods take."""
    first = next(iter(taken.values()))
    methods: dict[tuple[float, str], list[str]] = {}
    for method, entry in taken.items():
        methods.setdefault((entry.default, entry.unit), []).append(method)
    defaults = "; ".join(
        f"{default:g} by {', '.join(names)}" + (f" ({unit})" if unit else "")
        for (default, unit), names in methods.items()
    )
    return Annotated[
        float | None,
        number(
            f"{first.help} Default: {defaults}.",
            group=SOLVER if first.name.endswith("weight") else EXPERT,
            min=min(entry.least for entry in taken.values()),
            max=max(entry.most for entry in taken.values()),
            show_default=False,
        ),
    ]
