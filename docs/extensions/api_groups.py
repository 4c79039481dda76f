"""The sidebar of the API groups names as the API's page does: a caption for each section."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx import addnodes

PAGE = "api/index"


def caption(app: Any, doctree: Any) -> None:
    """Give each list of names the title of its section."""
    if app.env.docname != PAGE:
        return
    for section in doctree.findall(nodes.section):
        title = next(iter(section.findall(nodes.title))).astext()
        for child in section.children:
            for tree in () if isinstance(child, nodes.section) else child.findall(addnodes.toctree):
                tree["caption"] = tree["rawcaption"] = title


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", caption, priority=100)  # before Sphinx collects the lists
    return {"parallel_read_safe": True}
