"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli import masks
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
from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.noise_aware.still import NoiseAwareReconstruction
    from periscopy_sim.reconstruction.preconditioned.still import Method, Periscope, Reconstruction
    from periscopy_sim.scenario import Array, Scenario


PRECONDITIONED = "preconditioned"
"""The paper's method."""

DEFAULT = "noise-aware"
"""Of less error under every realistic light tried than the paper's (`beyond.noise_aware`)."""


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
        str,
        typer.Option(
            metavar="NAME",
            help="noise-aware; preconditioned (the paper's), iterative, differencing, "
            "differencing-published, truncated-svd, pseudoinverse; yours as module:callable or "
            "file.py:callable.",
        ),
    ] = DEFAULT,
    samples: Samples = 16,
    model: scenes.ModelOption = scenes.Model.rendered,
    matrix: Annotated[
        Path | None,
        typer.Option("--transport", help="Take A from this NPY file rather than render it."),
    ] = None,
    tv_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            help="preconditioned: TV weight, in standard errors of the estimate; 0: none; 1 if not "
            "given.",
        ),
    ] = None,
    repair_threshold: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            help="preconditioned: repair patches that differ from their neighbours by more than "
            "this part of the image's 99th percentile; 0.1 if not given.",
        ),
    ] = None,
    rank_tolerance: Annotated[
        float | None,
        typer.Option(
            min=1e-15,
            max=0.5,
            help="preconditioned: relative tolerance on B's singular values; 1e-10 if not given.",
        ),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            help="The hidden image, if known (a file or a shipped one): adds metrics, a picture."
        ),
    ] = None,
    mask: masks.MaskOption = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation.methods import (
        find_method,
        fit_methods,
        own_errors,
        source_sha256,
    )
    from periscopy_sim.figures import panels
    from periscopy_sim.photographs.defects import defective_pixels
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.outputs.provenance import as_text
    from periscopy_sim.storage.outputs.staging import staged_folder
    from periscopy_sim.storage.pictures import read_hidden_image, write_png

    find_method(method)
    settings = _settings(
        method,
        {
            "tv_weight": (tv_weight, 1.0),
            "repair_threshold": (repair_threshold, 0.1),
            "rank_tolerance": (rank_tolerance, 1e-10),
        },
    )
    timed = Stopwatch()
    with staged_folder(out) as folder:
        with timed("load the scene"):
            scenario = scenes.load(scene, hidden, define)
        used = masks.read(mask, scenario)
        given = scenes.read_photograph(photo, scenario, used)
        defects = defective_pixels(given.values, used)
        warnings = [*given.warnings, *masks.warn_of(defects, str(photo), out / masks.SUGGESTED)]
        known = None
        if truth is not None:
            known = read_hidden_image(find_image(truth), scenario.hidden_shape)
        with timed("transport matrix"):
            if matrix is not None:
                A = scenes.read_transport(matrix, scenario)
            else:
                A = scenes.transport(scenario, samples, seed, model)
        provenance = scenes.provenance_of(scenario, seed)
        text = as_text(provenance)
        fitting = mendable(str(matrix or f"scene '{scenario.path}'"))
        if method == PRECONDITIONED:
            with timed("form the preconditioner"), fitting:
                B = point_light_backgrounds(scenario)
                periscope = _periscope(scenario, A, B, settings, used)
            with timed("reconstruct"), mendable(str(photo)):
                solution = periscope.solve(given.values)
            image = solution.image.astype(np.float64)
            settings |= {"background_rank": periscope.preconditioner.Q.shape[1]}
            settings |= _draw_stages(folder / "stages.png", given.values, solution, text)
        else:
            settings |= {"method_sha256": source_sha256(method)}
            with timed("fit the method"), fitting:
                B = point_light_backgrounds(scenario)
                fitted = fit_methods([method], scenario, A, B, used)[method]
            with (
                timed("reconstruct"),
                mendable(f"{photo} by {method}"),
                own_errors(method, f"failed on {photo}"),
            ):
                image, solved = _recovered(fitted, given.values, scenario.hidden_shape)
            if solved is not None:
                settings |= _tell_certainty(folder, fitted, solved, text)
        if matrix is not None and not matrix.with_suffix(".json").is_file():
            warn(f"{matrix} has no JSON file beside it: it may be of another scene of this size")
        np.save(folder / "reconstruction.npy", image.astype(np.float32))
        masks.suggest(folder, defects, used, text)
        shown = panels.enlarged(panels.displayable(image))
        write_png(folder / "reconstruction.png", shown, text)
        summary: dict[str, Any] = {
            "method": method,
            "photograph": str(photo),
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": "file" if matrix else model.value,
            "transport": matrix,
            "samples": None if matrix else samples,
            **settings,
            **masks.record(mask, used),
            "warnings": warnings,
            "truth": truth,
        }
        if known is not None:
            summary |= _compare(folder, image, known, given.values, text)
        write_json(
            folder / "summary.json", {**summary, "seconds": timed.seconds, "provenance": provenance}
        )
        written = sorted(file.name for file in folder.iterdir())
    say(f"wrote {', '.join(str(out / name) for name in written)}")
    if known is not None:
        say(
            f"against the truth: gain-matched PSNR {summary['psnr']:.2f} dB, registered "
            f"{summary['psnr_registered']:.2f} dB (shift {summary['shift']} patches down, right)"
        )


