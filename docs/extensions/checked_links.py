"""Every link within the built pages leads somewhere, and no page asks another machine for anything.

Each fault is a warning, which `make docs` does not let pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from sphinx.util import logging

LOADED = {"script": "src", "img": "src", "link": "href", "source": "src", "video": "src"}


class Page(HTMLParser):
    """The links of a page, what it loads, and the places that links may lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element refers to."""
        values = {name: value or "" for name, value in attrs}
        self.places |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        if values.get(LOADED.get(tag, "")):
            self.loaded.add(values[LOADED[tag]])


def faults(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield each page of a folder that has a fault, and the fault."""
    pages = {}
    for file in sorted(folder.rglob("*.html")):
        if "_static" in file.parts:  # a theme's templates
            continue
        pages[file] = Page()
        pages[file].feed(file.read_text("utf-8"))
    places = {file: page.places for file, page in pages.items()}
    for file, page in pages.items():
        for link in sorted(page.loaded):
            if urlsplit(link).netloc:
                yield file, f"it loads {link} from another machine"
        for link in sorted(page.links | page.loaded):
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (file.parent / unquote(url.path)).resolve() if url.path else file
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                yield file, f"its link {link} leads to no file"
            elif url.fragment and unquote(url.fragment) not in places.get(target, {url.fragment}):
                yield file, f"its link {link} leads to no place of that page"


def check(app: Any, exception: Exception | None) -> None:
    """Warn of every fault in the pages; not after a build of some pages alone."""
    if exception is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir).resolve()
    if all((folder / app.builder.get_target_uri(each)).is_file() for each in app.env.found_docs):
        for file, fault in faults(folder):
            logging.getLogger(__name__).warning("%s: %s", file.relative_to(folder), fault)


def unresolved(app: Any, env: Any, node: Any, content: Any) -> None:
    """Warn of a page's link to a name that the package does not have.

    Docstrings name things that are not public, too, which are no links then.
    """
    page = node.get("refdoc", "")
    if node.get("refdomain") == "py" and not page.startswith("api/"):
        logging.getLogger(__name__).warning("no public name %s", node["reftarget"], location=node)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("build-finished", check, priority=900)
    app.connect("missing-reference", unresolved, priority=900)
    return {"parallel_read_safe": True}
