"""The options that commands share, in the groups of ``--help``, and the forms of their values."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer
from typer.core import TyperCommand

from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

SCENE, PHOTOGRAPH, LIGHT = "Scene", "Photograph", "Light"
SOLVER, OUTPUT, EXPERT = "Solver", "Output", "Expert"
"""Titles of the groups that ``--help`` shows."""

RENAMED = {"background": "monitor-off", "backgrounds": "light-model"}
"""Former names of options, which still work."""


class GroupedCommand(TyperCommand):
    """A command whose ``--help`` lists arguments and options by group."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write each group that has an entry; options without a group come last."""
        titles = (SCENE, PHOTOGRAPH, LIGHT, SOLVER, OUTPUT, EXPERT, "Options")
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in titles}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                title = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault(title, []).append(record)
        for title, records in groups.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def option(form: str, words: str, *names: str, group: str | None = None, **more: Any) -> Any:
    """Return an option: the form of its value, its help in words, the rest as typer takes it."""
    return typer.Option(*names, metavar=form, help=words, rich_help_panel=group, **more)


class OptionGroup:
    """Options that commands share: the parameters of a class's constructor.

    A command that takes such an object has these options on the command line; for
    ``Annotated[Group, {"hidden": "29x36"}]`` with other defaults.
    """


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that takes the options of its groups one by one."""
    parameters: dict[str, inspect.Parameter] = {}
    groups: dict[str, tuple[type[OptionGroup], list[str]]] = {}
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        group, *others = get_args(parameter.annotation) or (parameter.annotation,)
        if not (isinstance(group, type) and issubclass(group, OptionGroup)):
            parameters[name] = parameter
            continue
        members = inspect.signature(group, eval_str=True).parameters
        groups[name] = group, list(members)
        defaults: Mapping[str, Any] = others[0] if others else {}
        for each, member in members.items():
            parameters[each] = member.replace(default=defaults.get(each, member.default))

    def run(**values: Any) -> None:
        for name, (group, members) in groups.items():
            values[name] = group(**{each: values.pop(each) for each in members})
        command(**values)

    keywords = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters.values()]
    described: Any = run
    described.__doc__, described.__signature__ = command.__doc__, inspect.Signature(keywords)
    described.__annotations__ = {each.name: each.annotation for each in keywords}
    return run


def number(words: str, *, form: str = "NUMBER", group: str | None = None, **more: Any) -> Any:
    """Return an option that takes a number, never NaN; its bounds are ``min`` and ``max``."""

    def checked(value: float | None) -> float | None:
        if value is not None and math.isnan(value):  # the parser takes it to be within any bounds
            raise typer.BadParameter("nan is not a number")
        return value

    return option(form, words, group=group, callback=checked, **more)


# -- scene, photograph ---------------------------------------------------------------------------

_SCENE = "A Mitsuba XML file, or the name of a shipped scene."
_PATCHES = "Patches of the hidden image, such as 29x36."
_SET = "Set one of the scene's <default>s; repeatable."
_PHOTO = "EXR, NPY, NPZ (key photograph), 16-bit PNG or TIFF."
_MASK = "A picture of the photograph's size, black where the wall is not used."
_OFF = "A photograph of the wall with the monitor off; repeatable."
_COLOURS = "3x3 matrix (NPY, JSON, CSV) from the monitor's primaries to the camera's channels."

SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help=_SCENE, rich_help_panel=SCENE)]
SceneOption = Annotated[str, option("SCENE", _SCENE, group=SCENE)]
Hidden = Annotated[str, option("ROWSxCOLUMNS", _PATCHES, group=SCENE)]
Define = Annotated[list[str] | None, option("NAME=VALUE", _SET, "-D", group=SCENE)]
PhotoArgument = Annotated[
    Path, typer.Argument(metavar="PHOTO", help=_PHOTO, rich_help_panel=PHOTOGRAPH)
]
MaskOption = Annotated[Path | None, option("FILE", _MASK, group=PHOTOGRAPH)]
MonitorOffOption = Annotated[
    list[Path] | None, option("FILE", _OFF, "--monitor-off", group=PHOTOGRAPH)
]
ColourMatrixOption = Annotated[Path | None, option("FILE", _COLOURS, group=PHOTOGRAPH)]

# -- light ---------------------------------------------------------------------------------------


class Model(StrEnum):
    """How direct light of the transport matrix is computed."""

    rendered = "rendered"
    analytic = "analytic"


_SAMPLES = "Shadow rays to a patch from each wall point."
_MODEL = "A by shadow rays, or in closed form (flat wall and monitor, occluders of triangles)."
_IF_RAYS = f"{_SAMPLES} [default: see --model; then 16]"
_IF_CLOSED = f"{_MODEL} [default: closed form where there is one, but for preconditioned, unrolled]"
_BOUNCES = "The monitor's light in A: direct, all reflections, or at most N."
_MATRIX = "NPY file of A, instead of a rendering."
_LIGHT_MODEL = "Sources of ambient light: Eq. 4, columns of a file, a scene's lamps; repeatable."

# More samples would be hours in one kernel, which nothing can interrupt.
Samples = Annotated[int, option("NUMBER", _SAMPLES, group=LIGHT, min=1, max=65536)]
ModelOption = Annotated[Model, typer.Option(help=_MODEL, rich_help_panel=LIGHT)]
RaysOption = Annotated[
    int | None, option("NUMBER", _IF_RAYS, "--samples", group=LIGHT, min=1, max=65536)
]
ClosedOption = Annotated[
    Model | None, typer.Option("--model", help=_IF_CLOSED, rich_help_panel=LIGHT)
]
BouncesOption = Annotated[str, option("direct|all|N", _BOUNCES, group=LIGHT)]
MatrixOption = Annotated[Path | None, option("FILE", _MATRIX, "--transport", group=LIGHT)]
LightModelOption = Annotated[
    list[str] | None, option("grid|FILE.npy|SCENE", _LIGHT_MODEL, "--light-model", group=LIGHT)
]

# -- output, noise -------------------------------------------------------------------------------

_SNR = "Signal-to-noise ratio of Gaussian noise; the signal includes ambient light."

Out = Annotated[Path, option("FOLDER", "Folder to write.", group=OUTPUT)]
ResumedFolder = Annotated[
    Path, option("FOLDER", "Folder of results; the same command resumes there.", group=OUTPUT)
]
OutFile = Annotated[Path, option("FILE", "File to write.", group=OUTPUT)]
# Mitsuba takes seeds of 32 bits; commands count on from this one.
Seed = Annotated[
    int, option("NUMBER", "Seed of every random draw.", group=EXPERT, min=0, max=2**31 - 1)
]
Snr = Annotated[float, number(_SNR, form="DB", min=-100, max=300)]
OptionalSnr = Annotated[float | None, number(_SNR, form="DB", min=-100, max=300)]

Scheduler = Annotated[
    str | None, option("ADDRESS", "A Dask scheduler. [default: this machine]", group=EXPERT)
]

# -- forms of values -----------------------------------------------------------------------------


def parse_size(text: str) -> tuple[int, int]:
    """Read ROWSxCOLUMNS."""
    size = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text, re.IGNORECASE)
    if not size:
        raise PeriscopyError(f"'{text}' is not a size; write ROWSxCOLUMNS, such as 29x36")
    return int(size[1]), int(size[2])


def parse_list(flag: str, text: str) -> list[str]:
    """Read names separated by commas, each once."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise PeriscopyError(f"{flag} '{text}' has an empty name; separate names by one comma")
    return _without_doubles(flag, names)


