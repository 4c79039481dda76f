"""Reports: claims beside what was measured, with figures and tables, as one HTML page."""

from __future__ import annotations

import base64
import html
import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path

from periscopy_sim.errors import OutputError
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
    """One statement and what was found.

    Attributes
    ----------
    what
        What is stated.
    stated, measured
        The two values, with their units.
    verdict
        How they stand to each other.
    reason
        Why they differ, or how it was measured.
    """

    what: str
    stated: str
    measured: str
    verdict: Verdict
    reason: str = ""


@dataclass(frozen=True)
class Picture:
    """A PNG file and its caption."""

    file: Path
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header.

    Attributes
    ----------
    caption
        What the table shows, with the units.
    header
        Names of the columns.
    rows
        As many cells each.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """One figure, table or passage of a paper, reproduced.

    Attributes
    ----------
    name
        Short, such as ``fig4``; the anchor in the page.
    title
        Its heading.
    text
        What was done, in a few sentences.
    claims, pictures, tables
        What is shown below it.
    seconds, processor_seconds
        Time it took, and that of all processors together; None if not measured.
    failure
        Why there is nothing to show, if so.
    made_from
        Digest of the code and the inputs.
    """

    name: str
    title: str
    text: str = ""
    claims: Sequence[Claim] = ()
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    seconds: float | None = field(default=None, compare=False)
    processor_seconds: float | None = field(default=None, compare=False)
    failure: str = ""
    made_from: str = field(default="", compare=False)


def write_section(path: Path, section: Section) -> None:
    """Keep a section as JSON; its pictures are named relative to the file's folder.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    record = asdict(section)
    for picture in record["pictures"]:
        picture["file"] = Path(os.path.relpath(picture["file"], path.parent)).as_posix()
    with staged_file(path) as file:
        file.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n", "utf-8")


def read_section(path: Path) -> Section:
    """Read what `write_section` kept.

    Raises
    ------
    OutputError
        If the file is damaged, or a picture is missing.
    """
    try:
        record = json.loads(path.read_text("utf-8"))
        pictures = [
            Picture(path.parent / picture["file"], picture["caption"])
            for picture in record.pop("pictures")
        ]
        claims = [
            Claim(**{**claim, "verdict": Verdict(claim["verdict"])})
            for claim in record.pop("claims")
        ]
        tables = [Table(**table) for table in record.pop("tables")]
        section = Section(pictures=pictures, claims=claims, tables=tables, **record)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"{path}: is damaged ({error}); delete it and run it again") from error
    missing = [str(picture.file) for picture in pictures if not picture.file.is_file()]
    if missing:
        raise OutputError(
            f"{path}: its picture {missing[0]} is missing; delete it and run it again"
        )
    return section


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

    Links to the sections and a table of every claim stand first.

    Parameters
    ----------
    path
        The HTML file.
    title
        Heading of the page.
    sections
        In the order shown.
    introduction
        A paragraph above.
    provenance
        Versions, seed and command, listed at the end.
    stated
        Heading of the claims' first values: who states them.

    Raises
    ------
    OutputError
        If the file cannot be written.
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
    yield '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
    yield f"<title>{_text(title)}</title>"
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{_STYLE}</style></head><body><main><h1>{_text(title)}</h1>"
    yield f"<p>{_text(introduction)}</p>" if introduction else ""
    yield "<nav>" + " · ".join(_link(section) for section in sections) + "</nav>"
    claims = [(section, claim) for section in sections for claim in section.claims]
    if claims:
        count = Counter(claim.verdict for _, claim in claims)
        verdicts = ", ".join(f"{count[verdict]} {verdict}" for verdict in Verdict if count[verdict])
        yield f"<h2>{len(claims)} claims: {verdicts}</h2>"
        yield from _claims(claims, stated)
    for section in sections:
        yield f'<section id="{_text(section.name)}"><h2>{_text(section.title)}</h2>'
        yield f'<p class="failure">Failed: {_text(section.failure)}</p>' if section.failure else ""
        yield f"<p>{_text(section.text)}</p>" if section.text else ""
        for picture in section.pictures:
            yield from _figure(picture)
        for table in section.tables:
            yield from _table(table)
        if section.claims:
            yield from _claims([(None, claim) for claim in section.claims], stated)
        if section.seconds is not None:
            work = section.processor_seconds
            processors = "" if work is None else f", {work:.1f} s of processors' time"
            yield f'<p class="time">{section.seconds:.1f} s{processors}</p>'
        yield "</section>"
    if provenance:
        yield '<section id="provenance"><h2>Provenance</h2>'
        yield from _table(Table("", (), [(name, value) for name, value in provenance.items()]))
        yield "</section>"
    yield "</main></body></html>\n"


def _claims(claims: Sequence[tuple[Section | None, Claim]], stated: str) -> Iterator[str]:
    linked = any(section for section, _ in claims)
    columns = [*(["where"] if linked else []), "what", stated, "here", "verdict", "why"]
    yield '<div class="scroll"><table class="claims"><thead><tr>'
    yield "".join(f"<th>{_text(name)}</th>" for name in columns)
    yield "</tr></thead><tbody>"
    for section, claim in claims:
        where = f"<td>{_link(section)}</td>" if section else ""
        yield (
            f"<tr>{where}<td>{_text(claim.what)}</td><td>{_text(claim.stated)}</td>"
            f"<td>{_text(claim.measured)}</td>"
            f'<td><span class="{claim.verdict}">{claim.verdict}</span></td>'
            f"<td>{_text(claim.reason)}</td></tr>"
        )
    yield "</tbody></table></div>"


def _table(table: Table) -> Iterator[str]:
    yield '<div class="scroll"><table>'
    yield f"<caption>{_text(table.caption)}</caption>" if table.caption else ""
    if table.header:
        yield "<thead><tr>" + "".join(f"<th>{_text(name)}</th>" for name in table.header)
        yield "</tr></thead>"
    yield "<tbody>"
    for row in table.rows:
        yield "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>"
    yield "</tbody></table></div>"


def _figure(picture: Picture) -> Iterator[str]:
    encoded = base64.b64encode(picture.file.read_bytes()).decode("ascii")
    yield (
        f'<figure><img alt="{_text(picture.caption)}" src="data:image/png;base64,{encoded}">'
        f"<figcaption>{_text(picture.caption)}</figcaption></figure>"
    )


def _link(section: Section) -> str:
    return f'<a href="#{_text(section.name)}">{_text(section.name)}</a>'


def _text(text: str) -> str:
    return html.escape(text)


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
.claims td:nth-last-child(1) { min-width: 16rem; }
span.agrees, span.better, span.differs { padding: 0 .5em; border-radius: .8em; }
span.agrees { background: #d5ecf8; } span.better { background: #cdeadf; }
span.differs { background: #fbe3c0; }
.failure { background: #fbe3c0; padding: .5rem .8rem; overflow-wrap: anywhere; }
.time { color: #777; font-size: .9rem; }
"""
