"""`periscopy design`: where to look, which occluder, how long to expose."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option, parse_definitions, parse_list, parse_size
from periscopy_sim.cli.fitting.prototypes import AskedPrototypes, PrototypesOption
from periscopy_sim.cli.fitting.transport_matrix import (
    Model,
    ModelOption,
    check_memory,
)
from periscopy_sim.cli.output import (
    counted_progress,
    say,
    say_written,
    to_be_continued,
    warn,
    write_json,
)
from periscopy_sim.errors import PeriscopyError, SceneError
from periscopy_sim.evaluation.design.comparison import By, Comparison, Equal
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.resume import (
    alone_in,
    check_settings,
    read_settings,
    refuse_results,
    write_settings,
)
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.evaluation.design.search import Design
    from periscopy_sim.evaluation.design.table import Row
    from periscopy_sim.evaluation.design.variation import Variation
    from periscopy_sim.scenario import Scenario

TABLE, RECORD, PICTURE, BEST = "design.csv", "design.json", "design.png", "best.xml"

VALUES = {1: 21, 2: 11}
"""Values of each parameter on the grid, by how many vary; more are drawn."""

LISTED = 5
"""Points that are printed."""


def design(
    scene: arguments.SceneArgument,
    vary: Annotated[
        str,
        option(
            "NAME=LOW:HIGH,...",
            "The scene's <default>s to vary, each from LOW to HIGH: occluder_dx=-0.05:0.05.",
        ),
    ],
    out: Annotated[
        Path, option("FOLDER", "Folder of results; a design that stopped goes on there.")
    ],
    hidden: Annotated[
        str, option("ROWSxCOLUMNS", "Patches of the hidden image, such as 29x36.")
    ] = "15x18",
    grid: Annotated[
        int | None,
        option(
            "NUMBER",
            "Values of each parameter, all combined. Default: 21 of one parameter, 11 of each of "
            "two.",
            min=1,
            max=10_000,
        ),
    ] = None,
    draws: Annotated[
        int | None,
        option(
            "NUMBER",
            "Points spread evenly over all ranges instead of a grid; a larger number goes on with "
            "a smaller one's. Default: 64 of three parameters or more.",
            min=1,
            max=20_000,
        ),
    ] = None,
    by: Annotated[
        By,
        typer.Option(
            help="What is best: the least Cramer-Rao bound, the least error that the noise-aware "
            "method tells, or the shortest exposure time for the bound of the scene as it stands."
        ),
    ] = By.bound,
    equal: Annotated[
        Equal,
        typer.Option(
            help="What scenes have in common: level, the photograph's SNR and SBR; or time, the "
            "exposure and the room's light, where a scene that sends more light has more of both."
        ),
    ] = Equal.level,
    sbr: Annotated[
        float,
        option(
            "RATIO",
            "Signal-to-background ratio of the scene as it stands; inf: there is no ambient light.",
            callback=arguments.not_nan,
        ),
    ] = 0.5,
    snr: arguments.Snr = 60.0,
    images: Annotated[
        str,
        option(
            "LIST",
            "Images, by comma, that the noise-aware method recovers; none leaves its errors out.",
        ),
    ] = "mushroom,still_life,letters",
    samples: arguments.Samples = 36,
    model: ModelOption = Model.rendered,
    backgrounds: PrototypesOption = None,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
) -> None:
    """Find where to look, which occluder to take, and how long.

    Scenes are compared over their <default>s: a curve of one, a map of two, a ranking of more. The
    best scene is written. A design that was stopped goes on by the same command.
    """
    from periscopy_sim.evaluation.design.search import Design, at_border, ranked, run_design
    from periscopy_sim.figures.design import draw_design

    inputs.refuse_measurements(scene)
    path, given, size = find_scene(scene), parse_definitions(define), parse_size(hidden)
    variation = _variation(vary, path, given, grid, draws, seed)
    comparison = Comparison(snr, sbr, equal)
    shown = {} if images == "none" else {n: n for n in parse_list("--images", images)}
    if by is By.told and not shown:
        raise PeriscopyError("--by told needs images of which errors are told; leave --images out")
    prototypes = AskedPrototypes.of(backgrounds, seed)
    standing = inputs.load(scene, hidden, define)
    whole = Design(
        path=path,
        hidden=size,
        parameters=given,
        variation=variation,
        comparison=comparison,
        transport=lambda scenario: _transport(scenario, samples, model, seed),
        prototypes=prototypes.matrix,
        images={name: inputs.hidden_image(name, size) for name in shown},
    )
    check_memory(standing)
    provenance = inputs.provenance_of(standing, seed)
    settings = _settings(provenance, whole, list(shown), samples, model, prototypes)
    _check_folder(out, settings)
    whole.scenario({})
    with to_be_continued(), alone_in(out):
        _check_folder(out, settings)
        write_settings(out, settings)
        with counted_progress("designing", "scenes") as report:
            rows = run_design(whole, out / TABLE, report)
        order = ranked(rows, by)
        best = order[0] if order else None
        caption = _caption(comparison, hidden)
        with staged_file(out / PICTURE) as file:
            text = as_text(provenance)
            draw_design(file, variation, rows, best, caption=caption, metadata=text)
        if best is None:
            (out / BEST).unlink(missing_ok=True)  # of another --by
        else:
            remark = f"periscopy design: best of {len(order)} by {by.value}; {caption}"
            _write_best(out / BEST, whole, best, remark)
        edges = [] if best is None else at_border(variation, best)
        with staged_file(out / RECORD) as file:
            write_json(file, _record(settings, rows, order, by, edges, provenance))
    _say(rows, order, by, edges)
    names = (RECORD, TABLE, PICTURE, *([] if best is None else [BEST]))
    say_written(*(out / name for name in names))


def parse_ranges(text: str) -> dict[str, tuple[float, float]]:
    """Read ``NAME=LOW:HIGH,...``, each name once."""
    ranges = {}
    entries = [entry.strip() for entry in text.split(",") if entry.strip()]
    for name, ends in parse_definitions(entries, "--vary").items():
        try:
            low, high = map(float, ends.split(":"))
        except ValueError:
            raise PeriscopyError(
                f"--vary {name}={ends} is not of the form NAME=LOW:HIGH, such as "
                "occluder_dx=-0.05:0.05"
            ) from None
        ranges[name.strip()] = (low, high)
    return ranges


def _variation(
    vary: str,
    path: Path,
    given: Mapping[str, str],
    grid: int | None,
    draws: int | None,
    seed: int,
) -> Variation:
    """Return what varies; a PeriscopyError says what cannot."""
    from periscopy_sim.calibration.prior import start_values
    from periscopy_sim.evaluation.design.variation import Variation
    from periscopy_sim.rendering.scene.document import read_document

    ranges = parse_ranges(vary)
    if grid is not None and draws is not None:
        raise PeriscopyError("--grid and --draws both set the points; give one of them")
    errors = read_document(path).errors
    for name in ranges:
        if name in errors:
            raise SceneError(
                f"--vary {name}: it is how well the ruler knows '{errors[name]}'; vary that one"
            )
    if ranges:
        start_values(path, list(ranges), given)
    if draws is None and grid is None:
        grid = VALUES.get(len(ranges))
    return Variation(ranges, None if draws is not None else grid, draws or 64, seed)


def _transport(scenario: Scenario, samples: int, model: Model, seed: int) -> Any:
    """Return A by rays to fixed places of patches: noise of random ones looks like information."""
    if model is Model.analytic:
        from periscopy_sim.analytic.area_transport import analytic_transport

        return analytic_transport(scenario)
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    return render_transport(scenario, samples=samples, strata="gauss", seed=seed)


def _settings(
    provenance: Mapping[str, Any],
    design: Design,
    images: list[str],
    samples: int,
    model: Model,
    prototypes: AskedPrototypes,
) -> dict[str, Any]:
    """Return all that the points' merits depend on."""
    from periscopy_sim.evaluation.sweep import image_sha256

    left_out = ("command", "scene")
    return {
        **{name: value for name, value in provenance.items() if name not in left_out},
        "hidden_shape": list(design.hidden),
        **design.variation.settings(),
        "snr": design.comparison.snr,
        "sbr": str(design.comparison.sbr),
        "equal": design.comparison.equal.value,
        "images": [[name, image_sha256(design.images[name])] for name in images],
        "samples": samples,
        "model": model.value,
        **prototypes.origin,
    }


