"""Pages that lie elsewhere in the repository become pages of the documentation.

Their files stay where code hosts show them, and so do the links to them: a copy is made for the
build, and every link between such files is turned into one between pages. A link to a script of
the gallery leads to its page.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

LINK = re.compile(r'(?:(?<=\]\()|(?<=<img src="))(?!https?:)([^)#\s"]+)')
FOLDER = "repository"


def relinked(text: str, file: Path, page: Path, pages: dict[Path, Path]) -> str:
    """Return a file's text with its links as they are to be seen from a page.

    Parameters
    ----------
    text
        Markdown.
    file
        Where it lies in the repository: what its links start from.
    page
        Where the documentation has it.
    pages
        Files of the repository to the pages made of them.
    """

    def moved(match: re.Match[str]) -> str:
        target = (file.parent / match[1]).resolve()
        return Path(os.path.relpath(pages.get(target, target), page.parent)).as_posix()

    return LINK.sub(moved, text)


def copy_pages(app: Any, config: Any) -> None:
    """Write a copy of each page that lies outside of the sources."""
    source, root = Path(app.srcdir), Path(app.srcdir).parent
    app.repository_pages = pages = {
        root / file: source / ("" if name == "index" else FOLDER) / f"{name}.md"
        for file, name in config.pages_of_the_repository.items()
    }
    (source / FOLDER).mkdir(exist_ok=True)
    for file, page in pages.items():
        # The front page is one of its own, which includes README.
        copy = source / FOLDER / "readme.txt" if page.parent == source else page
        text = relinked(file.read_text("utf-8"), file, page, pages)
        if not copy.is_file() or copy.read_text("utf-8") != text:
            copy.write_text(text, "utf-8")
    for script in (root / "examples").rglob("*.py"):
        place = script.relative_to(root / "examples").with_suffix(".rst")
        pages[script] = source / "gallery" / place


def follow_pages(app: Any, name: str, content: list[str]) -> None:
    """Turn a page's links to files outside of the sources into links to their pages."""
    page = Path(app.env.doc2path(name))
    if page.suffix == ".md" and FOLDER not in name.split("/"):
        content[0] = relinked(content[0], page, page, app.repository_pages)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_config_value("pages_of_the_repository", {}, "env", dict)
    app.connect("config-inited", copy_pages, priority=400)
    app.connect("source-read", follow_pages)
    return {"parallel_read_safe": True}