def _without_doubles(flag: str, names: list[str]) -> list[str]:
    if doubles := {name for name in names if names.count(name) > 1}:
        raise PeriscopyError(f"{flag} has {', '.join(sorted(doubles))} twice; name each once")
    return names


def parse_definitions(definitions: list[str] | None, flag: str = "-D") -> dict[str, str]:
    """Read ``-D name=value`` options, or those of another name; each name once."""
    pairs = [each.partition("=") for each in definitions or []]
    for name, equals, value in pairs:
        if not (name and value):
            raise PeriscopyError(f"{flag} '{name}{equals}' is not of the form name=value")
    _without_doubles(flag, [name for name, _, _ in pairs])
    return {name: value for name, _, value in pairs}


def parse_errors(text: str, flag: str) -> dict[str, float | None]:
    """Read ``NAME[=ERROR],...``: names, each with its error if one is given; each name once."""
    pairs = [each.partition("=") for each in text.split(",") if each.strip()]
    _without_doubles(flag, [name.strip() for name, _, _ in pairs])
    try:
        return {name.strip(): float(error) if equals else None for name, equals, error in pairs}
    except ValueError:
        raise PeriscopyError(f"{flag} {text}: write NAME or NAME=ERROR, by comma") from None


def known_errors(
    named: Mapping[str, float | None], path: Path, given: Mapping[str, str]
) -> dict[str, float]:
    """Return the errors of ``--uncertain``: those given, else those that the scene declares.

    A PeriscopyError names a parameter whose error is unknown or not positive.
    """
    from periscopy_sim.calibration.prior import declared_errors, start_values

    if named:
        start_values(path, list(named), given)
    declared = declared_errors(path, given)
    errors = {
        name: declared.get(name, math.nan) if error is None else error
        for name, error in named.items()
    }
    for name, error in errors.items():
        if not 0 < error < math.inf:
            raise PeriscopyError(
                f"--uncertain {name}: give its error, a positive number: {name}=ERROR"
            )
    return errors


