"""The forms of the commands' arguments, and what is read from them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC


def option(form: str, words: str, *names: str, **more: Any) -> Any:
    """Return an option: the form of its value, its help in words, the rest as typer takes it."""
    return typer.Option(*names, metavar=form, help=words, **more)


Out = Annotated[Path, option("FOLDER", "Folder to write; appears complete or not at all.")]
OutFile = Annotated[Path, option("FILE", "File to write; appears complete or not at all.")]
PhotoArgument = Annotated[
    Path,
    typer.Argument(
        metavar="PHOTO", help="EXR, NPY, NPZ (key photograph), 16-bit PNG or TIFF, MATLAB raw."
    ),
]
_SCENE = "A Mitsuba XML file, or the name of a shipped scene."
SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help=_SCENE)]
SceneOption = Annotated[str, option("SCENE", _SCENE)]
Hidden = Annotated[str, option("ROWSxCOLUMNS", "Patches of the hidden image, such as 29x36.")]
Define = Annotated[
    list[str] | None, option("NAME=VALUE", "Set one of the scene's <default>s; repeatable.", "-D")
]
MaskOption = Annotated[
    Path | None,
    option(
        "FILE",
        "A grey picture of the photograph's size (PNG, TIFF, JPEG, EXR, NPY or NPZ with key mask): "
        "bright where the wall is used, black where it is left out.",
    ),
]
BackgroundOption = Annotated[
    list[Path] | None,
    option(
        "FILE",
        "A photograph of the same wall with the monitor off, of the photograph's size; repeatable. "
        "Its light, and what the wall's paint does to it, is projected out.",
        "--background",
    ),
]
MatrixOption = Annotated[
    Path | None, option("FILE", "Take A from this NPY file rather than render it.", "--transport")
]
# More would be hours in one kernel, which nothing can interrupt.
Samples = Annotated[
    int, option("NUMBER", "Samples of a patch for each wall point.", min=1, max=65536)
]
# Mitsuba takes seeds of 32 bits; commands count on from this one.
Seed = Annotated[int, option("NUMBER", "Seed of every random draw.", min=0, max=2**31 - 1)]


def not_nan(value: float | None) -> float | None:
    """Refuse NaN, which the parsers' versions take to be within any bounds, or not."""
    if value is not None and math.isnan(value):
        raise typer.BadParameter("nan is not a number")
    return value


def _decibels(snr: float | None) -> float | None:
    # Not by the option's own bounds: the parsers' versions differ in what they say of NaN.
    if snr is not None and not -100 <= snr <= 300:
        raise typer.BadParameter(f"{snr:g} is not a finite number of dB from -100 to 300")
    return snr


_NOISE = (
    "Gaussian noise at this signal-to-noise ratio, -100 to 300 dB; the signal is the root mean "
    "square of the whole photograph, ambient light included."
)
_snr = option("DB", _NOISE, callback=_decibels)
Snr = Annotated[float, _snr]
OptionalSnr = Annotated[float | None, _snr]


def parse_size(text: str) -> tuple[int, int]:
    """Read ROWSxCOLUMNS."""
    size = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text, re.IGNORECASE)
    if not size:
        raise PeriscopyError(f"'{text}' is not a size; write ROWSxCOLUMNS, such as 29x36")
    return int(size[1]), int(size[2])


def parse_definitions(definitions: list[str] | None, flag: str = "-D") -> dict[str, str]:
    """Read ``-D name=value`` options, or those of another name; each name once."""
    values: dict[str, str] = {}
    for definition in definitions or []:
        name, separator, value = definition.partition("=")
        if not (name and separator and value):
            raise PeriscopyError(f"{flag} '{definition}' is not of the form name=value")
        if name in values:
            raise PeriscopyError(f"{flag} {name} is given twice")
        values[name] = value
    return values


