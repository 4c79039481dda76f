"""Run the benchmark and write the leaderboard: `python -m benchmarks run --out out/leaderboard`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from benchmarks.cases import RENDERED
from benchmarks.freezing import check_frozen, freeze
from benchmarks.suites import SUITES
from experiments.page import one_line_errors
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.storage.provenance import as_text, provenance

app = typer.Typer(add_completion=False, help="The benchmark of periscopy_sim.")

Names = Annotated[str, typer.Option(help="By comma; all unless given.")]
Out = Annotated[Path, typer.Option(help="Folder to write.")]


@app.command()
def run(methods: Names = "", suites: Names = "", out: Out = Path("out/leaderboard")) -> None:
    """Run methods on suites and write the page; rows of other methods and suites stay."""
    from benchmarks.page import write_leaderboard
    from benchmarks.running import checked, known_methods, read_rows, run_suite

    with one_line_errors():
        check_frozen()
        chosen = checked("method", _split(methods), known_methods())
        for suite in checked("suite", _split(suites), tuple(SUITES)) or SUITES:
            run_suite(suite, chosen, out / "results")
            page = write_leaderboard(out, read_rows(out / "results"), _record(methods, suites))
            print(f"{suite}: wrote {page}", flush=True)


@app.command("page")
def page_alone(out: Out = Path("out/leaderboard")) -> None:
    """Write the page anew from results that are there."""
    from benchmarks.page import write_leaderboard
    from benchmarks.running import read_rows

    with one_line_errors():
        rows = read_rows(out / "results")
        print(f"wrote {write_leaderboard(out, rows, _record('', ''))}")


@app.command("freeze")
def freeze_version() -> None:
    """Freeze a new version of the suites: its digest and what its photographs come to."""
    with one_line_errors():
        print(f"wrote {freeze(RENDERED)}")


def _split(names: str) -> list[str]:
    return [name.strip() for name in names.split(",") if name.strip()]


def _record(methods: str, suites: str) -> dict[str, str]:
    asked = [
        *(["--methods", methods] if methods else []),
        *(["--suites", suites] if suites else []),
    ]
    command = ["python", "-m", "benchmarks", "run", *asked]
    made = provenance(read_document(ps.find_scene("chair")), command=command)
    return as_text({**made, "processors": os.cpu_count()})


if __name__ == "__main__":
    app()
