"""The options of the registered methods, as a command's arguments."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, TypeVar

from periscopy_sim.cli import arguments
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import METHODS, Option

Command = TypeVar("Command", bound=Callable[..., None])
Offered = Mapping[str, tuple[Option, ...]]
"""The options that each method takes, by the method's name."""

FOR_STILLS: Offered = {name: entry.options for name, entry in METHODS.items()}
FOR_VIDEOS: Offered = {
    name: (*entry.options, *entry.video.options) for name, entry in METHODS.items() if entry.video
}
COUPLINGS = tuple(
    dict.fromkeys(
        coupling for entry in METHODS.values() if entry.video for coupling in entry.video.couplings
    )
)


def method_help(offered: Offered) -> str:
    """Return the help of ``--method``: each method, what it is, and its certainty for stills."""
    return "; ".join(
        f"{name}: {entry.help}"
        + (f" (with {entry.certainty})" if entry.certainty and offered is FOR_STILLS else "")
        for name, entry in METHODS.items()
        if name in offered
    )


def coupling_help() -> str:
    """Return the help of ``--coupling``: each coupling, and the methods that alone take it."""
    owners = {each: [name for name in FOR_VIDEOS if each in _couplings(name)] for each in COUPLINGS}
    return "; ".join(
        each + ("" if len(names) == len(FOR_VIDEOS) else f" ({_either(names)} alone)")
        for each, names in owners.items()
    )


def takes_options_of(offered: Offered) -> Callable[[Command], Command]:
    """Give a command's ``**options`` the names, bounds and help of the methods' options."""

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        *own, rest = signature.parameters.values()
        assert rest.kind is inspect.Parameter.VAR_KEYWORD
        options = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_argument(taken)
            )
            for name, taken in _by_name(offered).items()
        ]
        told: Any = command
        told.__signature__ = signature.replace(parameters=[*own, *options])
        told.__annotations__ = {p.name: p.annotation for p in [*own, *options]} | {"return": None}
        return command

    return decorate


def settings_for(
    method: str, given: Mapping[str, float | None], offered: Offered, coupling: str = ""
) -> dict[str, float]:
    """Return the values of a method's options: what is given, and its defaults.

    A user's own method takes none. Options of other couplings of a video's frames are left out;
    to give one of these, or one of another method, is an error.
    """
    taken = {option.name: option for option in offered.get(method, ())}
    owners = _by_name(offered)
    values = {name: value for name, value in given.items() if value is not None}
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        belongs = next(iter(owners[name].values())).coupling
        if belongs not in ("", coupling):
            raise PeriscopyError(
                f"{flag} belongs to --coupling {belongs}, not to {coupling}; leave it out"
            )
        if name not in taken:
            raise PeriscopyError(
                f"{flag} belongs to --method {_either(owners[name])}, not to {method}; leave it out"
            )
        if not taken[name].least <= value <= taken[name].most:
            raise PeriscopyError(
                f"{flag} {value:g}: --method {method} takes {taken[name].least:g} to "
                f"{taken[name].most:g}"
            )
    return {
        name: values.get(name, option.default)
        for name, option in taken.items()
        if option.coupling in ("", coupling)
    }


def check_coupling(method: str, coupling: str) -> None:
    """Check that a method recovers videos and knows a coupling."""
    if method not in FOR_VIDEOS:
        raise PeriscopyError(f"no method '{method}' for videos; use {_either(FOR_VIDEOS)}")
    owners = [n for n in FOR_VIDEOS if coupling in _couplings(n)]
    if not owners:
        raise PeriscopyError(f"no coupling '{coupling}'; use {_either(_couplings(method))}")
    if method not in owners:
        raise PeriscopyError(
            f"--coupling {coupling} belongs to --method {_either(owners)}; {method} takes "
            f"{_either(_couplings(method))}"
        )


def _couplings(method: str) -> tuple[str, ...]:
    video = METHODS[method].video
    return video.couplings if video else ()


def _by_name(offered: Offered) -> dict[str, dict[str, Option]]:
    """Return, for each option's name, the methods that take it and as what."""
    taken: dict[str, dict[str, Option]] = {}
    for method, options in offered.items():
        for option in options:
            taken.setdefault(option.name, {})[method] = option
    return taken


def _argument(taken: Mapping[str, Option]) -> Any:
    """Return the annotation of an option that some methods take."""
    first = next(iter(taken.values()))
    alike: dict[tuple[float, str], list[str]] = {}
    for method, option in taken.items():
        alike.setdefault((option.default, option.unit), []).append(method)
    defaults = "; ".join(
        f"{default:g} by {', '.join(methods)}" + (f" ({unit})" if unit else "")
        for (default, unit), methods in alike.items()
    )
    return Annotated[
        float | None,
        arguments.option(
            "NUMBER",
            f"{first.help} Default: {defaults}.",
            min=min(option.least for option in taken.values()),
            max=max(option.most for option in taken.values()),
            callback=arguments.not_nan,
            show_default=False,
        ),
    ]


def _either(names: Iterable[str]) -> str:
    """Return names as an alternative: a, b or c."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last
