import importlib.util
import re
import tomllib

import pytest
from ruamel.yaml import YAML

import periscopy_sim as ps
from periscopy_sim.cli import MODULES
from tests.scenes.pages import ROOT

DOCS = ROOT / "docs"


def extension(name):
    path = DOCS / "extensions" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_public_name_has_one_page():
    listed = re.findall(r"^   (\w+)$", (DOCS / "api" / "index.rst").read_text("utf-8"), re.M)
    assert sorted(listed) == sorted(ps.__all__)


def test_citation_is_of_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()


def test_options_of_every_command_are_listed():
    options = extension("commands_page").text()
    assert {*MODULES} == {*re.findall(r"^### `periscopy (\w+)", options, re.M)}
    assert "--hidden" in options and "\x1b" not in options


def test_a_link_to_a_file_of_the_repository_leads_to_its_page():
    relinked = extension("pages_of_the_repository").relinked
    pages = {ROOT / "benchmarks" / "README.md": DOCS / "repository" / "leaderboard.md"}
    page = DOCS / "methods.md"
    text = "[a](../benchmarks/README.md#enter) [b](scenes.md) [c](#own) [d](https://e.org/x.md)"
    assert relinked(text, page, page, pages) == text.replace(
        "../benchmarks/README.md", "repository/leaderboard.md"
    )
    # A page from elsewhere keeps its links.
    file, page = ROOT / "benchmarks" / "README.md", DOCS / "repository" / "leaderboard.md"
    text = "[a](../docs/methods.md) ![b](../docs/demo.png)"
    assert relinked(text, file, page, {}) == "[a](../methods.md) ![b](../demo.png)"


@pytest.fixture
def faults(tmp_path):
    pytest.importorskip("sphinx")
    (tmp_path / "there.html").write_text('<p id="place">there</p>', "utf-8")

    def of(body):
        (tmp_path / "page.html").write_text(body, "utf-8")
        return [fault for _, fault in extension("checked_links").faults(tmp_path)]

    return of


def test_links_that_lead_somewhere_pass(faults):
    for body in [
        '<a href="there.html#place">x</a>',
        '<a href="#own">x</a><p id="own">',
        '<a href="https://example.org/">x</a>',
        '<img src="there.html?digest=1">',
    ]:
        assert not faults(body)


def test_links_that_do_not_are_told(faults):
    for body, fault in [
        ('<a href="gone.html">x</a>', "no file"),
        ('<a href="there.html#elsewhere">x</a>', "no place"),
        ('<a href="#elsewhere">x</a>', "no place"),
        ('<img src="gone.png">', "no file"),
        ('<script src="https://example.org/a.js"></script>', "another machine"),
        ('<link href="//example.org/a.css">', "another machine"),
    ]:
        (told,) = faults(body)
        assert fault in told


def test_a_plural_of_a_literal_is_read_as_one():
    pytest.importorskip("sphinx")
    mark = extension("docstrings").mark_ends
    lines = ["Values for the file's ``<default>``s, and `Scenario`s.", "``one``, ``next``, `own`."]
    mark(None, "", "", None, None, lines)
    assert lines == [
        "Values for the file's ``<default>``\\ s, and `Scenario`\\ s.",
        "``one``, ``next``, `own`.",
    ]


def test_attributes_that_share_a_line_are_names_with_no_type():
    pytest.importorskip("sphinx")
    from docutils import nodes

    docstrings = extension("docstrings")
    lines = [":ivar start, value: The measured value, and the calibrated one.", ":ivar name: a, b"]
    docstrings.join_names(None, "", "", None, None, lines)
    assert len(lines[0].partition(":ivar ")[2].partition(":")[0].split()) == 1
    assert lines[1] == ":ivar name: a, b"
    tree = nodes.paragraph("", lines[0])
    docstrings.split_names(None, tree)
    assert tree.astext() == ":ivar start, value: The measured value, and the calibrated one."


def test_a_page_is_read_in_five_minutes():
    for page in sorted(DOCS.rglob("*.md")):
        if "gallery" not in page.parts and "repository" not in page.parts:
            assert len(page.read_text("utf-8").split()) <= 1200, f"shorten {page}"


def test_tables_of_text_stack_and_tables_of_numbers_do_not():
    pytest.importorskip("sphinx")
    from docutils.core import publish_doctree
    from docutils.nodes import entry, table

    text = """
==== =====
file holds
==== =====
a    what the scene does not explain
==== =====

==== ==== ====
name size what
==== ==== ====
a         what the scene does not explain
==== ==== ====

==== ====
SBR  PSNR
==== ====
0.5  12.0
==== ====
"""
    tree = publish_doctree(text)
    extension("phone_tables").mark(None, tree)
    assert [each["classes"] for each in tree.findall(table)] == [["stacks"], ["stacks"], []]
    empty = [cell["classes"] == ["empty"] for cell in tree.findall(entry) if not cell.astext()]
    assert empty == [True]


def test_figures_show_by_their_inches_and_long_names_may_break(tmp_path):
    pytest.importorskip("sphinx")
    from types import SimpleNamespace

    from docutils import nodes
    from PIL import Image

    Image.new("RGB", (700, 10)).save(tmp_path / "column.png", dpi=(200, 200))
    Image.new("RGB", (700, 10)).save(tmp_path / "screen.png")
    names = "periscopy reconstruct --method periscope", "a" * 40
    page = nodes.section("", *(nodes.image(uri=f"{n}.png") for n in ("column", "screen", "gone")))
    page += [nodes.literal("", name) for name in names]
    page += nodes.paragraph("", "0.1 % of 60 dB, 3 samples")
    extension("phone_widths").mark(SimpleNamespace(srcdir=tmp_path), page)
    assert [each.get("width") for each in page.findall(nodes.image)] == ["560px", None, None]
    assert [each["classes"] for each in page.findall(nodes.literal)] == [[], ["long"]]
    assert page[-1].astext().split(" ") == ["0.1\xa0%", "of", "60\xa0dB,", "3", "samples"]


def test_the_sidebar_of_the_api_has_a_caption_for_each_section():
    pytest.importorskip("sphinx")
    from types import SimpleNamespace

    from docutils import nodes
    from sphinx import addnodes

    lists = [addnodes.toctree(), addnodes.toctree()]
    page = nodes.section("", nodes.title(text="API"))
    for title, each in zip(("Scene", "Light"), lists, strict=True):
        page += nodes.section("", nodes.title(text=title), nodes.paragraph("", "", each))
    groups = extension("api_groups")
    groups.caption(SimpleNamespace(env=SimpleNamespace(docname="methods")), page)
    assert "caption" not in lists[0]
    groups.caption(SimpleNamespace(env=SimpleNamespace(docname=groups.PAGE)), page)
    assert [each["caption"] for each in lists] == ["Scene", "Light"]
