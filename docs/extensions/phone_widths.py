"""Widths of figures, names and numbers, for pages from a phone's width to a desk's.

A figure shows larger than it prints, up to a limit; a narrow screen shrinks it. `look.css` breaks
the names that are marked as longer than a phone's line. No line ends between a number
and its unit, or within a date.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from PIL import Image

PIXELS, MOST = 160, 720
"""Pixels of the page for an inch of print, and in all."""
LONG = 32
"""Characters of a word that may not fit into a phone's line."""
UNIT = re.compile(r"(?<=\d) (?=(%|dB|[cmk]?m|m?s|[kMGT]B)(\W|$))")
"""The space before a unit."""
DATE = re.compile(r"(?<=\d\d)-(?=\d\d)")
"""The hyphen within a date."""


def mark(app: Any, doctree: Any) -> None:
    """Set the width of figures that state their inches, mark long literals, bind units."""
    for image in doctree.findall(nodes.image):
        file = Path(app.srcdir) / image["uri"]
        if "width" not in image and file.suffix == ".png" and file.is_file():
            with Image.open(file) as picture:
                if "dpi" in picture.info:
                    inches = picture.width / picture.info["dpi"][0]
                    image["width"] = f"{min(MOST, round(PIXELS * inches))}px"
    for literal in doctree.findall(nodes.literal):
        if max(map(len, literal.astext().split()), default=0) >= LONG:
            literal["classes"].append("long")
    for text in list(doctree.findall(nodes.Text)):
        if not isinstance(text.parent, nodes.literal | nodes.literal_block):
            bound = DATE.sub("\N{NON-BREAKING HYPHEN}", UNIT.sub("\N{NO-BREAK SPACE}", text))
            text.parent.replace(text, nodes.Text(bound))


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True}
