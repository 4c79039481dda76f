import base64
from html.parser import HTMLParser

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

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


class Page(HTMLParser):
    """Tags with their attributes, and the texts between them."""

    def __init__(self, source):
        super().__init__()
        self.tags, self.text = [], []
        self.feed(source)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def attributes(self, name):
        return [attrs[name] for _, attrs in self.tags if name in attrs]


def test_text_is_shown_as_written_and_never_becomes_markup(tmp_path):
    nasty = '<script>alert("1")</script> & a < b \' "'
    (tmp_path / "a.png").write_bytes(PIXEL)
    section = Section(
        "name",
        nasty,
        nasty,
        [Claim(nasty, nasty, nasty, Verdict.BETTER, nasty)],
        [Picture(tmp_path / "a.png", nasty)],
        [Table(nasty, (nasty,), [(nasty,)])],
        failure=nasty,
    )
    path = tmp_path / "index.html"
    write_page(path, nasty, [section], introduction=nasty, provenance={nasty: nasty})
    page = Page(path.read_text("utf-8"))
    assert "script" not in {tag for tag, _ in page.tags}
    assert page.attributes("alt") == [nasty]
    source = path.read_text("utf-8")
    assert "http" not in source and "url(" not in source and "@import" not in source
    # Title and heading, introduction, section's heading, failure and text, two tables of four
    # claims' cells, picture's and table's caption, header and cell, provenance's two.
    assert sum(nasty in text for text in page.text) == 2 + 1 + 3 + 8 + 1 + 3 + 2


def test_a_section_comes_back_from_its_file_also_where_its_folder_moved(tmp_path):
    picture = tmp_path / "pictures" / "a.png"
    picture.parent.mkdir()
    picture.write_bytes(PIXEL)
    claims = [Claim("cond(A)", "7960", "13000", Verdict.DIFFERS, "the right way up")]
    table = Table("times", ("size", "s"), [("1 x 2", "3.5")])
    section = Section("first", "First", "Text.", claims, [Picture(picture, "A")], [table])
    write_section(tmp_path / "kept" / "first.json", section)
    new = tmp_path / "new"
    new.mkdir()
    for name in ("kept", "pictures"):
        (tmp_path / name).rename(new / name)
    found = read_section(new / "kept" / "first.json")
    assert found.claims == claims and found.claims[0].verdict is Verdict.DIFFERS
    assert [list(map(tuple, table.rows)) for table in found.tables] == [[("1 x 2", "3.5")]]
    assert found.pictures[0].file.read_bytes() == PIXEL