def parse_errors(text: str, flag: str) -> dict[str, float | None]:
    """Read ``NAME[=ERROR],...``: names, each with its error if one is given; each name once."""
    entries = [entry.strip() for entry in text.split(",") if entry.strip()]
    names = [entry.partition("=")[0].strip() for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise PeriscopyError(f"{flag}: '{name}' is named twice")
    alone = {name: None for name, entry in zip(names, entries, strict=True) if "=" not in entry}
    errors = parse_definitions([entry for entry in entries if "=" in entry], flag)
    numbers = parse_numbers({name.strip(): error for name, error in errors.items()}, flag)
    return {name: (alone | numbers)[name] for name in names}


def known_errors(
    named: Mapping[str, float | None], path: Path, given: Mapping[str, str]
) -> dict[str, float]:
    """Return the errors of ``--uncertain``: those given, else those that the scene declares.

    A PeriscopyError says that one is not known, not positive, or contradicts another option.
    """
    from periscopy_sim.calibration.prior import declared_errors, start_values
    from periscopy_sim.rendering.scene.document import RULER_ERROR

    if named:
        start_values(path, list(named), given)
    declared, errors = declared_errors(path, given), {}
    for name, error in named.items():
        ruler = f"{name}{RULER_ERROR}"
        # A ruler's error of 0 says that it stays, and may be uncertain all the same.
        if error is not None and ruler in given and declared.get(name) not in (0, error):
            raise PeriscopyError(
                f"--uncertain {name}={error:g} and -D {ruler}={given[ruler]} contradict each "
                "other; give one of them"
            )
        known = declared.get(name) if error is None else error
        if known is None:
            raise PeriscopyError(
                f"--uncertain {name}: the scene declares no {ruler}; give {name}=ERROR"
            )
        if not (np.isfinite(known) and known > 0):
            raise PeriscopyError(
                f"--uncertain {name}: an error of {known:g}; give a positive number, or leave it "
                "out"
            )
        errors[name] = known
    return errors


def parse_numbers(definitions: Mapping[str, str], flag: str) -> dict[str, float]:
    """Read the numbers of ``NAME=NUMBER`` options."""
    numbers = {}
    for name, text in definitions.items():
        try:
            numbers[name] = float(text)
        except ValueError:
            raise PeriscopyError(f"{flag} {name}={text}: give a number") from None
    return numbers


def require_suffix(out: Path, suffix: str, what: str) -> None:
    """Refuse an --out that does not tell what is written there."""
    if out.suffix != suffix:
        raise OutputError(f"--out {out}: {what} is written as {suffix}; name a file that ends so")


# -- lists ---------------------------------------------------------------------------------------

GROUPS = {"all": REALISTIC, "adversarial": ADVERSARIAL}
"""What ``--ambient`` takes for several shipped lighting conditions."""

SPACINGS: Mapping[str, Callable[..., np.ndarray[tuple[int], np.dtype[np.float64]]]] = {
    "log": np.geomspace,
    "lin": np.linspace,
}
MOST_RATIOS = 1000


def parse_list(option: str, text: str) -> list[str]:
    """Read names separated by commas, each once."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise PeriscopyError(f"{option} '{text}' has an empty name; separate names by one comma")
    _refuse_doubles(option, names)
    return names


def parse_ratios(text: str) -> list[float]:
    """Read signal-to-background ratios: ``0.1,1,10``, or ``0.1:10:log:9`` (``lin``: even steps)."""
    first, *rest = text.split(":")
    try:
        if rest:
            last, spacing, count = rest
            ends, number = (float(first), float(last)), int(count)
            if not (_all_positive(ends) and 1 <= number <= MOST_RATIOS):
                raise ValueError
            ratios = [float(f"{ratio:.6g}") for ratio in SPACINGS[spacing](*ends, number)]
        else:
            ratios = [float(ratio) for ratio in text.split(",")]
        if not _all_positive(ratios):
            raise ValueError
    except (ValueError, KeyError):
        raise PeriscopyError(
            f"--sbr '{text}' is no list of positive ratios; write 0.1,1,10 or 0.1:10:log:9"
        ) from None
    _refuse_doubles("--sbr", [f"{ratio:g}" for ratio in ratios])
    return ratios


def parse_ambient(text: str) -> dict[str, Path | None]:
    """Read lighting conditions: names of shipped ones, groups of them, EXR files and folders.

    Return name to EXR file; None for a shipped condition, which is yet to be rendered.
    """
    found = [light for entry in parse_list("--ambient", text) for light in _lights(entry)]
    _refuse_doubles("--ambient", [name for name, _ in found])
    return dict(found)


def _lights(entry: str) -> list[tuple[str, Path | None]]:
    shipped = (*REALISTIC, *ADVERSARIAL)
    if entry in GROUPS:
        return [(name, None) for name in GROUPS[entry]]
    if entry in shipped:
        return [(entry, None)]
    path = Path(entry)
    if path.is_dir():
        files = sorted(path.glob("*.exr"))
        if not files:
            raise PeriscopyError(f"--ambient {entry}: the folder holds no EXR file")
        return [(file.stem, file) for file in files]
    if path.suffix == ".exr":
        return [(path.stem, path)]
    raise PeriscopyError(
        f"--ambient '{entry}' is no lighting condition; use an EXR file, a folder of them, all, "
        f"adversarial, or {', '.join(shipped)}"
    )


def _all_positive(values: tuple[float, ...] | list[float]) -> bool:
    return all(np.isfinite(value) and value > 0 for value in values)


def _refuse_doubles(option: str, names: list[str]) -> None:
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise PeriscopyError(f"{option} has {', '.join(doubles)} twice; name each once")
