"""`periscopy sweep`: methods over ambient light, signal-to-background ratios and noise draws."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli import options
from periscopy_sim.cli.light import SAMPLES, Light
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.output import fixable, progress, say, say_written
from periscopy_sim.cli.render import photograph as take_photograph
from periscopy_sim.cli.render import write_transport
from periscopy_sim.cli.session import Session, WallSession
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.workers import check_scheduler
from periscopy_sim.extras import require_all
from periscopy_sim.figures import panels
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.photograph import Photograph, seen_in
from periscopy_sim.storage.ambient_library import ambient_photographs
from periscopy_sim.storage.outputs.resume import resumed_folder
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.rendering.transport.plan import TransportPlan

RENDERED = ("A*.npy", "photograph.exr", "ambient")
RUN = ("command", "scene", "seed")
"""Provenance that differs from run to run."""
RESULTS = ("sweep.zarr", "sweep.csv", "sweep.png")
VARIED = (
    *("ambient", "ambient_prototypes", "flips", "mask", "methods", "monitor_off"),
    *("sbr", "snr", "seeds"),
)
"""Settings that no rendering depends on: they may change until there are results."""


def sweep(
    session: WallSession,
    light: Light,
    out: options.ResumedFolder,
    photograph: Annotated[
        Path | None,
        option("FILE", "A photograph without ambient light; needs --truth.", group=PHOTOGRAPH),
    ] = None,
    truth: Annotated[
        list[str] | None,
        option("[ID=]IMAGE", "The hidden image of --photograph; of several surfaces of each."),
    ] = None,
    hidden_image: Annotated[
        list[str] | None,
        option("[ID=]IMAGE", "A hidden image whose photograph is path traced; likewise."),
    ] = None,
    sbr: Annotated[
        str, option("RATIOS", "Signal-to-background ratios: 0.1,1,10 or 0.1:10:log:9.")
    ] = "0.1:10:log:9",
    ambient: Annotated[
        str, option("LIST", "all, adversarial, shipped conditions, EXR files or folders of them.")
    ] = "all",
    flips: Annotated[bool, typer.Option(help="Also flip each background about each axis.")] = True,
    methods: Annotated[
        str, option("LIST", "Methods by comma; yours as module:callable or file.py:callable.")
    ] = "noise-aware,preconditioned,differencing",
    snr: options.Snr = 60.0,
    seeds: Annotated[
        int, option("NUMBER", "Noise draws for each background and SBR.", kind="count")
    ] = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Compare methods over ambient light and SBRs.

    The same command resumes an interrupted sweep.
    """
    from periscopy_sim.evaluation import sweep as sweeps

    # Reject wrong values here, before hours of rendering.
    require_all()
    if (photograph is None) == (not hidden_image) or (photograph is None) != (not truth):
        raise PeriscopyError("give either --photograph with --truth, or --hidden-image alone")
    ratios, lights = options.parse_ratios(sbr), options.parse_ambient(ambient)
    names = options.parse_list("--methods", methods)
    light.check_methods(*names)
    check_scheduler(scheduler)
    shown = session.by_surface(
        truth or hidden_image or [], "--truth" if truth else "--hidden-image"
    )
    image = session.hidden_image(shown)
    wall = None if photograph is None else session.wall(photograph)
    mask, monitor_off = session.companions() if wall is None else (wall.mask, wall.monitor_off)
    measured = {n: session.photograph(path, mask).values for n, path in lights.items() if path}
    sums = {name: sweeps.array_sha256(each) for name, each in measured.items()}
    settings = {
        **_settings(session, light, names, mask, monitor_off),
        "photograph": "path traced" if wall is None else sweeps.array_sha256(wall.values),
        "truth": sweeps.image_sha256(image),
        "ambient": [[name, sums.get(name, "rendered")] for name in lights],
        "flips": flips,
        "sbr": ratios,
        "snr": snr,
        "seeds": seeds,
    }
    with resumed_folder(out, settings, "sweep", (*RESULTS, *RENDERED), VARIED):
        session.check_scene()
        if wall is None:
            traced = _path_traced(session, shown, out / "photograph.exr")
            wall = replace(traced, mask=mask, monitor_off=monitor_off)
        noise = noise_to_signal(snr, max(ratios))
        plans = {n: light.plan(session.scenario, noise, session.seed, n) for n in names}
        solvers, digests = _fit_methods(session, light, plans, wall, out)
        whole = sweeps.Sweep(
            signal=wall,
            truth=image,
            backgrounds=_backgrounds(session, lights, measured, wall.channels, out, flips),
            methods=solvers,
            sbrs=ratios,
            snr=snr,
            seeds=range(seeds),
            seed=session.seed,
            transport={name: plan.origin for name, plan in plans.items()},
            conditions={"settings": settings, **digests},
        )
        with progress("sweeping") as report:
            results = sweeps.run_sweep(whole, out, scheduler=scheduler, progress=report)
        with staged_file(out / "sweep.png") as file:
            panels.draw_sweep(file, results, metadata=session.metadata)
    _say_means(results)
    for name, plan in plans.items():
        session.check_error(plan.origin, noise, f"{name}: A")
    say_written(*(out / name for name in RESULTS))


