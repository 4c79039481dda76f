"""Numbers and ways to A as people write and read them."""

from collections.abc import Mapping
from typing import Literal

from periscopy_sim.numerics.limits import RANGES, in_range
from periscopy_sim.numerics.validation import InputError

WORDS = {"direct": 1, "all": None}
"""Most reflections of a path, by the words of options and records."""

WAYS: Mapping[str, Literal["areas", "rays"]] = {"analytic": "areas", "rendered": "rays"}
"""Ways to A, by the same."""


def bounces_in_words(bounces: int | None) -> str:
    """Return how records and commands name a number of reflections: direct, all, or how many."""
    return next((word for word, count in WORDS.items() if count == bounces), str(bounces))


def bounces_of_words(text: str) -> int | None:
    """Return the number of reflections that `bounces_in_words` names, or raise an InputError."""
    is_whole = text.isascii() and text.isdecimal()
    if text not in WORDS and not (is_whole and in_range("bounces", float(text))):
        ends = "{} to {}".format(*RANGES["bounces"])
        raise InputError(f"'{text}': give direct, all, or a whole number from {ends}")
    return WORDS[text] if text in WORDS else int(text)


def percentages(first: float, second: float, most: int = 4) -> tuple[str, str]:
    """Return two fractions in percent with two digits, or with as many as differ, at most `most`.

    Equal values have two digits.
    """
    for digits in (*range(2, most + 1), 2):
        one, other = f"{100 * first:.{digits}f}", f"{100 * second:.{digits}f}"
        if one != other:
            break
    return one, other


def with_error(value: float, error: float, unit: str = "") -> str:
    """Return a value, its standard error, which has two digits, and their unit, if any."""
    digits = max(0, 1 - int(f"{error:e}".partition("e")[2]))
    return f"{value:z.{digits}f} ± {error:.{digits}f} {unit}".rstrip()
