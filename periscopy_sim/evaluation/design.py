"""How well a scene determines its hidden image: the paper's diagnostics, and designs.

The paper's diagnostics are condition numbers, angles between subspaces, and bounds. A design
compares scenes over a grid of one or two parameters. All photographs are exposed to the same mean,
so that scenes share SNR and SBR, and more light alone gains nothing. Random rays give A noise that
looks like information: use an A without noise, by ``strata="gauss"``, see `render_transport`.

A point that makes no scene fails alone. An interrupted design resumes from its table.
"""

import csv
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import linalg

from periscopy_sim.calibration.prior import start_values
from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.evaluation.metrics import write_table
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.measurement import noise_level, noise_to_signal
from periscopy_sim.model.fit import Fit
from periscopy_sim.model.transport_operator import RANK_TOLERANCE
from periscopy_sim.numerics import Array, Image, Mask, validation
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.differencing import neighbour_differences
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned import Preconditioner, form_preconditioner
from periscopy_sim.rendering.bounced import channels_mean
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import image_sha256, provenance, resumed_folder


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """The paper's figures of a scene (Sec. 2 and 3.3)."""

    condition_A: float  # cond(A)
    condition_DA: float  # cond(D A), D the differences of neighbouring entries of the photograph
    background_rank: int  # dimension kept of range(B)
    # Principal angles between range(A) and the range kept of B, in degrees. The largest is what
    # MATLAB's `subspace` gives; the smallest says how much information the background costs.
    largest_angle: float
    smallest_angle: float
    identity_error: float  # largest entry of |P A − I|
    residual_background: float  # mean over B's columns of 100 ‖P B_i‖ / (‖P‖ ‖B_i‖), in percent
    bound_ratio: float  # summed Cramér-Rao bounds with A alone over those with [A, B]; at most 1
    bounds: Array  # (R, C) Cramér-Rao bound on a patch's standard deviation for unit pixel noise
    bounds_without_background: Array  # (R, C) the same with A alone


def diagnose(
    A: Image,
    B: Image,
    photograph_shape: tuple[int, int],
    hidden: Hidden | Size,
    *,
    photograph: Photograph | None = None,
    rank_tolerance: float = RANK_TOLERANCE,
) -> Diagnostics:
    """Compute the paper's figures for one scene.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds.
    photograph_shape
        (rows, columns) with the product M.
    hidden
        The hidden surfaces of the N patches, or the size (R, C) of one.
    photograph
        A photograph, of which the mask and the photographs with the monitor off count: these are
        further columns of B. None for everywhere and none.
    rank_tolerance
        Relative tolerance on B's singular values.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, or A has not full
        column rank beside B.
    """
    surfaces = Hidden.of(hidden)
    fit = Fit(A, B, hidden=surfaces, photograph_shape=photograph_shape, conditions=photograph)
    mask = None if photograph is None else photograph.mask
    used, B = fit.rows, fit.used(fit.whole_background)
    P = form_preconditioner(used, B, rank_tolerance=rank_tolerance)
    alone = form_preconditioner(used)
    A, matrix = P.A, P.matrix()
    angles = np.rad2deg(linalg.subspace_angles(A, P.Q)) if P.Q.shape[1] else np.array([90.0])
    return Diagnostics(
        condition_A=condition_number(A),
        condition_DA=condition_number(neighbour_differences(A, photograph_shape, mask=mask)),
        background_rank=P.Q.shape[1],
        largest_angle=float(angles.max()),
        smallest_angle=float(angles.min()),
        identity_error=float(np.abs(matrix @ A - np.eye(A.shape[1])).max()),
        residual_background=100 * float(residual_background(P, B).sum() / max(B.shape[1], 1)),
        bound_ratio=float(alone.noise_gain.sum() / P.noise_gain.sum()),
        bounds=surfaces.image(np.sqrt(P.noise_gain)),
        bounds_without_background=surfaces.image(np.sqrt(alone.noise_gain)),
    )


