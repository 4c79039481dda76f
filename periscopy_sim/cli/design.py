"""`periscopy design`: where to look, which occluder, how long to expose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.prior import start_values
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import Model, number, option
from periscopy_sim.cli.output import (
    progress,
    resumed_folder,
    say,
    say_written,
    warn,
    write_json,
)
from periscopy_sim.cli.session import Session, check_memory
from periscopy_sim.errors import PeriscopyError, SceneError
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.evaluation.design import Row

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
    """Quantity that all scenes share, see `Comparison`."""

    level = "level"
    time = "time"


_BY = "Least Cramer-Rao bound, least error that noise-aware reports, or shortest exposure."
_EQUAL = "Scenes share SNR and SBR (level), or exposure and the room's light (time)."


def design(
    session: Annotated[Session, {"hidden": "15x18"}],
    light: Annotated[Light, {"samples": 36, "model": Model.rendered}],
    vary: Annotated[
        str, option("NAME=LOW:HIGH,...", "Scene <default>s to vary: occluder_dx=-0.05:0.05.")
    ],
    out: options.ResumedFolder,
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
) -> None:
    """Find where to look, which occluder to take, and how long.

    The command compares scenes over their <default>s: a curve of one, a map of two, a ranking of
    more. It writes the best scene. The same command resumes an interrupted design.
    """
    from periscopy_sim.evaluation.design import Design, points_of, ranked, run_design
    from periscopy_sim.evaluation.merit import Comparison
    from periscopy_sim.evaluation.sweep import image_sha256
    from periscopy_sim.figures.design import draw_design
    from periscopy_sim.rendering.transport.bounced import channels_mean

    path, given, seed = session.path, session.definitions, session.seed
    ranges = options.parse_ranges(vary, "--vary")
    if fixed := ranges.keys() & read_document(path).errors.keys():
        raise SceneError(f"--vary {', '.join(fixed)}: a measurement error cannot vary")
    start_values(path, list(ranges), given)
    if grid is not None and draws is not None:
        raise PeriscopyError("--grid and --draws both set the points; give one of them")
    if draws is None and grid is None:
        grid = VALUES.get(len(ranges))
    if grid is not None and grid ** len(ranges) > MOST_POINTS:
        raise PeriscopyError(f"--grid {grid}: more than {MOST_POINTS} points; give --draws instead")
    comparison = Comparison(snr, sbr, equal_time=equal is Equal.time)
    shown = [] if images == "none" else options.parse_list("--images", images)
    if by is By.told and not shown:
        raise PeriscopyError("--by told needs images; leave --images out")
    whole = Design(
        path=path,
        hidden=session.size,
        parameters=given,
        points=points_of(ranges, grid, draws or 64, seed),
        comparison=comparison,
        transport=lambda scenario: channels_mean(light.transport(scenario, seed, "gauss")),
        prototypes=light.backgrounds,
        images={name: session.hidden_image(name) for name in shown},
    )
    check_memory(session.scenario)
    provenance = session.provenance
    settings = {
        "hidden_shape": list(session.size),
        "ranges": {name: list(ends) for name, ends in ranges.items()},
        "grid": grid,
        "seed": seed,
        "snr": snr,
        "sbr": str(sbr),
        "equal": equal.value,
        "images": [[name, image_sha256(image)] for name, image in whole.images.items()],
        **{name: value for name, value in light.origin().items() if name != "transport"},
    }
    origin = {name: held for name, held in provenance.items() if name not in ("command", "scene")}
    whole.scenario({})
    with resumed_folder(out, {**origin, **settings}, "design", FILES):
        with progress("designing", "scenes") as report:
            rows = run_design(whole, out / TABLE, report)
        order = ranked(rows, NUMBER[by])
        best = order[0] if order else None
        room = f"SBR {sbr:g}" if comparison.has_ambient_light else "no ambient light"
        fair = "in equal time" if comparison.equal_time else "at an equal level"
        caption = f"{session.hidden} patches, {snr:g} dB, {room}, {fair}"
        with staged_file(out / PICTURE) as file:
            draw_design(file, rows, best, grid, caption=caption, metadata=session.metadata)
        (out / BEST).unlink(missing_ok=True)  # of another --by
        if best is not None:
            remark = f"periscopy design: best of {len(order)} by {by.value}; {caption}"
            with staged_file(out / BEST) as staged:
                write_copy(path, {**given, **best["values"]}, staged, remark)
                ps.load_scenario(staged, session.size)
        edges = [] if best is None else _at_border(ranges, best)
        record = {
            **settings,
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
    say_written(*(out / name for name in FILES if name != BEST or best is not None))


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
    names = ("bound", *(("told_error", "error") if rows[0]["told_error"] is not None else ()))
    say("bound" + "  stderr error" * (len(names) > 1) + "  time    point (errors in % of white)")
    for row in [rows[0], *(row for row in order[:LISTED] if row["point"])]:
        errors = "  ".join(f"{100 * row[name]:<5.3g}" for name in names)
        say(f"{errors}  {row['exposure_time'] or math.nan:<6.3g}  {_place(row)}")
    for row in rows:
        if complaint := row["failure"] or (row in order[:LISTED] and row["remark"]):
            warn(f"{_place(row)}: {complaint}")
    if not order:
        warn(sentence("no_best"))
    if edges:
        say(f"the best point is at the limit of {', '.join(edges)}")


def _place(row: Row) -> str:
    values = ", ".join(f"{name}={value}" for name, value in row["values"].items())
    return values if row["point"] else f"given scene ({values})"
