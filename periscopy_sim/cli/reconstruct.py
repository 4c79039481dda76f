"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import scene as scenes
from periscopy_sim.cli.arguments import (
    Define,
    Hidden,
    Out,
    Samples,
    SceneOption,
    Seed,
    Stopwatch,
    mendable,
    say,
    warn,
    write_json,
)


class MethodName(StrEnum):
    """The reconstruction methods."""

    preconditioned = "preconditioned"


def reconstruct(
    photo: Annotated[
        Path,
        typer.Argument(
            metavar="PHOTO", help="EXR, NPY, NPZ (key photograph), 16-bit PNG or TIFF, MATLAB raw."
        ),
    ],
    scene: SceneOption,
    hidden: Hidden,
    out: Out,
    method: Annotated[
        MethodName, typer.Option(help="How the image is reconstructed.")
    ] = MethodName.preconditioned,
    samples: Samples = 16,
    model: scenes.ModelOption = scenes.Model.rendered,
    matrix: Annotated[
        Path | None,
        typer.Option("--transport", help="Take A from this NPY file rather than render it."),
    ] = None,
    tv_weight: Annotated[
        float,
        typer.Option(
            min=0, max=1e9, help="TV weight, in standard errors of the estimate; 0: none."
        ),
    ] = 1.0,
    repair_threshold: Annotated[
        float,
        typer.Option(
            min=0,
            max=1e9,
            help="Repair patches that differ from their neighbours by more than this part of the "
            "image's 99th percentile.",
        ),
    ] = 0.1,
    rank_tolerance: Annotated[
        float, typer.Option(min=1e-15, max=0.5, help="Relative tolerance on B's singular values.")
    ] = 1e-10,
    truth: Annotated[
        str | None,
        typer.Option(
            help="The hidden image, if known (a file or a shipped one): adds metrics, a picture."
        ),
    ] = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation import figures
    from periscopy_sim.reconstruction.periscope import Periscope
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.output import staged_folder
    from periscopy_sim.storage.pictures import read_hidden_image, write_png
    from periscopy_sim.storage.provenance import as_text

    timed = Stopwatch()
    with staged_folder(out) as folder:
        with timed("load the scene"):
            scenario = scenes.load(scene, hidden, define)
        given = scenes.read_photograph(photo, scenario)
        known = None
        if truth is not None:
            known = read_hidden_image(find_image(truth), scenario.hidden_shape)
        with timed("transport matrix"):
            if matrix is not None:
                A = scenes.read_transport(matrix, scenario)
            else:
                A = scenes.transport(scenario, samples, seed, model)
        with timed("form the preconditioner"), mendable(str(matrix or f"scene '{scenario.path}'")):
            periscope = Periscope.for_scene(
                scenario,
                A,
                point_light_backgrounds(scenario),
                tolerance=rank_tolerance,
                tv_weight=tv_weight,
                repair_threshold=repair_threshold,
                explicit=False,
            )
        if matrix is not None and not matrix.with_suffix(".json").is_file():
            warn(f"{matrix} has no JSON file beside it: it may be of another scene of this size")
        with timed("reconstruct"), mendable(str(photo)):
            solution = periscope.solve(given.values)
        provenance = scenes.provenance_of(scenario, seed)
        text = as_text(provenance)
        np.save(folder / "reconstruction.npy", solution.image.astype(np.float32))
        shown = figures.displayable(solution.image)
        write_png(folder / "reconstruction.png", figures.enlarged(shown), text)
        panels = [
            ("photograph", figures.displayable(given.values)),
            ("preconditioned, P y", figures.displayable(solution.preconditioned)),
            ("denoised", figures.displayable(solution.denoised)),
            ("repaired", shown),
        ]
        figures.draw_panels(folder / "stages.png", panels, metadata=text)
        summary: dict[str, Any] = {
            "method": method.value,
            "photograph": str(photo),
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": "file" if matrix else model.value,
            "transport": matrix,
            "samples": None if matrix else samples,
            "tv_weight": tv_weight,
            "repair_threshold": repair_threshold,
            "rank_tolerance": rank_tolerance,
            "background_rank": periscope.preconditioner.Q.shape[1],
            "noise": solution.noise,
            "lambda": solution.weight,
            "kappa": solution.threshold,
            "warnings": given.warnings,
            "truth": truth,
        }
        if known is not None:
            summary |= _compare(folder, solution.image, known, given.values, text)
        write_json(
            folder / "summary.json", {**summary, "seconds": timed.seconds, "provenance": provenance}
        )
    pictures = "stages.png" if known is None else "stages.png, comparison.png"
    say(f"wrote {out}/reconstruction.npy, reconstruction.png, {pictures}, summary.json")
    if known is not None:
        say(
            f"against the truth: gain-matched PSNR {summary['psnr']:.2f} dB, registered "
            f"{summary['psnr_registered']:.2f} dB (shift {summary['shift']} patches down, right)"
        )


def _compare(
    folder: Path,
    image: np.ndarray[Any, np.dtype[np.float64]],
    truth: np.ndarray[Any, np.dtype[np.float64]],
    photograph: np.ndarray[Any, np.dtype[np.float64]],
    text: dict[str, str],
) -> dict[str, Any]:
    """Metrics against the truth, and the picture of both beside the photograph."""
    from periscopy_sim.evaluation import figures, metrics

    best = metrics.registered(image, truth)
    figures.draw_panels(
        folder / "comparison.png",
        [
            ("hidden image", figures.displayable(truth, white=1)),
            ("photograph", figures.displayable(photograph)),
            ("reconstruction", metrics.gain_matched(image, truth)),
        ],
        metadata=text,
    )
    return {
        "psnr": metrics.psnr(image, truth),
        "mean_squared_error": metrics.mean_squared_error(image, truth),
        "psnr_registered": best.psnr,
        "shift": best.shift,
    }
