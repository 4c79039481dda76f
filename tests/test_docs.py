"""README and docs: every block runs, every command parses, every link leads somewhere."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

import periscopy_sim as ps
from periscopy_sim.cli import app
from periscopy_sim.cli.sweep import EXAMPLE as STUDY
from periscopy_sim.rendering import ambient
from periscopy_sim.rendering.variant import is_vectorized, use_variant

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    # Tables of contents are Sphinx's alone.
    *(
        page
        for page in sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs/results").glob("*.md")])
        if "```{toctree}" not in page.read_text("utf-8")
    ),
]
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LIBRARIES = ("torch", "deepinv")


@dataclass(frozen=True)
class Block:
    """A fenced block: what it is written in, what is said of it, and its text.

    ``slow`` takes minutes, ``served`` runs until it is stopped, ``network`` downloads, ``torch``
    and ``deepinv`` need the library, and ``file=NAME`` is to be written to a file.
    """

    page: Path
    line: int
    language: str
    flags: tuple[str, ...]
    text: str

    def __str__(self):
        return f"{self.page.name}:{self.line}"


def blocks_of(page):
    text = page.read_text("utf-8")
    for match in FENCE.finditer(text):
        language, *flags = match[1].split()
        yield Block(page, text.count("\n", 0, match.start()) + 1, language, tuple(flags), match[2])


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def commands_of(block):
    """The lines of a shell block, continued ones joined, without their comments."""
    for line in block.text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


def run(block, folder, names):
    """Run a block in the page's folder; Python blocks of a page share their names."""
    written = [flag.removeprefix("file=") for flag in block.flags if flag.startswith("file=")]
    if written:
        (folder / written[0]).write_text(block.text, "utf-8")
    elif block.language == "python":
        exec(compile(block.text, str(block), "exec"), names)
    elif block.language == "sh":
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        script = f"set -euo pipefail\n{block.text}"
        ran = subprocess.run(
            ["bash", "-c", script], cwd=folder, env={**os.environ, "PATH": path}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, f"{block}: {ran.stdout}"


def run_page(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {}
    for block in blocks_of(page):
        if {"served", "network"} & {*block.flags}:
            continue
        if all(map(find_spec, set(LIBRARIES).intersection(block.flags))):
            run(block, folder, names)


@pytest.mark.thorough
def test_readme_runs(tmp_path, monkeypatch):
    """Unchanged, but with less ambient light traced; `test_page_runs` traces all of it."""
    use_variant()
    if not is_vectorized():
        pytest.skip("path tracing takes too long without LLVM or CUDA")
    monkeypatch.setitem(ps.render_background.__kwdefaults__, "target", 1e-3)
    monkeypatch.setattr(ambient, "DIRECT_SAMPLES", ambient.DIRECT_SAMPLES // 4)
    run_page(ROOT / "README.md", tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_runs(page, tmp_path, monkeypatch):
    run_page(page, tmp_path, monkeypatch)


def test_there_are_blocks_of_every_kind_and_of_no_other():
    assert {block.language for block in BLOCKS} == {"python", "sh", "yaml", "xml", "console"}
    for block in BLOCKS:
        known = ("slow", "served", "network", *LIBRARIES)
        assert all(flag in known or flag.startswith("file=") for flag in block.flags), block
        if block.language in ("yaml", "xml"):
            assert block.flags, f"{block}: no test would read it"


def test_blocks_that_are_not_run_only_call_make():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for block in BLOCKS:
        if block.language == "console":
            for words in commands_of(block):
                assert words[0] == "make" and words[1] in targets and len(words) == 2, block


def test_commands_are_those_of_the_command_line(tmp_path, monkeypatch):
    """Without running them: every command and option is known, and its value of the right type.

    No two pages resume one folder.
    """
    monkeypatch.chdir(tmp_path)
    command, folders = typer.main.get_command(app), list[str]()
    for block in (each for each in BLOCKS if each.language == "sh"):
        seen = 0
        for words in commands_of(block):
            arguments = words[: words.index(">")] if ">" in words else words
            assert arguments[0] == "periscopy", f"{block}: {words}"
            words = [re.fullmatch(r"(?:\w+=)?([\w/]+\.[a-z]+)", word) for word in arguments]
            for file in (Path(word[1]) for word in words if word):
                file.parent.mkdir(parents=True, exist_ok=True)
                # Inputs must exist, and a study is read at once.
                file.write_bytes(STUDY.read_bytes() if file.name == "study.yaml" else b"")
            group, context, rest = command, None, arguments[1:]
            while hasattr(group, "commands"):
                context = group.make_context(group.name, list(rest), parent=context)
                rest = [*context._protected_args, *context.args]
                name, group, rest = group.resolve_command(context, rest)
            with suppress(typer.Exit):  # of what is printed at once, as an example
                group.make_context(name, list(rest), parent=context)
            seen += 1
            if name in ("sweep", "design") and "--out" in arguments:
                folders.append(arguments[arguments.index("--out") + 1])
        assert seen
    assert len({*folders}) == len(folders)


LINKED = {
    (page.parent / target).resolve()
    for page in PAGES
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text("utf-8"))
}


def test_links_lead_to_files():
    assert not [path for path in LINKED if not path.is_file()]


def test_the_source_distribution_holds_what_pages_link_to_and_tests_read():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    included = set(project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    needed = {path.relative_to(ROOT).parts[0] for path in (*PAGES, *LINKED)}
    needed |= {"periscopy_sim", "scenes", "experiments", "tests", "Makefile"}
    assert {f"/{name}" for name in needed} <= included


def test_readme_is_one_screen():
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 80
