"""Silhouettes: occluders nobody measured, found with the hidden image, beside the true ones.

Flat masks of 16 x 16 cells of 5 mm are rendered, all bounces, under an overcast sky, at 60 dB; one
stands between the search's cells, one beside a window. So is the shipped chair, which is not flat,
at an SBR of 10. `ps.recover_silhouette` is given the
photograph and a scene that has a square of 8 cm in the mask's place. Then the noise-aware method
recovers the hidden image three times: with the mask found, with the true occluder's outline cut
into the same flat cells, and with the true occluder. "Registered" is after the shift that fits the
true image best. Of the shipped and of the published chair a box of 85 x 75 x 320 mm is known; of
another laboratory's frame a rectangle of 10 x 18 cm, and what is compared is a sketch.

Each case is kept in DIR/cases as soon as it is done. A run that was stopped goes on by the same
command, as long as code and inputs are the same.

`python -m experiments.studies.silhouettes --out DIR [--real chair_mushroom.npz]
[--other ustc_rgb.npz]`
"""

from __future__ import annotations

import hashlib
import sys
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from experiments.page import described, one_line_errors
from experiments.setting import package_sha256
from experiments.studies.kept_case import read_case, write_case
from experiments.studies.silhouettes import outcome as outcomes
from experiments.studies.silhouettes import subjects
from experiments.studies.silhouettes.outcome import Outcome
from experiments.studies.silhouettes.report import told, write_report
from experiments.studies.silhouettes.subjects import Subject
from periscopy_sim.cli.output import progress
from periscopy_sim.errors import OutputError, PeriscopyError, VariantError
from periscopy_sim.evaluation.sweep import array_sha256, image_sha256
from periscopy_sim.storage.outputs.provenance import as_text, provenance, scene_sha256


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    real: Annotated[
        Path | None, typer.Option(help="A real photograph of the chair scene, NPZ.")
    ] = None,
    other: Annotated[
        Path | None,
        typer.Option(help="One of another laboratory's frame, NPZ: `photograph` and `shown`."),
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(help="Folder of what is rendered once; OUT/rendered unless given."),
    ] = None,
) -> None:
    """Find silhouettes on rendered and real photographs; write a page, tables and figures."""
    with one_line_errors():
        folder = rendered or out / "rendered"
        cases: dict[str, Callable[[], Subject]] = {}
        if real is not None:  # first: a file that is no use is refused before an hour of work
            first = subjects.chair(real, folder)
            cases[first.name] = lambda: first
        if other is not None:
            second = subjects.frame(other, folder)
            cases[second.name] = lambda: second
        masks = {mask.name: partial(subjects.rendered, mask, folder) for mask in subjects.MASKS}
        cases = {**masks, subjects.SOLID: partial(subjects.solid_chair, folder), **cases}
        failures = run(cases, out)
    if failures < len(cases):
        print(f"wrote {out / 'index.html'}")
    raise typer.Exit(1 if failures else 0)


def run(cases: Mapping[str, Callable[[], Subject]], out: Path) -> int:
    """Carry out cases, by name, and renew the report after each.

    Returns
    -------
    int
        How many failed; the others were carried out all the same.
    """
    command = ["python", "-m", "experiments.studies.silhouettes", *sys.argv[1:]]
    record = as_text(provenance(None, ps.use_variant(), None, command))
    found: list[Outcome] = []
    failures = 0
    for name, photographed in cases.items():
        try:
            found.append(carried_out(photographed(), out))
        except (VariantError, OutputError):  # which would stop the others too
            raise
        except PeriscopyError as error:
            print(f"{name}: {error}", flush=True)
            failures += 1
            continue
        except Exception:  # one that fails must not cost the others
            traceback.print_exc()
            print(f"{name}: failed", flush=True)
            failures += 1
            continue
        print(told(found[-1]), flush=True)
        write_report(out, found, described(__doc__), record)
    return failures


def carried_out(subject: Subject, out: Path) -> Outcome:
    """Carry out a case, or read what was kept of it."""
    file = out / "cases" / f"{subject.name.replace(' ', '_').replace(',', '')}.npz"
    made_from = identity(subject)
    kept = read_case(Outcome, file, made_from)
    if kept is not None:
        return kept
    with progress(subject.name) as report:
        made = outcomes.outcome(subject, report)
    write_case(made, file, made_from)
    return made


def identity(subject: Subject) -> str:
    """Return the digest of all that a case is made from: code, scenes, photograph."""
    digest = hashlib.sha256(package_sha256().encode())
    digest.update(Path(str(outcomes.__file__)).read_bytes())
    sought, truth = subject.sought, subject.truth
    for scene in (sought.scene, truth.scene):
        digest.update(scene_sha256(scene).encode())
    digest.update(image_sha256(truth.image).encode())
    for array in (sought.photograph, truth.outline):
        digest.update(array_sha256(array).encode())
    if sought.used is not None:
        digest.update(array_sha256(sought.used).encode())
    given = sought.shape, sought.hidden, sought.cells, sought.parameters, truth.placed
    digest.update(repr(given).encode())
    return digest.hexdigest()


if __name__ == "__main__":
    typer.run(main)
