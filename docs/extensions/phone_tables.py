"""Tables of text are marked, so that `look.css` stacks their cells on a narrow screen.

There each cell begins with the title of its column, if the table has more than two. Tables of
numbers keep their columns and scroll; their short cells keep to one line.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes

MOST_COLUMNS = 3
SENTENCE = 24
"""Characters of a last cell that no number has."""
SHORT = 14
"""Characters of a cell that needs no second line."""


def mark(app: Any, doctree: Any) -> None:
    """Mark the tables of few columns that have a sentence, and the short cells of all others."""
    for table in doctree.findall(nodes.table):
        rows = [row.children for body in table.findall(nodes.tbody) for row in body.children]
        few = all(len(cells) <= MOST_COLUMNS for cells in rows)
        lengths = [[len(cell.astext()) for cell in cells] for cells in rows]
        if few and any(each[-1] >= SENTENCE or max(each) >= 2 * SENTENCE for each in lengths):
            table["classes"].append("stacks")
            titles = [each.astext() for head in table.findall(nodes.thead) for each in head[0]]
            for cells in rows if len(titles) > 2 else ():
                for title, cell in list(zip(titles, cells, strict=True))[1:]:
                    if not cell.astext():
                        cell["classes"].append("empty")
                    elif title:
                        cell[0].insert(0, nodes.inline(text=f"{title}: ", classes=["title"]))
            continue
        for cell in table.findall(nodes.entry):
            length = len(cell.astext())
            cell["classes"] += ["short"] * (length <= SHORT) + ["long"] * (length >= SENTENCE)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True}