def require_suffix(out: Path, suffix: str, what: str) -> None:
    """Reject an --out whose suffix is not that of the file's format."""
    if out.suffix != suffix:
        raise OutputError(f"--out {out}: {what} is written as {suffix}; name a file that ends so")


def parse_ranges(text: str, flag: str) -> dict[str, tuple[float, float]]:
    """Read ``NAME=LOW:HIGH,...``, each name once."""
    ranges = {}
    for name, ends in parse_definitions([each.strip() for each in text.split(",")], flag).items():
        try:
            low, high = map(float, ends.split(":"))
        except ValueError:
            low = high = math.nan
        if not -math.inf < low < high < math.inf:
            raise PeriscopyError(
                f"{flag} {name}={ends}: write NAME=LOW:HIGH, such as occluder_dx=-0.05:0.05"
            )
        ranges[name] = (low, high)
    return ranges


def parse_indices(text: str, count: int) -> list[int]:
    """Read indices and ranges of them, such as ``0,4-7``; ranges end below `count`."""
    indices: list[int] = []
    for part in text.split(","):
        numbers = re.fullmatch("([0-9]{1,12})(?:-([0-9]{1,12}))?", part.strip())
        if not numbers:
            raise PeriscopyError(f"'{text}': write numbers and ranges of samples, such as 0,5,8-11")
        first, last = int(numbers[1]), int(numbers[2] or numbers[1])
        indices += range(first, min(last, count - 1) + 1) if numbers[2] else [first]
    if not indices:
        raise PeriscopyError(f"'{text}' holds no sample; the data set has {count}")
    return list(dict.fromkeys(indices))


MOST_RATIOS = 1000


def parse_ratios(text: str) -> list[float]:
    """Read signal-to-background ratios: ``0.1,1,10``, or ``0.1:10:log:9`` (``lin``: even steps)."""
    try:
        if ":" in text:
            first, last, spacing, count = text.split(":")
            ends, number = (float(first), float(last)), int(count)
            space: Any = {"log": np.geomspace, "lin": np.linspace}[spacing]
            inner = 0 < min(ends) <= max(ends) < math.inf and number <= MOST_RATIOS
            ratios = [float(f"{each:.6g}") for each in space(*ends, number)] if inner else []
        else:
            ratios = [float(ratio) for ratio in text.split(",")]
    except (ValueError, KeyError):
        ratios = []
    if not ratios or not all(0 < r < math.inf for r in ratios) or len({*ratios}) < len(ratios):
        raise PeriscopyError(
            f"--sbr '{text[:80]}' is no list of different positive ratios; write 0.1,1,10 or "
            "0.1:10:log:9"
        )
    return ratios


def parse_ambient(text: str) -> dict[str, Path | None]:
    """Read lighting conditions: names of shipped ones, groups of them, EXR files and folders.

    Return the EXR file of each name; None for a shipped condition.
    """
    lights: list[tuple[str, Path | None]] = []
    groups = {"all": REALISTIC, "adversarial": ADVERSARIAL}
    for entry in parse_list("--ambient", text):
        path = Path(entry)
        if entry in groups or entry in (*REALISTIC, *ADVERSARIAL):
            lights += [(name, None) for name in groups.get(entry, [entry])]
        elif path.is_dir() and (files := sorted(path.glob("*.exr"))):
            lights += [(file.stem, file) for file in files]
        elif path.suffix == ".exr":
            lights.append((path.stem, path))
        else:
            raise PeriscopyError(
                f"--ambient '{entry}': write an EXR file, a folder of EXR files, all, adversarial, "
                f"{', '.join((*REALISTIC, *ADVERSARIAL))}"
            )
    _without_doubles("--ambient", [name for name, _ in lights])
    return dict(lights)