def _settings(method: str, given: dict[str, tuple[float | None, float]]) -> dict[str, Any]:
    """Fill in the defaults of the weights, which belong to the preconditioned method alone."""
    if method == PRECONDITIONED:
        return {
            name: default if value is None else value for name, (value, default) in given.items()
        }
    for name, (value, _) in given.items():
        if value is not None:
            raise PeriscopyError(
                f"--{name.replace('_', '-')} belongs to --method {PRECONDITIONED}, not to "
                f"{method}; give that method, or leave it out"
            )
    return {}


def _periscope(
    scenario: Scenario,
    A: NDArray[np.float32],
    B: Array,
    settings: dict[str, Any],
    mask: masks.Mask | None,
) -> Periscope:
    from periscopy_sim.reconstruction.preconditioned.still import Periscope

    return Periscope.for_scene(
        scenario,
        A,
        B,
        rank_tolerance=settings["rank_tolerance"],
        tv_weight=settings["tv_weight"],
        repair_threshold=settings["repair_threshold"],
        explicit=False,
        mask=mask,
    )


def _draw_stages(
    path: Path, photograph: Array, solution: Reconstruction, text: dict[str, str]
) -> dict[str, Any]:
    """Draw what led to the image (Fig. 2), and return the weights that did."""
    from periscopy_sim.figures import panels

    stages = [
        ("photograph", photograph),
        ("preconditioned, P y", solution.preconditioned),
        ("denoised", solution.denoised),
        ("repaired", solution.image),
    ]
    panels.draw_panels(
        path, [(title, panels.displayable(image)) for title, image in stages], metadata=text
    )
    return {"noise": solution.noise, "lambda": solution.weight, "kappa": solution.threshold}


def _recovered(
    method: Method, photograph: Array, hidden_shape: tuple[int, int]
) -> tuple[Array, NoiseAwareReconstruction | None]:
    """Reconstruct, once; of a method that knows how sure it is, keep what tells that."""
    from periscopy_sim.evaluation.methods import image_by, promised
    from periscopy_sim.reconstruction.noise_aware.still import NoiseAware

    # What a user derives from that method and reconstructs otherwise is sure of another image.
    if isinstance(method, NoiseAware) and type(method).reconstruct is NoiseAware.reconstruct:
        found = method.solve(photograph)
        return promised(found.image, hidden_shape).astype(np.float64), found
    return image_by(method, photograph, hidden_shape).astype(np.float64), None


def _tell_certainty(
    folder: Path, method: Any, found: NoiseAwareReconstruction, text: dict[str, str]
) -> dict[str, Any]:
    """Write how sure the noise-aware method is of each patch; return its weights."""
    from periscopy_sim.figures import panels

    errors = method.standard_errors(found)
    np.save(folder / "standard_error.npy", errors.astype(np.float32))
    panels.draw_certainty(folder / "certainty.png", found.image, errors, text)
    if found.has_gain:
        say(
            f"a smooth gain over the wall, {found.gain.min():.2f} to {found.gain.max():.2f}, "
            "explains part of the photograph: vignetting, or a scene that is off (see periscopy "
            "calibrate)"
        )
    return {
        "noise": found.noise,
        "lambda": found.weight,
        "iterations": found.iterations,
        "wall_gain_found": found.has_gain,
        "wall_gain_range": [float(found.gain.min()), float(found.gain.max())],
    }


def _compare(
    folder: Path,
    image: Array,
    truth: Array,
    photograph: Array,
    text: dict[str, str],
) -> dict[str, Any]:
    """Metrics against the truth, and the picture of both beside the photograph."""
    from periscopy_sim.evaluation import metrics
    from periscopy_sim.figures import panels

    best = metrics.registered(image, truth)
    panels.draw_panels(
        folder / "comparison.png",
        [
            ("hidden image", panels.displayable(truth, white=1)),
            ("photograph", panels.displayable(photograph)),
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