def analyze(
    scenario: Scenario,
    *,
    mask: Mask | None = None,
    monitor_off: Mapping[str, Array] | None = None,
    rank_tolerance: float = RANK_TOLERANCE,
) -> tuple[Diagnostics, Photograph]:
    """Return the paper's figures of a scene, and the photograph of a white screen.

    Rays, where A needs them, are those of a quadrature: the noise of random ones would count as
    information. The pixels of the mask count, and photographs with the monitor off, by name, are
    further columns of B. Errors are those of `diagnose` and of `Scenario.transport`.
    """
    validation.checked_scene(scenario)
    scenario = replace(scenario, light=replace(scenario.light, strata="gauss"))
    A, off = channels_mean(scenario.transport()), monitor_off or {}
    white = A.sum(axis=1).reshape(*scenario.photograph_shape, 1)
    channels = next(iter(off.values()), white)
    wall = Photograph(np.broadcast_to(white, channels.shape), mask, off)
    found = diagnose(
        np.asarray(A), scenario.B, wall.values.shape[:2], scenario.hidden, photograph=wall,
        rank_tolerance=rank_tolerance,
    )  # fmt: skip
    return found, wall


def condition_number(A: Image) -> float:
    """Ratio of the largest to the smallest singular value of an (M, N) matrix."""
    # The triangular factor has the same singular values at N/M of the cost.
    R = linalg.qr(np.asarray(A, np.float64), mode="r", check_finite=False)[0]
    σ = linalg.svdvals(R[: A.shape[1]])
    return float(σ[0] / σ[-1]) if σ[-1] > 0 else float("inf")


def residual_background(P: Preconditioner, B: Image) -> Array:
    """Return the residual of each prototype background: ‖P B_i‖ / (‖P‖ ‖B_i‖), (L,).

    P carries the units of 1/A, its spectral norm too: ‖P‖ = 1 / σ_min(A⊥), from its Cholesky
    factor. A column of zeros gives 0.
    """
    norms = np.linalg.norm(B, axis=0)
    residual = np.linalg.norm(P.apply(B), axis=0) / np.where(norms > 0, norms, 1)
    return np.asarray(residual * linalg.svdvals(P.cholesky)[-1])


NUMBERS = ("bound", "reported_error", "error")
"""Errors of a scene, as `errors_of` returns them: standard deviations, white is 1."""

IMAGES = "mushroom", "still_life", "letters"
TABLE, RESULTS = "design.csv", ("best.xml", "design.json", "design.png")
"""Files of a design: its points, and what the command makes of them."""

FIXED = ("point", *NUMBERS, "failure")

Row = dict[str, Any]
"""A point: its number ``point``, 0 of the given scene; the parameters' values as text, by
their names; the `NUMBERS`, None where missing; ``failure``, why it is no scene."""


def grid_of(ranges: Mapping[str, tuple[float, float]], count: int) -> list[dict[str, str]]:
    """Return all combinations of `count` values of each parameter, both ends included, as text."""
    steps = [np.linspace(*ends, count) for ends in ranges.values()]
    return [dict(zip(ranges, map(as_text, point), strict=True)) for point in product(*steps)]


def as_text(value: float) -> str:
    """Return a number as text for a scene file; whole numbers without a point, for pixel counts."""
    return f"{round(value, 12) + 0.0:.9g}"


