"""`periscopy sweep`: methods over ambient light, signal-to-background ratios and noise draws."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import inputs, options
from periscopy_sim.cli import photograph as photographs
from periscopy_sim.cli import transport as matrices
from periscopy_sim.cli.light import LightModel, TransportRequest
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.output import fixable, progress, say, say_written, to_be_continued
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.extras import require_all
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.outputs.resume import (
    alone_in,
    check_settings,
    read_settings,
    refuse_results,
    write_settings,
)
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    import xarray as xr

    from periscopy_sim.scenario import Array, Scenario

RENDERED = ("A.npy", "photograph.exr", "ambient")
RUN = ("command", "scene", "seed")
"""Provenance that differs from run to run."""
STORE = "sweep.zarr"
RESULTS = (STORE, "sweep.csv", "sweep.png", "seconds.csv")
VARIED = ("ambient", "ambient_prototypes", "flips", "methods", "monitor_off", "sbr", "snr", "seeds")
"""Settings that no rendering depends on: they may change until there are results."""


def sweep(
    scene: options.SceneArgument,
    hidden: options.Hidden,
    out: Annotated[
        Path, option("FOLDER", "Folder of results; a sweep that stopped goes on there.")
    ],
    photograph: Annotated[
        Path | None,
        option("FILE", "A photograph without ambient light; needs --truth.", group=PHOTOGRAPH),
    ] = None,
    truth: Annotated[
        str | None, option("IMAGE", "What the monitor showed in --photograph.")
    ] = None,
    hidden_image: Annotated[
        str | None, option("IMAGE", "What the monitor shows; the photograph is path traced.")
    ] = None,
    sbr: Annotated[
        str, option("RATIOS", "Signal-to-background ratios: 0.1,1,10 or 0.1:10:log:9.")
    ] = "0.1:10:log:9",
    ambient: Annotated[
        str,
        option(
            "LIST",
            f"Ambient light, by comma: all (the {len(REALISTIC)} realistic shipped conditions), "
            f"adversarial (the {len(ADVERSARIAL)} others), names of shipped conditions, EXR files, "
            "folders of EXR files.",
        ),
    ] = "all",
    flips: Annotated[bool, typer.Option(help="Also flip each background about each axis.")] = True,
    methods: Annotated[
        str, option("LIST", "Methods by comma; yours as module:callable or file.py:callable.")
    ] = "noise-aware,preconditioned,differencing",
    snr: options.Snr = 60.0,
    seeds: Annotated[int, option("NUMBER", "Noise draws for each background and SBR.", min=1)] = 1,
    scheduler: Annotated[
        str | None, option("ADDRESS", "A Dask scheduler; without it, this machine's cores.")
    ] = None,
    samples: options.Samples = 16,
    bounces: options.BouncesOption = "direct",
    monitor_off: options.MonitorOffOption = None,
    light_model: options.LightModelOption = None,
    mask: options.MaskOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Compare methods over ambient light and SBRs.

    A sweep that was stopped goes on by the same command.
    """
    from periscopy_sim.evaluation import sweep as sweeps
    from periscopy_sim.evaluation import workers
    from periscopy_sim.evaluation.methods import find_method, fit_methods, source_sha256
    from periscopy_sim.figures import panels
    from periscopy_sim.rendering.transport.bounced import channels_mean

    # Whatever can be refused is refused here, before hours of rendering.
    require_all()
    if (photograph is None) == (hidden_image is None) or (photograph is None) != (truth is None):
        raise PeriscopyError("give either --photograph with --truth, or --hidden-image alone")
    ratios, lights = options.parse_ratios(sbr), options.parse_ambient(ambient)
    request = TransportRequest(
        samples, seed, bounces=options.parse_bounces(bounces), file=out / "A.npy"
    )
    names = options.parse_list("--methods", methods)
    for name in names:
        find_method(name)
    prototypes = LightModel.of(light_model, seed, names)
    session = Session(scene, hidden, define, seed)
    scenario = session.scenario
    shown = session.hidden_image(truth or hidden_image or "")
    used = inputs.read_mask(mask, scenario)
    dark = inputs.read_backgrounds(monitor_off, scenario, used)
    signal = None
    if photograph is not None:
        signal = inputs.read_photograph(photograph, scenario, used).values
        inputs.look_for_defects(signal, used, str(photograph))
    ambience = {
        name: _background(path, scenario, used, flips) if path else None
        for name, path in lights.items()
    }
    settings = {
        **{name: value for name, value in session.provenance.items() if name not in RUN},
        "hidden_shape": scenario.hidden_shape,
        "samples": samples,
        "bounces": request.origin["bounces"],
        **prototypes.origin,
        "base_seed": seed,
        "mask": None if used is None else sweeps.array_sha256(used),
        "monitor_off": [sweeps.array_sha256(image) for image in dark.values()],
        "photograph": "path traced" if signal is None else sweeps.array_sha256(signal),
        "truth": sweeps.image_sha256(shown),
        "ambient": [
            [name, "rendered" if image is None else sweeps.array_sha256(image)]
            for name, image in ambience.items()
        ],
        "flips": flips,
        "methods": [[name, source_sha256(name) or "built in"] for name in names],
        "sbr": ratios,
        "snr": snr,
        "seeds": seeds,
    }
    _check_folder(out, settings)
    if scheduler is not None:
        with workers.connect(scheduler):  # does it answer?
            pass
    with to_be_continued(), alone_in(out):
        _check_folder(out, settings)  # again, now that nobody else writes there
        if not (out / STORE).exists():
            write_settings(out, settings)
        if not (out / "A.npy").is_file():
            matrices.transport(
                scene, hidden, out / "A.npy", samples=samples, bounces=bounces, seed=seed,
                define=define,
            )  # fmt: skip
        A = channels_mean(request.matrix(scenario))
        B = prototypes.matrix(scenario)
        with fixable(f"scene '{scenario.path}'", dark):
            fitted = fit_methods(names, scenario, A, B, used, dark)
        if signal is None:
            file = out / "photograph.exr"
            if not file.is_file():
                photographs.photograph(
                    scene, str(hidden_image), file, hidden=hidden, seed=seed, define=define
                )
            signal = inputs.read_photograph(file, scenario).values
        lit = _rendered(ambience, scenario, out / "ambient", seed)
        whole = sweeps.Sweep(
            signal=signal,
            truth=shown,
            backgrounds=sweeps.flips(lit) if flips else lit,
            methods=fitted,
            sbrs=ratios,
            snr=snr,
            seeds=range(seeds),
            seed=seed,
            mask=used,
            conditions={
                "settings": settings,
                "A_sha256": sweeps.array_sha256(A),
                "B_sha256": sweeps.array_sha256(B),
            },
        )
        with progress("sweeping") as report:
            results = sweeps.run_sweep(whole, out, scheduler=scheduler, progress=report)
        with staged_file(out / "sweep.png") as file:
            panels.draw_sweep(file, results, metadata=session.metadata)
    _say_means(results)
    say_written(*(out / name for name in RESULTS))


