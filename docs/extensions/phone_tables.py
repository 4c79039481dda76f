"""Tables of text are marked, so that `look.css` stacks their cells on a narrow screen.

Tables of numbers keep their columns and scroll.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes

MOST_COLUMNS = 3
SENTENCE = 24
"""Characters of a cell that no number has."""


def mark(app: Any, doctree: Any) -> None:
    """Mark the tables of few columns, one of whose last cells is a sentence."""
    for table in doctree.findall(nodes.table):
        rows = [row.children for body in table.findall(nodes.tbody) for row in body.children]
        few = all(len(cells) <= MOST_COLUMNS for cells in rows)
        if few and any(len(cells[-1].astext()) >= SENTENCE for cells in rows):
            table["classes"].append("stacks")


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True}
