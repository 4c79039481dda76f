"""Reproduce every figure and table of the paper, and measure what goes beyond it, as one page.

`python -m experiments.paper --out DIR [--only fig4,table1] [--real FILE.npz]` runs one experiment
after the other and writes `index.html` and `claims.json`. What each found is kept in `sections` and
on the page before the next begins: a run may be interrupted, and `--only` renews a part.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from experiments.drawing import styled
from experiments.setting import Experiment, Setting, timed
from periscopy_sim.figures.report import Section, read_section, write_page, write_section
from periscopy_sim.storage.outputs.provenance import as_text, provenance
from periscopy_sim.storage.outputs.staging import staged_file

EXPERIMENTS = (
    "fig3",
    "fig4",
    "fig5",
    "fig6",
    "fig7",
    "fig8",
    "fig9",
    "fig10",
    "table1",
    "numbers",
    "ambient_model",
    "noise_aware",
    "ablation",
    "noise_aware_video",
    "calibration",
)
"""Modules of this folder with a function ``run``, in the order of the page.

From `noise_aware` on they are of what goes beyond the paper.
"""

BEYOND = {"noise_aware", "ablation", "noise_aware_video", "calibration"}

TITLE = "Fast computational periscopy in challenging ambient light, reproduced"


def load(name: str) -> Experiment:
    """Import one experiment and nothing of the others."""
    folder = "beyond" if name in BEYOND else "paper"
    experiment: Experiment = importlib.import_module(f"experiments.{folder}.{name}").run
    return experiment


def reproduce(
    names: Sequence[str],
    setting: Setting,
    record: Mapping[str, str],
    *,
    find: Callable[[str], Experiment] = load,
) -> int:
    """Run experiments, and renew the page after each.

    Parameters
    ----------
    names
        Of the experiments.
    setting
        What every one of them gets.
    record
        Provenance, for the page.
    find
        Gives an experiment by its name.

    Returns
    -------
    int
        How many failed; the others were run all the same.
    """
    failures = 0
    for name in names:
        section = _attempt(name, find, setting)
        write_section(_kept(setting.out, name), section)
        write_report(setting.out, record)
        took = "failed" if section.seconds is None else f"{section.seconds:.1f} s"
        print(f"{name}: {section.failure or section.title} ({took})", flush=True)
        failures += bool(section.failure)
    return failures


def write_report(out: Path, record: Mapping[str, str]) -> None:
    """Write the page and the claims of all that is kept in a folder."""
    files = [_kept(out, name) for name in EXPERIMENTS]
    sections = [read_section(file) for file in files if file.is_file()]
    write_page(
        out / "index.html",
        TITLE,
        sections,
        introduction="Each claim of the paper beside what this package measured, and why where "
        "they differ; last what goes beyond it, of which the paper states no value. Times are of "
        "this run's machine; other load on it lengthens them. The provenance is that of the last "
        "run in this folder.",
        provenance=record,
    )
    claims = [
        {"section": section.name, **asdict(claim)}
        for section in sections
        for claim in section.claims
    ]
    failed = {section.name: section.failure for section in sections if section.failure}
    summary = {"claims": claims, "failed": failed, "provenance": dict(record)}
    with staged_file(out / "claims.json") as file:
        file.write_text(json.dumps(summary, indent=2, ensure_ascii=False) + "\n", "utf-8")


def main(
    out: Annotated[Path, typer.Option(help="Folder for the page and its pictures.")],
    only: Annotated[str, typer.Option(help=f"By comma, of {', '.join(EXPERIMENTS)}.")] = "",
    real: Annotated[Path | None, typer.Option(help="A real photograph, NPZ.")] = None,
) -> None:
    """Run the experiments and write the page."""
    names = [name.strip() for name in only.split(",")] if only else list(EXPERIMENTS)
    unknown = [name for name in names if name not in EXPERIMENTS]
    if unknown:
        _refuse(f"no experiment '{unknown[0]}'; there are {', '.join(EXPERIMENTS)}")
    try:
        setting = Setting(out, real)
        if real is not None:
            setting.measured  # noqa: B018 (an unreadable photograph is refused before hours of work)
        failures = reproduce(names, setting, _record(setting), find=load)
    except ps.PeriscopyError as error:
        _refuse(str(error))
    print(f"wrote {out / 'index.html'}")
    raise typer.Exit(1 if failures else 0)


def _attempt(name: str, find: Callable[[str], Experiment], setting: Setting) -> Section:
    try:
        with styled():
            return timed(find(name), setting)
    except Exception as error:  # one that fails must not cost the others
        traceback.print_exc()
        return Section(name, name, failure=f"{type(error).__name__}: {error}")


def _kept(out: Path, name: str) -> Path:
    return out / "sections" / f"{name}.json"


def _record(setting: Setting) -> dict[str, str]:
    command = ["python", "-m", "experiments.paper", *sys.argv[1:]]
    made = provenance(ps.find_scene("chair"), ps.use_variant(), setting.seed, command)
    return as_text({**made, "processors": os.cpu_count()})


def _refuse(line: str) -> None:
    print(f"error: {line}", file=sys.stderr)
    raise typer.Exit(2)


if __name__ == "__main__":
    typer.run(main)
