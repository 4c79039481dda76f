import base64

from experiments.report import (
    Claim,
    Picture,
    Section,
    Table,
    Verdict,
    read_section,
    write_section,
)

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


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
