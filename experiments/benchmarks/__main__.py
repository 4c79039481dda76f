"""How fast the package is: ratios to what a user would otherwise use, and to the machine's limits.

`python -m experiments.benchmarks --out DIR [--only stills,scale]` writes `index.html`,
`claims.json` and the plot of cost against size. Absolute times belong to one machine; the ratios,
measured in one run, carry over. `--only large`, 180 x 144 patches, takes a quarter of an hour,
12 GB of memory and 7 GB of disk, and runs only when asked for.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

import periscopy_sim as ps
from experiments.benchmarks.large import large
from experiments.benchmarks.machine_limits import Limits, measure_limits
from experiments.benchmarks.scale import scale, transport
from experiments.benchmarks.scene import SMALL
from experiments.benchmarks.stills import denoising, differencing, stills, video
from experiments.drawing import styled
from periscopy_sim.figures.report import Section, write_page
from periscopy_sim.storage.outputs.provenance import as_text, provenance
from periscopy_sim.storage.outputs.staging import staged_file

BENCHMARKS: dict[str, Callable[[Limits, Path], Section]] = {
    "stills": stills,
    "denoising": denoising,
    "differencing": differencing,
    "scale": scale,
    "video": video,
    "transport": transport,
    "large": large,
}

ON_DEMAND = {"large"}


def main(
    out: Annotated[Path, typer.Option(help="Folder for the page.")],
    only: Annotated[str, typer.Option(help=f"By comma, of {', '.join(BENCHMARKS)}.")] = "",
) -> None:
    """Run the benchmarks and write the page."""
    names = only.split(",") if only else [n for n in BENCHMARKS if n not in ON_DEMAND]
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"error: no benchmark '{unknown[0]}'; there are {', '.join(BENCHMARKS)}",
              file=sys.stderr)  # fmt: skip
        raise typer.Exit(2)
    variant = ps.use_variant()
    limits = measure_limits(ps.load_scenario(ps.find_scene("chair"), SMALL))
    record = as_text(provenance(ps.find_scene("chair"), variant, 0, sys.argv))
    sections: list[Section] = []
    for name in names:
        start = time.perf_counter()
        with styled():
            section = BENCHMARKS[name](limits, out)
        sections.append(replace(section, seconds=time.perf_counter() - start))
        for claim in section.claims:
            print(f"{name}: {claim.what}: {claim.measured} [{claim.stated or '-'}] {claim.verdict}",
                  flush=True)  # fmt: skip
    write_page(
        out / "index.html",
        "Speed",
        sections,
        introduction="Medians of several runs, in one run of this machine: "
        f"copies {limits.copy / 1e9:.0f} GB/s, matrix products {limits.single / 1e9:.0f} and "
        f"{limits.double / 1e9:.0f} GFLOP/s in single and double precision, Mitsuba's shadow rays "
        f"{limits.rays / 1e6:.0f} million a second.",
        provenance=record,
        stated="asked",
    )
    claims: list[dict[str, Any]] = [
        {"section": section.name, **asdict(claim)}
        for section in sections
        for claim in section.claims
    ]
    with staged_file(out / "claims.json") as file:
        file.write_text(json.dumps(claims, indent=2, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    typer.run(main)
