"""Docstrings as Sphinx reads them.

A plural such as ``<default>``s ends a literal within a word, which reStructuredText does not take
without a mark that `help` should not have to show. Of attributes that share a line, as ``a, b``,
Sphinx would take the first for the type of the second.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

logger = logging.getLogger(__name__)

FEWEST_WORDS = 4
"""Words of a first sentence; fewer repeat the name."""

LITERAL = re.compile(r"(``[^`\n]+``|`[^`\n]+`)(\w?)")
SHARED = re.compile(r"^:ivar \w+(, \w+)+:")
JOINT = "\N{ZERO WIDTH SPACE}"
"""Space between attributes until Sphinx has read the type."""


def mark_ends(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Put the mark where a literal or a name ends within a word."""

    def marked(match: re.Match[str]) -> str:
        return match[1] + (f"\\ {match[2]}" if match[2] else "")

    lines[:] = [LITERAL.sub(marked, line) for line in lines]


def join_names(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Leave no space between attributes that share a line."""
    lines[:] = [
        SHARED.sub(lambda names: names[0].replace(", ", f",{JOINT}"), line) for line in lines
    ]


def split_names(app: Any, doctree: Any) -> None:
    """Show the attributes that share a line with spaces between them."""
    for text in list(doctree.findall(nodes.Text)):
        if JOINT in text:
            text.parent.replace(text, nodes.Text(text.replace(JOINT, " ")))


def check(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Warn of a page whose first sentence says nothing."""
    if what not in ("class", "function"):
        return
    first = " ".join(lines[: lines.index("")] if "" in lines else lines)
    if len(first.split()) < FEWEST_WORDS or not first.endswith((".", ":")):
        logger.warning("%s: its first line is no whole sentence: %s", name, first)


def by_last_name(app: Any, env: Any, node: Any, content: Any) -> Any:
    """Resolve a name of the package that is given without its module, if there is one such."""
    if node.get("refdomain") != "py":
        return None
    domain, target = env.get_domain("py"), f".{node['reftarget']}"
    found = [name for name in domain.objects if name.endswith(target)]
    if len(found) != 1:
        return None
    place = domain.objects[found[0]]
    return make_refnode(app.builder, node["refdoc"], place.docname, place.node_id, content)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("autodoc-process-docstring", check, priority=0)  # as written, before napoleon
    app.connect("autodoc-process-docstring", mark_ends)
    app.connect("autodoc-process-docstring", join_names, priority=900)  # after napoleon
    app.connect("doctree-read", split_names)
    app.connect("missing-reference", by_last_name)
    return {"parallel_read_safe": True}
