"""What every command prints for ``--help``, for the page of commands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path("repository") / "options.txt"


def helps(name: str, command: Any) -> Iterator[str]:
    """Yield a section of a command, and of each within it, in Markdown."""
    from typer.testing import CliRunner

    from periscopy_sim.cli import app

    plain = {"COLUMNS": "94", "NO_COLOR": "1", "TERM": "dumb"}
    printed = CliRunner(env=plain).invoke(app, [*name.split(), "--help"], prog_name="periscopy")
    lines = "\n".join(line.rstrip() for line in printed.output.strip().splitlines())
    yield f"### `periscopy {name}`\n\n```text\n{lines}\n```\n"
    for subname, each in getattr(command, "commands", {}).items():
        yield from helps(f"{name} {subname}", each)


def text() -> str:
    """Return the help of all commands in Markdown."""
    import typer

    from periscopy_sim.cli import MODULES, app

    group: Any = typer.main.get_command(app)
    parts = (helps(name, group.get_command(None, name)) for name in MODULES)
    return "\n".join(section for part in parts for section in part)


def write_helps(app: Any, config: Any) -> None:
    """Write the text that the page includes."""
    page = Path(app.srcdir) / PAGE
    page.parent.mkdir(exist_ok=True)
    page.write_text(text(), "utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("config-inited", write_helps)
    return {"parallel_read_safe": True}
