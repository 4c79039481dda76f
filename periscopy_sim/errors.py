"""What a user can fix: each error says what is wrong, where, and what would fix it.

Any other error, a library's ValueError too, is a defect of the package.
"""

from collections.abc import Iterable

_LONGEST = 900
"""Characters of a message; it may quote what a damaged or hostile file holds."""


class PeriscopyError(ValueError):
    """A mistake in what the user gave; the command line prints it as one line and exits with 2."""

    def __str__(self) -> str:
        """Message as one line: what cannot be printed spelled out, a long middle left out."""
        line = "".join(
            letter if letter.isprintable() else letter.encode("unicode_escape").decode()
            for letter in " ".join(super().__str__().split())
        )
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


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the question for what is most like an unknown name; empty where nothing is."""
    from difflib import get_close_matches

    near = get_close_matches(name.lower(), names := {each.lower(): each for each in known}, 1)
    return f"did you mean '{names[near[0]]}'?" if near else ""
