"""Docstrings as Sphinx reads them.

A plural such as ``<default>``s ends a literal within a word, which reStructuredText does not take
without a mark that `help` should not have to show.
"""

from __future__ import annotations

import re
from typing import Any

ENDS_WITHIN_A_WORD = re.compile(r"(``[^`\n]+``|(?<!`)`[^`\n]+`)(?=\w)")


def mark_ends(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Put the mark where a literal or a name ends within a word."""
    lines[:] = [ENDS_WITHIN_A_WORD.sub(r"\1\\ ", line) for line in lines]


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("autodoc-process-docstring", mark_ends)
    return {"parallel_read_safe": True}