def _settings(
    session: Session,
    light: Light,
    methods: Iterable[str],
    mask: Mask | None,
    monitor_off: Mapping[str, Array],
) -> dict[str, Any]:
    """Return the settings of the scene, its pixels, its A and B, and the methods; these exist."""
    from periscopy_sim.evaluation.methods import find_method, source_sha256
    from periscopy_sim.evaluation.sweep import array_sha256

    for name in methods:
        find_method(name)
    return {
        **{name: value for name, value in session.provenance.items() if name not in RUN},
        "base_seed": session.seed,
        "hidden_shape": session.hidden_shape,
        "model": light.model and light.model.value,
        "samples": light.samples,
        **light.origin,
        "mask": None if mask is None else array_sha256(mask),
        "monitor_off": [array_sha256(image) for image in monitor_off.values()],
        "methods": [[name, source_sha256(name) or "built in"] for name in methods],
    }


def _path_traced(session: Session, shown: Mapping[str, str], file: Path) -> Photograph:
    """Return the photograph of hidden images, from its file if a former run wrote it."""
    if not file.is_file():
        images = [f"{name}={image}" for name, image in shown.items()]
        take_photograph(session=session, images=images, out=file)
    return session.photograph(file)


def _fit_methods(
    session: Session,
    light: Light,
    plans: "Mapping[str, TransportPlan]",
    wall: Photograph,
    out: Path,
) -> tuple[Mapping[str, "Method"], dict[str, Any]]:
    """Return each method, fitted to A as planned for it, and the digests of all A and of B."""
    from periscopy_sim.evaluation.methods import fit_method
    from periscopy_sim.evaluation.sweep import array_sha256

    each = dict.fromkeys(plans.values())
    matrices = {plan: _transport(session, light, plan, out) for plan in each}
    scenario, B = session.scenario, light.backgrounds(session.scenario)
    with fixable(f"scene '{scenario.path}'"), progress("fitting the methods"):
        fitted = {n: fit_method(n, scenario, matrices[p], B, wall) for n, p in plans.items()}
    digests = {name: array_sha256(matrices[plan]) for name, plan in plans.items()}
    return fitted, {"A_sha256": digests, "B_sha256": array_sha256(B)}


def _transport(
    session: Session, light: Light, plan: "TransportPlan", out: Path
) -> "NDArray[np.float32]":
    """Return A as planned: of the folder's file, which is made anew where its plan was another.

    ``A.npy`` is the A of most methods; a method that asks for rays has a file of its own.
    """
    from periscopy_sim.storage.transport_matrix import read_record

    is_own = (plan.samples, plan.across) == (SAMPLES, 1) and light.samples is None
    matrix = out / (f"A_{SAMPLES}_rays.npy" if is_own else "A.npy")
    if not (matrix.is_file() and plan.origin.items() <= read_record(matrix).items()):
        write_transport(session, light, plan, matrix)
    return session.transport(light, matrix=matrix)


def _backgrounds(
    session: Session,
    lights: Iterable[str],
    measured: Mapping[str, Array],
    channels: int,
    out: Path,
    flips: bool,
) -> Mapping[str, Image]:
    """Return ambient light by name, (rows, columns, channels): given or path traced, and flips."""
    from periscopy_sim.evaluation import sweep as sweeps

    names = [name for name in lights if name not in measured]
    traced = ambient_photographs(
        names, session.scenario, out / "ambient", session.seed, progress=progress
    )
    images = {name: seen_in({**traced, **measured}[name], channels) for name in lights}
    return sweeps.flips(images) if flips else images


def _say_means(results: "xr.Dataset") -> None:
    """Print the mean error of each method at each SBR, and the failures."""
    for name, each in panels.errors_of(results).items():
        errors = each.mean(("background", "seed"))  # without failures
        table = errors.transpose("algorithm", "sbr").to_pandas()
        say(name)
        say(table.to_string(float_format="{:.5f}".format, na_rep="failed"))
    for name in table.index:
        messages = results["failure"].sel({"algorithm": name}).values.ravel()
        failed = messages[messages != ""]
        if failed.size:
            say(f"{name} failed on {failed.size} of {messages.size}, first: {failed[0]}")
