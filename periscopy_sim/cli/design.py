"""`periscopy design`: where to look, which occluder, how long to expose."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import options
from periscopy_sim.cli.light import LightModel, check_memory
from periscopy_sim.cli.options import Model, number, option, parse_list, parse_ranges
from periscopy_sim.cli.output import (
    check_folder,
    progress,
    say,
    say_written,
    to_be_continued,
    warn,
    write_json,
)
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError, SceneError
from periscopy_sim.storage.outputs.resume import alone_in, write_settings
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.evaluation.design import Design, Row
    from periscopy_sim.evaluation.merit import Comparison
    from periscopy_sim.scenario import Scenario

FILES = TABLE, RECORD, PICTURE, BEST = "design.csv", "design.json", "design.png", "best.xml"

VALUES = {1: 21, 2: 11}
"""Grid values of each of one or two parameters; more parameters are drawn at random."""

MOST_POINTS = 20_000
"""Limit of points, which take hours at a second each."""

LISTED = 5
"""Points that the command prints."""


class By(StrEnum):
    """Criterion that ranks the points."""

    bound = "bound"
    told = "told"
    time = "time"


NUMBER = {By.bound: "bound", By.told: "told_error", By.time: "exposure_time"}
"""Number of a `Merit` that ranks."""


class Equal(StrEnum):
    """Quantity that all scenes share, see `periscopy_sim.evaluation.merit`."""

    level = "level"
    time = "time"


_BY = "Least Cramer-Rao bound, least error that noise-aware reports, or shortest exposure."
_EQUAL = "Scenes share SNR and SBR (level), or exposure and the room's light (time)."


def design(
    scene: options.SceneArgument,
    vary: Annotated[
        str, option("NAME=LOW:HIGH,...", "Scene <default>s to vary: occluder_dx=-0.05:0.05.")
    ],
    out: options.ResumedFolder,
    hidden: options.Hidden = "15x18",
    grid: Annotated[
        int | None,
        option("NUMBER", "Values of each parameter, all combined.", min=1, max=MOST_POINTS),
    ] = None,
    draws: Annotated[
        int | None,
        option("NUMBER", "Points spread evenly, instead of a grid.", min=1, max=MOST_POINTS),
    ] = None,
    by: Annotated[By, typer.Option(help=_BY)] = By.bound,
    equal: Annotated[Equal, typer.Option(help=_EQUAL)] = Equal.level,
    sbr: Annotated[
        float, number("Signal-to-background ratio; inf: no ambient light.", form="RATIO")
    ] = 0.5,
    snr: options.Snr = 60.0,
    images: Annotated[
        str, option("LIST", "Images that noise-aware recovers, by comma, or none.")
    ] = "mushroom,still_life,letters",
    samples: options.Samples = 36,
    model: options.ModelOption = Model.rendered,
    light_model: options.LightModelOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Find where to look, which occluder to take, and how long.

    The command compares scenes over their <default>s: a curve of one, a map of two, a ranking of
    more. It writes the best scene. The same command resumes an interrupted design.
    """
    from periscopy_sim.evaluation.design import Design, points_of, ranked, run_design
    from periscopy_sim.evaluation.merit import Comparison
    from periscopy_sim.evaluation.sweep import image_sha256
    from periscopy_sim.figures.design import draw_design

    session = Session(scene, hidden, define, seed)
    path, given, size = session.path, session.definitions, options.parse_size(hidden)
    ranges = _ranges(vary, path, given)
    if grid is not None and draws is not None:
        raise PeriscopyError("--grid and --draws both set the points; give one of them")
    if draws is None and grid is None:
        grid = VALUES.get(len(ranges))
    if grid is not None and grid ** len(ranges) > MOST_POINTS:
        raise PeriscopyError(f"--grid {grid}: more than {MOST_POINTS} points; give --draws instead")
    comparison = Comparison(snr, sbr, equal_time=equal is Equal.time)
    shown = [] if images == "none" else parse_list("--images", images)
    if by is By.told and not shown:
        raise PeriscopyError("--by told needs images; leave --images out")
    prototypes = LightModel.of(light_model, seed)
    whole = Design(
        path=path,
        hidden=size,
        parameters=given,
        points=points_of(ranges, grid, draws or 64, seed),
        comparison=comparison,
        transport=lambda scenario: _transport(scenario, samples, model, seed),
        prototypes=prototypes.matrix,
        images={name: session.hidden_image(name) for name in shown},
    )
    check_memory(session.scenario)
    provenance = session.provenance
    settings = {
        **{name: value for name, value in provenance.items() if name not in ("command", "scene")},
        "hidden_shape": list(size),
        "ranges": {name: list(ends) for name, ends in ranges.items()},
        "grid": grid,
        "seed": seed,
        "snr": snr,
        "sbr": str(sbr),
        "equal": equal.value,
        "images": [[name, image_sha256(image)] for name, image in whole.images.items()],
        "samples": samples,
        "model": model.value,
        **prototypes.origin,
    }
    check_folder(out, settings, "design", FILES)
    whole.scenario({})
    with to_be_continued(), alone_in(out):
        check_folder(out, settings, "design", FILES)
        write_settings(out, settings)
        with progress("designing", "scenes") as report:
            rows = run_design(whole, out / TABLE, report)
        order = ranked(rows, NUMBER[by])
        best = order[0] if order else None
        caption = _caption(comparison, hidden)
        with staged_file(out / PICTURE) as file:
            draw_design(file, rows, best, grid, caption=caption, metadata=session.metadata)
        if best is None:
            (out / BEST).unlink(missing_ok=True)  # of another --by
        else:
            remark = f"periscopy design: best of {len(order)} by {by.value}; {caption}"
            _write_best(out / BEST, whole, best, remark)
        edges = [] if best is None else _at_border(ranges, best)
        record = {
            **{name: value for name, value in settings.items() if name not in provenance},
            "by": by.value,
            "as_it_stands": _finite(rows[0]),
            "best": best and _finite(best),
            "best_at_the_border_of": edges,
            "ranking": [row["point"] for row in order],
            "failed": {str(row["point"]): row["failure"] for row in rows if row["failure"]},
            "points": list(map(_finite, rows)),
            "provenance": provenance,
        }
        with staged_file(out / RECORD) as file:
            write_json(file, record)
    _say(rows, order, edges)
    names = (RECORD, TABLE, PICTURE, *([] if best is None else [BEST]))
    say_written(*(out / name for name in names))


