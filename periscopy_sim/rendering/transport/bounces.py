"""How many times the monitor's light is reflected at most: a number, None for any, and its words.

1 is light that goes straight from the monitor to the wall, and from there to the camera.
"""

from __future__ import annotations

import operator

DIRECT = 1
"""Reflections of light that goes from the monitor to the wall and to the camera."""

MOST_BOUNCES = 10**6

WORDS = {"direct": DIRECT, "all": None}


def check_bounces(bounces: int | None) -> int | None:
    """Return the number of reflections, or None for any; a ValueError says that it is none."""
    if bounces is None:
        return None
    try:
        count = operator.index(bounces)
    except TypeError:
        count = 0
    if isinstance(bounces, bool) or not DIRECT <= count <= MOST_BOUNCES:
        raise ValueError(
            f"bounces {bounces!r}: give a whole number from 1, light that the wall alone reflects, "
            f"to {MOST_BOUNCES}, or None for any number"
        )
    return count


def bounces_in_words(bounces: int | None) -> str:
    """Return how records and commands name a number of reflections: direct, all, or how many."""
    return next((word for word, count in WORDS.items() if count == bounces), str(bounces))


def bounces_of_words(text: str) -> int | None:
    """Return the number of reflections that `bounces_in_words` names, or raise a ValueError."""
    if text in WORDS:
        return WORDS[text]
    if not (text.isascii() and text.isdigit() and DIRECT <= int(text) <= MOST_BOUNCES):
        raise ValueError(f"'{text}': give direct, all, or a whole number from 1 on")
    return int(text)
