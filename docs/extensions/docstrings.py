"""Docstrings as Sphinx reads them.

A plural such as ``<default>``s ends a literal within a word, which reStructuredText does not take
without a mark that `help` should not have to show.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.util import logging
from sphinx.util.nodes import make_refnode

logger = logging.getLogger(__name__)

FEWEST_WORDS = 4
"""Words of a first sentence; fewer repeat the name."""

ENDS_WITHIN_A_WORD = re.compile(r"(``[^`\n]+``|(?<!`)`[^`\n]+`)(?=\w)")


def mark_ends(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Put the mark where a literal or a name ends within a word."""
    lines[:] = [ENDS_WITHIN_A_WORD.sub(r"\1\\ ", line) for line in lines]


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
    app.connect("missing-reference", by_last_name)
    return {"parallel_read_safe": True}
