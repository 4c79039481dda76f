"""What a user can fix: each error says what is wrong, where, and what would fix it.

Any other error, a library's ValueError too, is a defect of the package. An extra that is not
installed is such an error, too: `require` imports its libraries where they are needed.
"""

import os
import re
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from typing import Any

_URL = re.compile(r"(?:^|[:=,])[A-Za-z][A-Za-z0-9+.-]+:[/\\]")
"""A URL, alone or in a list, or what `Path` makes of it: one slash. A drive has a single letter."""

_LONGEST = 900
"""Characters of a message; it may quote what a damaged or hostile file holds."""


def printable(text: str) -> str:
    """Return text whose control characters, which a terminal would obey, are spelled out."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )


class PeriscopyError(ValueError):
    """A mistake in what the user gave; the command line prints it as one line and exits with 2."""

    def __str__(self) -> str:
        """Message as one line: what cannot be printed spelled out, a long middle left out."""
        line = printable(" ".join(super().__str__().split()))
        half = _LONGEST // 2
        return line if len(line) <= _LONGEST else f"{line[:half]} ... {line[-half:]}"


class SceneError(PeriscopyError):
    """A scene file that breaks the id contract or that a model cannot treat."""


class ClosedFormError(SceneError):
    """A scene has no closed form; rays treat it as it is."""


class PhotographError(PeriscopyError):
    """A photograph or an image that cannot be read or does not fit the scene."""


class OutputError(PeriscopyError):
    """An output path that cannot be written."""


class VariantError(PeriscopyError):
    """A Mitsuba variant that does not exist or does not work on this machine."""


class ConfigurationError(PeriscopyError):
    """A configuration file that cannot be read or asks for what does not exist."""


class DatasetError(PeriscopyError):
    """An archive that is not a data set, or not a whole one."""


_WORDS = {
    r"Input should be a valid integer.*": "write a whole number",
    r"Input should be a valid number.*": "write a number",
    r"Input should be a valid boolean.*": "write true or false",
    r"Input should be a valid string.*": "write a text",
    r"Input should be a valid (tuple|list).*": "write a list",
    r"Input should be a valid (dict|mapping).*": "write entries below it",
    r"Input should be greater than or equal to (.*)": r"give at least \1",
    r"Input should be less than or equal to (.*)": r"give at most \1",
    r"Input should be (greater|less) than (.*)": r"give a number \1 than \2",
    r"Input should be ": "write ",
    r"Input tag ('.*') found using '(\w+)' does not match any of the expected tags: (.*)":
        r"\2 \1 is unknown; there are \3",
    r"Unable to extract tag using discriminator '(\w+)'": r"'\1' is missing",
    r"Tuple should have at least (\d+) items? after validation.*": r"give at least \1 of them",
    r"Field required": "is missing",
    r"Value error, ": "",
}  # fmt: skip
"""What the validators of options and YAML say, and what it means."""


def in_words(message: str) -> str:
    """Return a validator's message as an instruction."""
    for form, words in _WORDS.items():
        message = re.sub(form, words, message)
    return message


LIKE = 0.5
"""Likeness, difflib's ratio, from which on a name may be meant by another."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the question for the known name most like another; empty where none is."""
    by_lower = {each.lower(): each for each in known}
    nearest = get_close_matches(name.lower(), by_lower, 1, LIKE)
    return f"did you mean '{by_lower[nearest[0]]}'?" if nearest else ""


def path_fault(path: str | os.PathLike[str]) -> str:
    """Return why no file can be read or written by this path, in words that follow it; or none.

    Libraries differ in what they make of a URL, and of a name that is no UTF-8.
    """
    text = os.fspath(path)
    if _URL.search(text):
        return "is a URL; name a path on this machine"
    is_utf8 = text.encode("utf-8", "replace").decode() == text
    return "" if is_utf8 else "has a name that is no UTF-8; rename it"


SWEEP = ("xarray", "zarr", "google_crc32c", "distributed", "cloudpickle", "skimage")
EXTRA_OF = {
    **dict.fromkeys(SWEEP, "sweep"),
    "upath": "s3",
    "rawpy": "raw",
    "cv2": "tags",
    "torch": "torch",
    "deepinv": "deepinv",
    "websockets": "live",
    "av": "video",
    "h5py": "published",
}
"""The extra that brings each library."""


def installation(*extras: str) -> str:
    """Return the command that installs extras: `periscopy` on PyPI is another project."""
    return f"in a copy of the repository: pip install -e '.[{','.join(extras)}]'"


def missing(*modules: str) -> str:
    """Return one line that says which extras bring modules."""
    are = "are" if modules[1:] else "is"
    extras = dict.fromkeys(EXTRA_OF[module] for module in modules)
    return f"this needs {', '.join(modules)}, which {are} not installed; {installation(*extras)}"


def require_all(*modules: str) -> None:
    """Raise a PeriscopyError that names all modules that are not installed; none is imported."""
    if lacking := [module for module in modules if find_spec(module) is None]:
        raise PeriscopyError(missing(*lacking))


def require(module: str) -> Any:
    """Import a library that an extra brings; a PeriscopyError says how to install it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise PeriscopyError(missing(module)) from None
