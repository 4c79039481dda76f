"""What a sweep varies, as it is written on the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

GROUPS = {"all": REALISTIC, "adversarial": ADVERSARIAL}
"""What ``--ambient`` takes for several shipped lighting conditions."""

SPACINGS: Mapping[str, Callable[..., np.ndarray[tuple[int], np.dtype[np.float64]]]] = {
    "log": np.geomspace,
    "lin": np.linspace,
}
MOST_RATIOS = 1000


def parse_list(option: str, text: str) -> list[str]:
    """Read names separated by commas.

    Raises
    ------
    PeriscopyError
        If one is empty or given twice.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise PeriscopyError(f"{option} '{text}' has an empty name; separate names by one comma")
    _refuse_doubles(option, names)
    return names


def parse_ratios(text: str) -> list[float]:
    """Read signal-to-background ratios: ``0.1,1,10``, or ``0.1:10:log:9`` (``lin``: even steps).

    Raises
    ------
    PeriscopyError
        If the text is of another form, or a ratio is not positive or given twice.
    """
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

    Returns
    -------
    dict
        Name to EXR file; None for a shipped condition, which is yet to be rendered.

    Raises
    ------
    PeriscopyError
        If there is no such condition, file or EXR file in a folder, or a name is given twice.
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