def _background(path: Path, scenario: Scenario, used: inputs.Mask | None, flips: bool) -> Array:
    """Read ambient light, (rows, columns, 3); all that its flips show must be finite, too."""
    from periscopy_sim.evaluation import sweep as sweeps
    from periscopy_sim.photograph import used_pixels

    light = inputs.read_photograph(path, scenario, used).values
    turned = sweeps.flips({"": light}).values() if flips else ()
    if not all(np.isfinite(used_pixels(each, used)).all() for each in turned):
        raise PhotographError(
            f"{path}: holds NaN or infinite values where the mask leaves the wall out, and flips "
            "show them where it is used; replace them, or give --no-flips"
        )
    return light


def _rendered(
    backgrounds: Mapping[str, Array | None], scenario: Scenario, folder: Path, seed: int
) -> dict[str, Array]:
    """Fill in the shipped conditions, rendering those that are not in the folder yet."""
    names = [name for name, image in backgrounds.items() if image is None]
    rendered: Mapping[str, Array] = {}
    if names:
        from periscopy_sim.cli.ambient import ambient_photographs

        rendered = ambient_photographs(names, scenario, folder, seed)
    return {name: rendered[name] if image is None else image for name, image in backgrounds.items()}


def _check_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Reject a folder of other settings, or with files of unknown settings.

    Until there are results, the `VARIED` settings may differ.
    """
    held = read_settings(out)
    if held is None:
        refuse_results(out, (*RENDERED, *RESULTS))
        return
    if not (out / STORE).exists():
        held |= {name: settings[name] for name in VARIED}
    check_settings(held, settings, str(out), "sweep")


def _say_means(results: xr.Dataset) -> None:
    """Print the mean error of each method at each SBR, and the failures."""
    errors = results["mean_squared_error"].mean(("background", "seed"))  # of what did not fail
    names = [str(name) for name in results["algorithm"].values]
    heading = "mean squared error at SBR"
    width = max(map(len, [heading, *names]))
    say(f"{heading:{width}}" + "".join(f"{sbr:9g}" for sbr in results["sbr"].values))
    for name, of_method in zip(names, errors.transpose("algorithm", "sbr").values, strict=True):
        cells = (f"{'failed':>9}" if np.isnan(error) else f"{error:9.5f}" for error in of_method)
        say(f"{name:{width}}{''.join(cells)}")
    for name in names:
        messages = results["failure"].sel({"algorithm": name}).values.ravel()
        failed = messages[messages != ""]
        if failed.size:
            say(f"{name} failed on {failed.size} of {messages.size}, first: {failed[0]}")
