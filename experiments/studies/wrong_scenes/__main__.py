"""Wrong scenes: all of a ruler's errors at once, calibrated away from one photograph.

Four scenes (a chair, a plate, and of laboratories of another make a shelf and a sign) are path
traced, all bounces, as their files say, under ambient light, at 60 dB. Then every number that a
ruler gave is drawn anew by the error that the file declares of it, all at once, and `ps.calibrate`
starts there. It knows the photograph and the file with the wrong numbers, nothing of the truth. The
hidden image is recovered by the noise-aware method with the ruler's scene, with the calibrated one,
whose errors the image's count, and with the true one. A monitor's shift in its plane no photograph
tells: its error stays the ruler's, and the picture may come out shifted by a patch. "Registered" is
after the shift that fits the truth best, as it uses the truth.

`--scenes` also accepts six plain scenes: boxes, plant, tripod, mesh, edges and mug. Plain Mitsuba
renders them, direct light only, and nobody tuned the calibration on them. The mug serves studies
of known pictures.

Each draw is kept in DIR/draws as soon as it is done. A run that was stopped goes on by the same
command, and one of more draws takes up those of fewer, as long as code and scenes are the same.
Runs of different scenes may fill one DIR at once; a last one of all writes the page of all.

`python -m experiments.studies.wrong_scenes --out DIR [--scenes chair,plate,shelf,sign]
[--sbr 0.5,10] [--draws 8]`
"""

from __future__ import annotations

import hashlib
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from experiments.page import described, one_line_errors
from experiments.setting import package_sha256
from experiments.studies.wrong_scenes import outcome, subjects
from experiments.studies.wrong_scenes.outcome import (
    SCENES,
    Outcome,
    Trial,
    read_outcome,
    write_outcome,
)
from experiments.studies.wrong_scenes.plain_scenes import (
    SHOWN,
    photographed_plainly,
    plain_subjects,
)
from experiments.studies.wrong_scenes.report import numbers_of, write_report
from experiments.studies.wrong_scenes.subjects import Photographed, photographed
from periscopy_sim.cli.output import progress
from periscopy_sim.storage.outputs.provenance import as_text, provenance, scene_sha256

ALL = *subjects.NAMES, *SHOWN
"""Names of scenes."""


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    scenes: Annotated[str, typer.Option(help=f"By comma, of {', '.join(ALL)}.")] = ",".join(
        subjects.NAMES
    ),
    sbr: Annotated[str, typer.Option(help="Signal-to-background ratios, by comma.")] = "0.5,10",
    draws: Annotated[int, typer.Option(min=1, help="Of each scene and ratio.")] = 8,
    rendered: Annotated[
        Path | None,
        typer.Option(help="Folder of what is rendered once; OUT/rendered unless given."),
    ] = None,
) -> None:
    """Calibrate wrong scenes; write a page, tables and figures of what came out."""
    with one_line_errors():
        folder = rendered or out / "rendered"
        names, ratios = names_of(scenes), ratios_of(sbr)
        known = subjects.subjects(folder) | plain_subjects()
        trials = [
            Trial((photographed_plainly if name in SHOWN else photographed)(known[name], folder))
            for name in names
        ]
        failures = run(trials, ratios, draws, out)
    print(f"wrote {out / 'index.html'}")
    raise typer.Exit(1 if failures else 0)


def names_of(text: str) -> list[str]:
    """Return the scenes of a list by comma, or refuse it by a PeriscopyError."""
    names = [name.strip() for name in text.split(",")]
    if unknown := [name for name in names if name not in ALL]:
        raise ps.PeriscopyError(f"--scenes: no scene '{unknown[0]}'; there are {', '.join(ALL)}")
    if len(set(names)) < len(names):
        raise ps.PeriscopyError(f"--scenes {text}: name each scene once")
    return names


def ratios_of(text: str) -> list[float]:
    """Return the numbers of a list by comma, or refuse it by a PeriscopyError."""
    try:
        ratios = [float(number) for number in text.split(",")]
    except ValueError:
        ratios = []
    positive = all(0 < ratio < float("inf") for ratio in ratios)
    if not ratios or not positive or len(set(ratios)) < len(ratios):
        raise ps.PeriscopyError(f"--sbr {text}: give different positive numbers, by comma")
    return ratios


def run(trials: Sequence[Trial], ratios: Sequence[float], draws: int, out: Path) -> int:
    """Carry out the draws, the first of every scene first, and renew the report after each.

    Returns
    -------
    int
        How many failed; the others were carried out all the same.
    """
    command = ["python", "-m", "experiments.studies.wrong_scenes", *sys.argv[1:]]
    record = as_text(provenance(None, command=command))
    order = [(trial, sbr, draw) for trial in trials for sbr in ratios for draw in range(draws)]
    found: dict[tuple[Trial, float, int], Outcome] = {}
    failures = 0
    for key in sorted(order, key=lambda key: key[2]):
        trial, sbr, draw = key
        name = f"{trial.subject.name}, SBR {sbr:g}, draw {draw}"
        file = out / "draws" / f"{trial.subject.name}_{sbr:g}_{draw:03d}.npz"
        try:
            found[key] = carried_out(trial, sbr, draw, name, file)
        except Exception:  # one that fails must not cost the others
            traceback.print_exc()
            print(f"{name}: failed", flush=True)
            failures += 1
            continue
        print(f"{name}: {line_of(found[key])}", flush=True)
        done = [found[key] for key in order if key in found]
        write_report(out, done, described(__doc__), record)
    return failures


def carried_out(trial: Trial, sbr: float, draw: int, name: str, file: Path) -> Outcome:
    """Carry out a draw, or read what was kept of it."""
    made_from = identity(trial.photographed)
    kept = read_outcome(file, made_from)
    if kept is not None:
        return kept
    with progress(name) as report:
        made = trial.outcome(sbr, draw, report)
    write_outcome(made, file, made_from)
    return made


def identity(photographed: Photographed) -> str:
    """Return the digest of all that a draw is made from: code, scene, light."""
    subject = photographed.subject
    digest = hashlib.sha256(package_sha256().encode())
    for module in (subjects, outcome):
        digest.update(Path(str(module.__file__)).read_bytes())
    digest.update(scene_sha256(subject.scene).encode())
    digest.update(repr((subject.parameters, subject.hidden)).encode())
    digest.update(photographed.sha256.encode())
    return digest.hexdigest()


def line_of(one: Outcome) -> str:
    """Return a draw in a line."""
    of = numbers_of(one)
    stands, registered = (
        ", ".join(f"{name} {values[name]:.1f}" for name in SCENES)
        for values in (one.psnr, one.registered)
    )
    return (
        f"{stands} dB (registered {registered}); numbers within 1 and 3 standard errors "
        f"{of['within_1']} and {of['within_3']} of {of['numbers']}, of {of['determined']} "
        f"determined {of['determined_within_1']} and {of['determined_within_3']}; patches "
        f"{of['patches_within_1']:.0%}; {'trusted' if one.trusted else 'not trusted'}; "
        f"{of['calibration_seconds']:.0f} + {of['reconstruction_seconds']:.0f} processor seconds"
    )


if __name__ == "__main__":
    typer.run(main)
