"""Reports: claims beside what was measured, with figures and tables, as one HTML page."""

from __future__ import annotations

import base64
import html
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

from pydantic import TypeAdapter

from periscopy_sim.storage.outputs.staging import staged_file


class Verdict(StrEnum):
    """How a measured figure stands to the claim."""

    AGREES = "agrees"
    BETTER = "better"
    DIFFERS = "differs"
    MEASURED = "measured"
    """No value was stated."""

    @classmethod
    def of(cls, agrees: bool) -> Verdict:
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
    with staged_file(path) as file:
        lines = _page(title, sections, introduction, provenance or {}, stated)
        file.write_text("\n".join(lines), "utf-8")


def _page(
    title: str,
    sections: Sequence[Section],
    introduction: str,
    provenance: Mapping[str, str],
    stated: str,
) -> Iterator[str]:
    heading, columns = html.escape(title), ("what", stated, "here", "verdict", "why")
    yield '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
    yield f"<title>{heading}</title>"
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{_STYLE}</style></head><body><main><h1>{heading}</h1>"
    yield f"<p>{html.escape(introduction)}</p>"
    yield "<nav>" + " · ".join(map(_cell, sections)) + "</nav>"
    count = Counter(claim.verdict for section in sections for claim in section.claims)
    if count:
        verdicts = ", ".join(f"{count[verdict]} {verdict}" for verdict in Verdict if count[verdict])
        yield f"<h2>{count.total()} claims: {verdicts}</h2>"
        rows = [(each, *_cells(claim)) for each in sections for claim in each.claims]
        yield from _table("", ("where", *columns), rows)
    for section in sections:
        yield f'<section id="{html.escape(section.name)}"><h2>{html.escape(section.title)}</h2>'
        if section.failure:
            yield f'<p class="failure">Failed: {html.escape(section.failure)}</p>'
        yield f"<p>{html.escape(section.text)}</p>"
        for picture in section.pictures:
            png = base64.b64encode(picture.file.read_bytes()).decode("ascii")
            caption = html.escape(picture.caption)
            yield f'<figure><img alt="{caption}" src="data:image/png;base64,{png}">'
            yield f"<figcaption>{caption}</figcaption></figure>"
        for table in section.tables:
            yield from _table(table.caption, table.header, table.rows)
        if section.claims:
            yield from _table("", columns, [_cells(claim) for claim in section.claims])
        yield f'<p class="time">{html.escape(section.took)}</p></section>'
    if provenance:
        yield '<section id="provenance"><h2>Provenance</h2>'
        yield from _table("", (), [*provenance.items()])
        yield "</section>"
    yield "</main></body></html>\n"


def _cells(claim: Claim) -> tuple[str, ...]:
    return claim.what, claim.stated, claim.measured, claim.verdict, claim.reason


def _table(
    caption: str, header: Sequence[str], rows: Sequence[Sequence[str | Section]]
) -> Iterator[str]:
    yield '<div class="scroll"><table>'
    yield f"<caption>{html.escape(caption)}</caption>" if caption else ""
    if header:
        yield "<thead><tr>" + "".join(f"<th>{_cell(name)}</th>" for name in header)
        yield "</tr></thead>"
    yield "<tbody>"
    for row in rows:
        yield "<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>"
    yield "</tbody></table></div>"


def _cell(cell: str | Section) -> str:
    """Return a text, a verdict with its colour, or the link to a section."""
    if isinstance(cell, Section):
        return f'<a href="#{html.escape(cell.name)}">{html.escape(cell.name)}</a>'
    if isinstance(cell, Verdict):
        return f'<span class="{cell}">{cell}</span>'
    return html.escape(cell)


_STYLE = """
body { margin: 0; background: #fff; color: #1a1a1a;
  font: 16px/1.5 "Source Sans 3", "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.2rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; } h2 { font-size: 1.3rem; margin-top: 2.6rem; }
section { border-top: 1px solid #ddd; }
figure { margin: 1.4rem 0; } img { max-width: 100%; height: auto; }
figcaption, caption { color: #555; font-size: .92rem; text-align: left; padding: .4rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .92rem;
  font-variant-numeric: tabular-nums; }
th { text-align: left; border-bottom: 2px solid #888; } td { border-bottom: 1px solid #e4e4e4; }
th, td { padding: .3rem .7rem .3rem 0; vertical-align: top; }
span.agrees, span.better, span.differs { padding: 0 .5em; border-radius: .8em; }
span.agrees { background: #d5ecf8; } span.better { background: #cdeadf; }
span.differs { background: #fbe3c0; }
.failure { background: #fbe3c0; padding: .5rem .8rem; overflow-wrap: anywhere; }
.time { color: #777; font-size: .9rem; }
"""