def errors_of(
    scenario: Scenario,
    A: Image,
    B: Image,
    images: Sequence[Array] = (),
    *,
    snr: float = 60.0,
    sbr: float = 0.5,
    pixels: int | None = None,
) -> dict[str, float]:
    """Return how well a scene determines its hidden image, by the names of `NUMBERS`.

    ``bound`` is the root of the patches' mean Cramér-Rao bound, σ² tr (A⊥ᵀA⊥)⁻¹ / N, with range(B)
    projected out and σ the noise of a white screen's photograph; it is infinite if the photograph
    does not determine all patches. ``reported_error`` and ``error`` are the root mean squares of
    the standard errors that the noise-aware method reports and of its actual errors, over the
    images; without images, the bound is alone.

    A is (M, N), B (M, L), the images are (R, C, channels) in [0, 1], the SNR is in dB; an infinite
    SBR is no ambient light. A photograph of `pixels` has this SNR, which others share the electrons
    of; None for M. A ValueError says that no pixel is left, or B explains all of A.
    """
    B = B if np.isfinite(sbr) else np.zeros((len(A), 0))
    norms = np.linalg.norm(B, axis=0)
    light = np.asarray(B @ (1 / np.where(norms > 0, norms, np.inf)), np.float64)
    gain = scenario.channel_gain
    ambient = light[:, None] / (light.mean() or 1.0) * gain
    finer = np.sqrt(len(A) / (pixels or len(A)))

    def exposed(f: Array) -> tuple[Array, float]:
        """Return the photograph of images, (N, C), (M, C), and its noise's standard deviation."""
        signal = (A @ f) * gain
        photograph = signal + ambient * (signal.mean() / sbr)
        return photograph, noise_level(photograph, snr) * finer

    hidden = scenario.hidden
    _, σ = exposed(np.ones((hidden.patches, gain.shape[-1])))
    grey = σ * np.sqrt(np.mean(1 / gain**2))  # each channel divided by its gain
    bound = float(grey * _unit_bound(Fit(A, B, hidden=hidden)))
    if not images:
        return {"bound": bound}
    squares = []
    with warnings.catch_warnings(action="ignore"):  # a weak scene shows in its errors
        method = NoiseAware.for_scene(scenario, A, B)
        for seed, f in enumerate(map(hidden.vector, images)):
            noisy = np.random.default_rng([0, seed]).normal(*exposed(f))
            solution = method.solve(noisy.reshape(*scenario.photograph_shape, -1))
            reported = hidden.vector(method.standard_errors(solution))
            errors = reported, hidden.vector(solution.image) - f
            squares.append([np.mean(each**2) for each in errors])
    reported_error, error = np.sqrt(np.mean(squares, axis=0)).tolist()
    return {"bound": bound, "reported_error": reported_error, "error": error}


def _unit_bound(fit: Fit) -> float:
    """Return the root of the mean bound for unit noise; infinite if the wall hides a pattern."""
    curvatures = np.linalg.eigvalsh(fit.operator.gram)
    light = fit.operator.whole_squared_norm / len(curvatures)
    is_seen = curvatures[0] > fit.least_curvature * light
    return float(np.sqrt(np.mean(1 / curvatures))) if is_seen else np.inf


def values_of(row: Row) -> dict[str, str]:
    """Return the values of a row's parameters, by name."""
    return {name: each for name, each in row.items() if name not in FIXED}


