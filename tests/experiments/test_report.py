import base64
import json
from html.parser import HTMLParser

import pytest

from experiments.report import (
    Claim,
    Picture,
    Section,
    Table,
    Verdict,
    read_section,
    write_page,
    write_section,
)
from periscopy_sim.errors import OutputError

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


class Page(HTMLParser):
    """What a browser would see: tags with their attributes, and the text of each cell."""

    def __init__(self, source):
        super().__init__()
        self.tags, self.open, self.rows, self.text = [], [], [], []
        self.feed(source)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        self.text.append(data)
        if "td" in self.open or "th" in self.open:
            self.rows[-1][-1] += data

    def attributes(self, name):
        return [attrs[name] for _, attrs in self.tags if name in attrs]


@pytest.fixture
def sections(tmp_path):
    picture = tmp_path / "pictures" / "a.png"
    picture.parent.mkdir()
    picture.write_bytes(PIXEL)
    claims = [
        Claim("cond(A)", "7960", "13000", Verdict.DIFFERS, "the right way up"),
        Claim("PA = I", "yes", "1e-10", Verdict.AGREES),
    ]
    return [
        Section(
            "first",
            "First",
            "Text.",
            claims,
            [Picture(picture, "A caption")],
            [Table("times", ("size", "s"), [("1 x 2", "3.5")])],
            1.25,
        ),
        Section("second", "Second", failure="ValueError: nothing to see"),
    ]


def page_of(path, sections, **settings):
    write_page(path, "A title", sections, **settings)
    return Page(path.read_text("utf-8"))


def test_every_claim_stands_with_its_verdict_linked_to_its_section(tmp_path, sections):
    page = page_of(tmp_path / "index.html", sections)
    row = ["first", "cond(A)", "7960", "13000", "differs", "the right way up"]
    assert page.rows[1] == row
    assert [row[-2] for row in page.rows[1:3]] == ["differs", "agrees"]
    assert row[1:] in page.rows[3:]  # again, within the section
    assert "2 claims: 1 agrees, 1 differs" in page.text


def test_every_link_leads_to_something_on_the_page(tmp_path, sections):
    page = page_of(tmp_path / "index.html", sections, provenance={"numpy": "2"})
    targets = page.attributes("id")
    links = page.attributes("href")
    assert {"#first", "#second"} <= set(links)
    assert all(link.startswith("#") and link[1:] in targets for link in links)
    assert len(targets) == len(set(targets))


def test_the_page_loads_nothing_from_outside(tmp_path, sections):
    path = tmp_path / "index.html"
    page = page_of(path, sections)
    sources = page.attributes("src")
    assert len(sources) == 1
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert base64.b64decode(sources[0].partition(",")[2]) == PIXEL
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    source = path.read_text("utf-8")
    assert "http" not in source and "url(" not in source and "@import" not in source


def test_text_is_shown_as_written_and_never_becomes_markup(tmp_path):
    nasty = '<script>alert("1")</script> & a < b \' "'
    picture = tmp_path / "a.png"
    picture.write_bytes(PIXEL)
    section = Section(
        "name",
        nasty,
        nasty,
        [Claim(nasty, nasty, nasty, Verdict.BETTER, nasty)],
        [Picture(picture, nasty)],
        [Table(nasty, (nasty,), [(nasty,)])],
        failure=nasty,
    )
    path = tmp_path / "index.html"
    write_page(path, nasty, [section], introduction=nasty, provenance={nasty: nasty})
    page = Page(path.read_text("utf-8"))
    assert "script" not in {tag for tag, _ in page.tags}
    assert page.attributes("alt") == [nasty]
    # Title and heading, introduction, section's heading, failure and text, two tables of four
    # claims' cells, picture's and table's caption, header and cell, provenance's two.
    assert sum(nasty in text for text in page.text) == 2 + 1 + 3 + 8 + 1 + 3 + 2


def test_a_section_that_failed_says_so(tmp_path, sections):
    page = page_of(tmp_path / "index.html", sections)
    assert "Failed: ValueError: nothing to see" in page.text
    assert page.text.count("Failed: ValueError: nothing to see") == 1


def test_a_section_comes_back_from_its_file(tmp_path, sections):
    path = tmp_path / "kept" / "first.json"
    write_section(path, sections[0])
    found = read_section(path)
    assert found.seconds == 1.25
    assert found.claims == sections[0].claims
    assert found.claims[0].verdict is Verdict.DIFFERS
    assert found.pictures[0].file.read_bytes() == PIXEL
    first, second = tmp_path / "a.html", tmp_path / "b.html"
    write_page(first, "t", sections[:1])
    write_page(second, "t", [found])
    assert first.read_bytes() == second.read_bytes()


def test_a_kept_section_moves_with_its_folder(tmp_path, sections):
    write_section(tmp_path / "kept" / "first.json", sections[0])
    assert str(tmp_path) not in (tmp_path / "kept" / "first.json").read_text("utf-8")
    new = tmp_path / "new"
    new.mkdir()
    (tmp_path / "kept").rename(new / "kept")
    (tmp_path / "pictures").rename(new / "pictures")
    assert read_section(new / "kept" / "first.json").pictures[0].file.read_bytes() == PIXEL


@pytest.mark.parametrize("damage", ["{", "[]", '{"name": "x"}', "verdict", "field"])
def test_a_damaged_file_is_named(tmp_path, sections, damage):
    path = tmp_path / "first.json"
    write_section(path, sections[0])
    record = json.loads(path.read_text("utf-8"))
    if damage == "verdict":
        record["claims"][0]["verdict"] = "maybe"
        damage = json.dumps(record)
    elif damage == "field":
        damage = json.dumps({**record, "unheard": 1})
    path.write_text(damage, "utf-8")
    with pytest.raises(OutputError, match=r"first\.json: is damaged .*; delete it"):
        read_section(path)


def test_a_missing_picture_is_named(tmp_path, sections):
    path = tmp_path / "first.json"
    write_section(path, sections[0])
    sections[0].pictures[0].file.unlink()
    with pytest.raises(OutputError, match=r"a\.png is missing"):
        read_section(path)
