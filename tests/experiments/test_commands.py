"""Each `python -m experiments...` that a file of the repository names can be typed."""

import importlib
import re
import shlex
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import typer

from experiments.page import Page

ROOT = Path(__file__).parents[2]
RUNNABLE = 'if __name__ == "__main__":'
WRITTEN_BY = ("*.py", "*.md", "*.toml", "Makefile")
# Made for pages, or by runs; the changelog names commands of earlier versions.
NOT_OURS = {".venv", "out", ".git", "build", "repository", "gallery", "CHANGELOG.md"}


def files():
    for pattern in WRITTEN_BY:
        for file in sorted(ROOT.rglob(pattern)):
            parts = set(file.relative_to(ROOT).parts)
            if file != Path(__file__) and not NOT_OURS & parts:
                yield file


def mentions(text):
    """Modules and arguments named: within backticks, which may go over a line's end, or a line."""
    for quoted in re.findall(r"`(python -m experiments[^`]*)`", text):
        text = text.replace(f"`{quoted}`", "")
        yield parsed(" ".join(quoted.split()))
    for line in re.findall(r"^.*-m experiments.*$", text, re.MULTILINE):
        yield parsed(line)


def parsed(command):
    module, _, arguments = command.partition("-m ")[2].partition(" ")
    return module, shlex.split(arguments.replace("[", " ").replace("]", " "))


def source_of(module):
    """The file that `python -m` would run; None if there is none."""
    path = ROOT.joinpath(*module.split("."))
    file = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
    return file if file.is_file() and RUNNABLE in file.read_text("utf-8") else None


def needs_torch(module):
    """Whether a module cannot be imported without PyTorch."""
    return module.startswith("experiments.learned")


@cache
def options_of(module):
    """What the module's command knows: its options, and the experiments that it names."""
    file = source_of(module)
    name = ".".join(file.relative_to(ROOT).with_suffix("").parts)
    found = importlib.import_module(name)
    page = getattr(found, "PAGE", None)
    if isinstance(page, Page):
        command, names = getattr(found, "main", None) or page.command(), set(page.names)
    else:
        command, names = found.main, set()
        names |= set(getattr(found, "CHECKS", ()))
    app = typer.Typer(add_completion=False)
    app.command()(command)
    options = {
        option for parameter in typer.main.get_command(app).params for option in parameter.opts
    }
    return options, names


def test_a_command_that_a_file_names_can_be_typed():
    named = {
        (module, arguments): file.relative_to(ROOT)
        for file in files()
        for module, words in mentions(file.read_text("utf-8"))
        for arguments in [tuple(words)]
    }
    assert len(named) > 20
    for (module, arguments), file in named.items():
        assert source_of(module), f"{file}: no `python -m {module}`"
        if needs_torch(module) and not find_spec("torch"):
            continue
        options, names = options_of(module)
        for word, value in pairwise((*arguments, "")):
            if word.startswith("--"):
                assert word in options, f"{file}: `{module}` has no {word}"
            if word == "--only" and "..." not in value:
                assert set(value.split(",")) <= names, f"{file}: {module} has no {value}"
