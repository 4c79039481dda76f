"""Reports: claims beside what was measured, with figures and tables, as one HTML page."""

import os
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

from jinja2 import Environment, FileSystemLoader
from pydantic import TypeAdapter

from periscopy_sim.storage.outputs import staged_file


class Verdict(StrEnum):
    """How a measured figure stands to the claim."""

    AGREES = "agrees"
    BETTER = "better"
    DIFFERS = "differs"
    MEASURED = "measured"
    """No value was stated."""

    @classmethod
    def of(cls, agrees: bool) -> "Verdict":
        """Return whether the two agree, as a verdict."""
        return cls.AGREES if agrees else cls.DIFFERS


@dataclass(frozen=True)
class Claim:
    """One statement beside its measurement."""

    what: str
    stated: str  # with its unit, as the next
    measured: str
    verdict: Verdict
    reason: str = ""  # why the two differ, or how it was measured


@dataclass(frozen=True)
class Picture:
    """A PNG file and its caption."""

    file: Path
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header."""

    caption: str  # with the units
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """One figure, table or passage of a paper, reproduced."""

    name: str  # short, such as ``fig4``; the anchor in the page
    title: str
    text: str = ""  # what was done, in a few sentences
    claims: Sequence[Claim] = ()
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    took: str = field(default="", compare=False)  # its time, in words
    failure: str = ""  # why there is nothing to show, if so
    made_from: str = field(default="", compare=False)  # digest of the code and the inputs


_SECTION = TypeAdapter(Section)


def write_section(path: Path, section: Section) -> None:
    """Keep a section as JSON, its pictures by their places from the file's folder."""
    pictures = [
        replace(p, file=Path(os.path.relpath(p.file, path.parent))) for p in section.pictures
    ]
    with staged_file(path) as file:
        file.write_bytes(_SECTION.dump_json(replace(section, pictures=pictures), indent=2))


def read_section(path: Path) -> Section | None:
    """Return what `write_section` kept; None if it, or a picture, is missing or damaged."""
    try:
        section = _SECTION.validate_json(path.read_bytes())
    except (OSError, ValueError):
        return None
    pictures = [replace(p, file=path.parent / p.file) for p in section.pictures]
    is_whole = all(picture.file.is_file() for picture in pictures)
    return replace(section, pictures=pictures) if is_whole else None


def write_page(
    path: Path,
    title: str,
    sections: Sequence[Section],
    *,
    introduction: str = "",
    provenance: Mapping[str, str] | None = None,
    stated: str = "paper",
) -> None:
    """Write sections as one HTML page that holds its pictures and needs nothing outside.

    Links to the sections and a table of every claim stand first, the provenance last. `stated` is
    the heading of the claims' first values: who states them.
    """
    count = Counter(claim.verdict for section in sections for claim in section.claims)
    verdicts = ", ".join(f"{count[verdict]} {verdict}" for verdict in Verdict if count[verdict])
    template = _TEMPLATES.get_template("page.html.jinja")
    with staged_file(path) as file:
        text = template.render(
            title=title,
            introduction=introduction,
            sections=sections,
            stated=stated,
            verdicts=f"{count.total()} claims: {verdicts}" if count else "",
            provenance=provenance,
        )
        file.write_text(text, "utf-8")


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True
)
_TEMPLATES.filters["base64"] = lambda file: b64encode(file.read_bytes()).decode("ascii")
# Of a PNG of 300 pixels an inch: 160 pixels of the page for an inch of print.
_TEMPLATES.filters["width"] = lambda file: int.from_bytes(file.read_bytes()[16:20]) * 160 // 300