def _check_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Refuse a folder of another design, or with files that are not known to be of this one."""
    held = read_settings(out)
    if held is not None and (out / TABLE).exists():
        check_settings(held, settings, str(out), "design")
    else:
        refuse_results(out, (TABLE, RECORD, PICTURE, BEST))


def _caption(comparison: Comparison, hidden: str) -> str:
    light = f"SBR {comparison.sbr:g}" if comparison.has_ambient_light else "no ambient light"
    alike = {Equal.level: "at an equal level", Equal.time: "in equal time"}[comparison.equal]
    return f"{hidden} patches, {comparison.snr:g} dB, {light}, {alike}"


def _write_best(path: Path, design: Design, best: Row, remark: str) -> None:
    """Write the scene of a point, and see that it loads from where it lies."""
    from periscopy_sim.calibration.calibrated_scene import write_copy
    from periscopy_sim.rendering.scene.load import load_scenario

    with staged_file(path) as staged:
        write_copy(design.path, {**design.parameters, **best.values}, staged, remark)
        load_scenario(staged, design.hidden)


def _record(
    settings: Mapping[str, Any],
    rows: list[Row],
    order: list[Row],
    by: By,
    edges: list[str],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    from periscopy_sim.evaluation.design.merit import NUMBERS

    def plain(row: Row) -> dict[str, Any]:
        numbers = {name: row.figure(name) for name in NUMBERS}
        told = {n: "inf" if x == float("inf") else x for n, x in numbers.items()}
        return {
            "point": row.number,
            "values": dict(row.values),
            **told,
            "failure": row.failure,
            "remark": "" if row.merit is None else row.merit.remark,
        }

    return {
        **{name: value for name, value in settings.items() if name not in provenance},
        "by": by.value,
        "as_it_stands": plain(rows[0]),
        "best": plain(order[0]) if order else None,
        "best_at_the_border_of": edges,
        "ranking": [row.number for row in order],
        "failed": {str(row.number): row.failure for row in rows if row.failure},
        "points": [plain(row) for row in rows],
        "provenance": provenance,
    }


def _say(rows: list[Row], order: list[Row], by: By, edges: list[str]) -> None:
    """Print the best points beside the scene as it stands, and what failed."""
    failed = [row for row in rows if row.failure]
    for row in failed[:LISTED]:
        warn(f"{_place(row)}: {row.failure}")
    if len(failed) > LISTED:
        warn(f"{len(failed) - LISTED} more points failed; {TABLE} says why")
    told = rows[0].figure("told_error") is not None
    say("bound" + ("  told   error" if told else "") + "  time    point (errors in % of white)")
    for row in [rows[0], *(row for row in order[:LISTED] if row.number)]:
        names = ("bound", *(("told_error", "error") if told else ()))
        errors = "  ".join(f"{100 * (row.figure(name) or 0):<5.3g}" for name in names)
        time = row.figure("exposure_time")
        say(f"{errors}  {'-' if time is None else f'{time:.3g}':<6}  {_place(row)}")
        if row.merit is not None and row.merit.remark:
            warn(f"{_place(row)}: {row.merit.remark}")
    tried = [row for row in rows[1:] if not row.failure]
    if not tried:
        warn("every point failed, so that none is best")
    elif by is By.time and rows[0].figure("bound") == float("inf"):
        warn(
            "the scene as it stands does not tell all patches, so that no time equals its bound: "
            "rank --by bound"
        )
    elif not order:
        other = "" if by is By.told else ", or rank --by told"
        warn(
            "no point tells all patches, so that none is best: ask for fewer patches by "
            f"--hidden{other}"
        )
    elif order[0].number == 0:
        say("no point is better than the scene as it stands")
    elif edges:
        say(f"the best lies at the border of {', '.join(edges)}: better ones may lie beyond")


def _place(row: Row) -> str:
    values = ", ".join(f"{name}={value}" for name, value in row.values.items())
    return f"as it stands ({values})" if row.number == 0 else values
