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


def test_a_page_is_read_in_five_minutes():
    for page in sorted(DOCS.rglob("*.md")):
        if "gallery" not in page.parts and "repository" not in page.parts:
            assert len(page.read_text("utf-8").split()) <= 1200, f"shorten {page}"
