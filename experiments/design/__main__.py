"""What the chair could have been: the best of plate, chair, plant and random masks at equal area.

`python -m experiments.design --out DIR` ranks occluders in the plate's place by the mean
Cramér-Rao bound, then checks the ranking by reconstruction: photographs are rendered by rays of
their own, with all bounces, of several images under the ambient light of two places, at 60 dB and
an SBR of 0.5, and recovered by the noise-aware and the paper's method, and by the former from an A
of 16 rays, which is some tenths of a percent in error. Does the ranking hold?
Spearman's rank correlation says so, with a bootstrap interval over the occluders. Written are
`masks.csv`, `design.json` and `design.png` (and .pdf). Each occluder is kept in DIR/cases as soon
as it is done; a run that was stopped goes on by the same command, as long as the code is the same.
"""

from __future__ import annotations

import csv
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from experiments.design import masks, trial
from experiments.design.masks import candidates
from experiments.design.ranking import Agreement, agreement
from experiments.design.trial import METHODS, Outcome, Stage, carried_out
from experiments.drawing import PAGE, drawn, show_light
from experiments.page import one_line_errors
from experiments.setting import package_sha256
from experiments.studies.kept_case import read_case, write_case
from periscopy_sim.cli.ambient import ambient_photographs
from periscopy_sim.cli.output import counted_progress
from periscopy_sim.storage.outputs.provenance import provenance
from periscopy_sim.storage.outputs.staging import staged_file

MARKS = "osD^v<>P*X"


def main(out: Annotated[Path, typer.Option(help="Folder to write.")]) -> None:
    """Rank occluders by the bound, and check the ranking by reconstruction."""
    with one_line_errors():
        found = run(out, Stage())
    report(out, found, Stage())


def run(out: Path, stage: Stage, tried: Sequence[masks.Candidate] | None = None) -> list[Outcome]:
    """Carry out the trial of each occluder, or read what was kept of it."""
    tried = candidates() if tried is None else tried
    made_from = identity(stage)
    found: list[Outcome] = []
    reference = ambient = None
    with counted_progress("trying occluders", "occluders") as progress:
        for candidate in tried:
            file = out / "cases" / f"{candidate.name}.npz"
            outcome = read_case(Outcome, file, made_from)
            if outcome is None:
                if reference is None:
                    reference = stage.reference()
                    plate = stage.load("plate")
                    ambient = ambient_photographs(stage.places, plate, out / "ambient", trial.SEED)
                assert ambient is not None
                outcome = carried_out(candidate, stage, reference, ambient, out / "scenes")
                write_case(outcome, file, made_from)
            found.append(outcome)
            progress(len(found), len(tried))
    return found


def identity(stage: Stage) -> str:
    """Return the digest of all that an outcome is made from."""
    digest = hashlib.sha256(f"{package_sha256()} {stage}".encode())
    for module in (masks, trial):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