def _ranges(vary: str, path: Path, given: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Read ``--vary``, whose names are those of numbers of the scene."""
    from periscopy_sim.calibration.prior import start_values
    from periscopy_sim.rendering.scene.document import read_document

    ranges, errors = parse_ranges(vary, "--vary"), read_document(path).errors
    for name in ranges.keys() & errors.keys():
        raise SceneError(f"--vary {name}: a measurement error cannot vary; vary {errors[name]}")
    start_values(path, list(ranges), given)
    return ranges


def _transport(scenario: Scenario, samples: int, model: Model, seed: int) -> Any:
    """Return A, rendered without random rays, whose noise would look like information."""
    if model is Model.analytic:
        from periscopy_sim.analytic.area_transport import analytic_transport

        return analytic_transport(scenario)
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    return render_transport(scenario, samples=samples, strata="gauss", seed=seed)


def _caption(comparison: Comparison, hidden: str) -> str:
    light = f"SBR {comparison.sbr:g}" if comparison.has_ambient_light else "no ambient light"
    equal = "in equal time" if comparison.equal_time else "at an equal level"
    return f"{hidden} patches, {comparison.snr:g} dB, {light}, {equal}"


def _write_best(path: Path, design: Design, best: Row, remark: str) -> None:
    """Write the scene of a point; check that it loads."""
    from periscopy_sim.calibration.calibrated_scene import write_copy
    from periscopy_sim.rendering.scene.load import load_scenario

    with staged_file(path) as staged:
        write_copy(design.path, {**design.parameters, **best["values"]}, staged, remark)
        load_scenario(staged, design.hidden)


def _at_border(ranges: Mapping[str, tuple[float, float]], row: Row) -> list[str]:
    """Return the parameters of a point that lie at an end of their range."""
    values = {name: float(text) for name, text in row["values"].items()}
    ends = {name: np.isclose(values[name], ranges[name], atol=1e-12).any() for name in values}
    return [name for name, is_end in ends.items() if is_end and row["point"] > 0]


def _finite(row: Row) -> Row:
    """Return a row without infinities, which JSON lacks."""
    return {name: "inf" if value == float("inf") else value for name, value in row.items()}


def _say(rows: list[Row], order: list[Row], edges: list[str]) -> None:
    """Print the given scene, the best points and warnings."""
    failed = [row for row in rows if row["failure"]]
    for row in failed[:LISTED]:
        warn(f"{_place(row)}: {row['failure']}")
    if len(failed) > LISTED:
        warn(f"{len(failed) - LISTED} more points failed, see {TABLE}")
    has_errors = rows[0]["told_error"] is not None
    names = ("bound", *(("told_error", "error") if has_errors else ()))
    say("bound" + "  stderr error" * has_errors + "  time    point (errors in % of white)")
    for row in [rows[0], *(row for row in order[:LISTED] if row["point"])]:
        errors = "  ".join(f"{100 * row[name]:<5.3g}" for name in names)
        time = row["exposure_time"]
        say(f"{errors}  {'-' if time is None else f'{time:.3g}':<6}  {_place(row)}")
        if row["remark"]:
            warn(f"{_place(row)}: {row['remark']}")
    if not order:
        warn("no point is best: no scene determines all patches; choose fewer (--hidden)")
    elif order[0]["point"] == 0:
        say("no point is better than the given scene")
    elif edges:
        say(f"the best point is at the limit of {', '.join(edges)}: widen that range")


def _place(row: Row) -> str:
    values = ", ".join(f"{name}={value}" for name, value in row["values"].items())
    return values if row["point"] else f"given scene ({values})"