def design(
    scenario: Scenario,
    vary: Mapping[str, tuple[float, float]],
    out: str | Path | None = None,
    *,
    grid: int = 11,
    images: Sequence[Any] = IMAGES,
    snr: float = 60.0,
    sbr: float = 0.5,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> list[Row]:
    """Compare scenes over one or two of their parameters: where to look, which occluder to take.

    Parameters
    ----------
    scenario
        The given scene, the first point.
    vary
        Ends of the range of each of one or two <default>s.
    out
        Folder of ``design.csv``, from which the same call resumes; None for no file.
    grid
        Values of each parameter, all combined.
    images
        Pictures as of `Scenario.image`, which the noise-aware method recovers; without any, the
        bound is alone.
    snr, sbr
        Signal-to-noise ratio in dB, signal-to-background ratio; infinite without ambient light.
    progress
        Called with how many points are done, and of how many.

    Returns
    -------
    list of dict
        A `Row` for each point; `ranked` sorts them.
    """
    validation.checked_scene(scenario)
    if out is None:
        with TemporaryDirectory() as name:
            return design(
                scenario, vary, name, grid=grid, images=images, snr=snr, sbr=sbr, progress=progress
            )
    if not 0 < len(vary) < 3:
        raise PeriscopyError("vary: name one or two parameters")
    for name, value, kind in (
        ("snr", snr, "decibels"),
        ("sbr", sbr, "sbr"),
        ("grid", grid, "grid"),
    ):
        validation.checked(name, value, kind)
    for name, ends in vary.items():
        if len(validation.checked(f"vary {name}", ends, "parameter")) != 2:
            raise PeriscopyError(f"vary {name}: give the two ends of its range")
    base = replace(scenario, light=replace(scenario.light, strata="gauss"))
    start = start_values(scenario.document, list(vary))
    points = [dict(zip(vary, map(as_text, start), strict=True)), *grid_of(vary, grid)]
    pictures = [scenario.image(each) for each in validation.listed(images)]
    noise, pixels = noise_to_signal(snr, sbr), scenario.transport_shape[0]

    def errors(values: Mapping[str, str]) -> dict[str, float]:
        """Return the errors of the scene with these values."""
        moved = base.at(**values)
        A = channels_mean(moved.transport(noise))
        return errors_of(moved, A, moved.B, pictures, snr=snr, sbr=sbr, pixels=pixels)

    origin = provenance(scenario.document, scenario.seed)
    settings = {
        **{n: each for n, each in origin.items() if n not in ("command", "scene")},
        "camera": scenario.view.camera,
        "bounces": validation.bounces_in_words(base.light.bounces),
        "ambient_prototypes": base.light.prototypes,
        "hidden_shape": scenario.hidden.unwrapped(scenario.hidden.shapes),
        "ranges": {name: list(ends) for name, ends in vary.items()},
        "grid": grid,
        "snr": snr,
        "sbr": str(sbr),
        "images": list(map(image_sha256, pictures)),
        **base.plan(noise).origin,  # what follows from the others comes last in an error
    }
    with resumed_folder(Path(out), settings, "design", (TABLE, *RESULTS)):
        return run_design(points, errors, Path(out) / TABLE, progress)


def run_design(
    points: Sequence[Mapping[str, str]],
    errors: Callable[[Mapping[str, str]], Mapping[str, float]],
    table: Path,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> list[Row]:
    """Assess points, the given scene first; resume from the rows that a table holds.

    `errors` returns the `NUMBERS` of a point's values; a PeriscopyError of any but the first is
    its failure. The table is a CSV file of a row for each point, renewed after each; `progress` is
    called with how many points are done, and of how many. An `OutputError` says that the table
    cannot be read or written, or is of other points.
    """
    rows = _read_table(table)
    if list(map(values_of, rows)) != list(points[: len(rows)]):
        raise OutputError(f"{table} holds points of another design; name another folder")
    for number in range(len(rows), len(points)):
        progress(number, len(points))
        numbers, failure = dict[str, float | None].fromkeys(NUMBERS), ""
        try:
            numbers |= errors(points[number])
        except PeriscopyError as error:
            if number == 0:
                raise
            failure = str(error)
        rows.append({"point": number, **points[number], **numbers, "failure": failure})
        with staged_file(table) as staged:
            write_table(staged, rows)
    return rows


def _read_table(path: Path) -> list[Row]:
    """Read the rows of a table; none without a file. An `OutputError` says that it is damaged."""
    if not path.is_file():
        return []
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            rows: list[Row] = list(csv.DictReader(stream, strict=True))
        for row in rows:
            row["point"] = int(row["point"])
            row |= {name: float(row[name]) if row[name] else None for name in NUMBERS}
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        raise OutputError(f"{path}: is damaged; remove it to start anew") from None
    return rows


def ranked(rows: Sequence[Row], number: str) -> list[Row]:
    """Return the rows where a number is finite, the least first; among equals, the earlier."""
    finite = [row for row in rows if row[number] is not None and np.isfinite(row[number])]
    return sorted(finite, key=lambda row: row[number])