def report(out: Path, found: Sequence[Outcome], stage: Stage) -> dict[str, Agreement]:
    """Write the table, the numbers and the picture, and print them; return the agreements."""
    bound, told = (np.array([getattr(each, name) for each in found]) for name in ("bound", "told"))
    errors = np.array([each.errors.mean(axis=(1, 2)) for each in found]).T
    held = {
        **{
            f"the bound and the error, {name}": agreement(bound, errors[m])
            for m, name in enumerate(METHODS)
        },
        "the told and the actual error, noise-aware": agreement(told, errors[0]),
    }
    order = np.argsort(bound)
    rows = [
        {
            "rank": rank,
            "kind": found[k].kind,
            "name": found[k].name,
            "bound_percent": 100 * bound[k],
            "told_error_percent": 100 * told[k],
            "exposure_time": found[k].time,
            **{f"mse {name}": errors[m, k] for m, name in enumerate(METHODS)},
            **{f"psnr {name}": -10 * np.log10(errors[m, k]) for m, name in enumerate(METHODS)},
            "rank by reconstruction": 1 + int((errors[0] < errors[0, k]).sum()),
        }
        for rank, k in enumerate(order, 1)
    ]
    with staged_file(out / "masks.csv") as file, file.open("w", encoding="utf-8", newline="") as s:
        table = csv.DictWriter(s, list(rows[0]), lineterminator="\n")
        table.writeheader()
        for row in rows:
            table.writerow({n: f"{v:.6g}" if isinstance(v, float) else v for n, v in row.items()})
    record: dict[str, Any] = {
        "rank_correlation": {
            name: {"spearman": each.correlation, "interval_95": [each.low, each.high]}
            for name, each in held.items()
        },
        "ranking": rows,
        "provenance": provenance(
            None,
            ps.use_variant(),
            trial.SEED,
            ["python", "-m", "experiments.design", *sys.argv[1:]],
        ),
    }
    with staged_file(out / "design.json") as file:
        file.write_text(json.dumps(record, indent=2, default=float) + "\n", encoding="utf-8")
    draw(out, found, order, errors, bound, held, stage)
    print("rank  occluder             bound %  told %  time   PSNR (dB) by", ", ".join(METHODS))
    for row in rows:
        print(
            f"{row['rank']:4d}  {row['kind']:19}  {row['bound_percent']:7.2f} "
            f"{row['told_error_percent']:7.2f}  {row['exposure_time']:<6.3g} "
            + "  ".join(f"{row[f'psnr {name}']:6.1f}" for name in METHODS)
        )
    for name, each in held.items():
        print(f"rank correlation of {name}: {each}")
    print(f"wrote {out / 'masks.csv'}, {out / 'design.json'}, {out / 'design.png'}")
    return held


def draw(
    out: Path,
    found: Sequence[Outcome],
    order: Any,
    errors: Any,
    bound: Any,
    held: dict[str, Agreement],
    stage: Stage,
) -> None:
    """Draw the best of each kind with its image, and the two rankings against each other."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    plain = FuncFormatter(lambda value, _: f"{value:g}")
    kinds = list(dict.fromkeys(found[k].kind for k in order))
    best = {kind: next(k for k in order if found[k].kind == kind) for kind in kinds}
    truth = next(iter(stage.shown().values()))
    with drawn(out, "design", PAGE, 5.6) as figure:
        pictures, plots = figure.subfigures(2, 1, height_ratios=(1, 1.15))
        axes = pictures.subplots(2, len(kinds) + 1, squeeze=False)
        for ax in axes.ravel():
            ax.set_axis_off()
        show_light(axes[1, 0], truth, white=1.0)
        axes[1, 0].set_title("truth", fontsize=7)
        for (kind, k), (above, below) in zip(best.items(), axes[:, 1:].T, strict=True):
            above.imshow(~found[k].outline, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            above.set_title(f"{kind}\nbound {100 * bound[k]:.0f} %", fontsize=7)
            show_light(below, found[k].image, white=1.0)
            below.set_title(f"{-10 * np.log10(errors[0, k]):.1f} dB", fontsize=7)
        panels = plots.subplots(1, len(METHODS))
        for m, (ax, name) in enumerate(zip(panels, METHODS, strict=True)):
            for kind, mark in zip(kinds, MARKS, strict=False):
                at = [k for k, each in enumerate(found) if each.kind == kind]
                ax.plot(
                    100 * bound[at], errors[m, at], mark, label=kind, ms=4.5, mec="white", mew=0.4
                )
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlabel("Cramér-Rao bound, % of white")
            agreed = held[f"the bound and the error, {name}"]
            ax.set_title(f"{name}\nrank correlation\n{agreed}")
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                axis.set_major_formatter(plain)
                axis.set_minor_formatter(NullFormatter())
            ax.grid(True, which="major", color="0.92", lw=0.5)
        panels[0].set_ylabel("mean squared error")
        plots.legend(
            *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(kinds)
        )


if __name__ == "__main__":
    typer.run(main)
