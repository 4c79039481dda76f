"""`periscopy design`: where to look, and which occluder to take."""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.prior import start_values
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light, check_memory
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import option
from periscopy_sim.cli.output import conclude, progress, show_table, warn, write_json, written
from periscopy_sim.cli.session import Session
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.storage.outputs.provenance import image_sha256
from periscopy_sim.storage.outputs.resume import resumed_folder
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.evaluation.design import Row

_VARY = "One or two scene <default>s: occluder_dx=-0.05:0.05."
_GRID = "Values of each parameter, all combined."
_BY = "Least Cramer-Rao bound, or least error that noise-aware reports."
_SBR = "Signal-to-background ratio; inf: no ambient light."
_IMAGES = "Images that noise-aware recovers, by comma, or none."
FILES = TABLE, RECORD, PICTURE, BEST = "design.csv", "design.json", "design.png", "best.xml"


class By(StrEnum):
    """Criterion that ranks the points."""

    bound = "bound"
    reported = "reported"


def design(
    session: Annotated[Session, {"hidden": ["15x18"]}],
    light: Light,
    vary: Annotated[str, option("NAME=LOW:HIGH,...", _VARY)],
    out: options.ResumedFolder,
    grid: Annotated[int, option("NUMBER", _GRID, kind="grid")] = 11,
    by: Annotated[By, typer.Option(help=_BY)] = By.bound,
    sbr: Annotated[float, option("RATIO", _SBR, kind="sbr")] = 0.5,
    snr: options.Snr = 60.0,
    images: Annotated[str, option("LIST", _IMAGES)] = "mushroom,still_life,letters",
) -> None:
    """Find where to look and which occluder to take.

    The command compares scenes over one or two of their <default>s, and writes the best scene. The
    same command resumes an interrupted design.
    """
    from periscopy_sim.evaluation import design as designs
    from periscopy_sim.rendering.transport.bounced import channels_mean

    ranges = options.parse_ranges(vary, "--vary")
    if len(ranges) > 2:
        raise ps.PeriscopyError("--vary: name one or two parameters")
    names = [] if images == "none" else options.parse_list("--images", images)
    if by is By.reported and not names:
        raise ps.PeriscopyError("--by reported needs images; leave --images out")
    for name in names:
        ps.find_image(name)
    start = start_values(session.scenario.document, list(ranges))
    given_point = dict(zip(ranges, map(designs.as_text, start), strict=True))
    points = [given_point, *designs.grid_of(ranges, grid)]
    pictures = {name: session.hidden_image(name) for name in names}
    check_memory(session.scenario)
    session.check_lights()
    plan = light.plan(session.scenario, noise_to_signal(snr, sbr), session.seed)
    pixels = session.scenario.transport_shape[0]

    def errors(values: Mapping[str, str]) -> dict[str, float]:
        """Return the errors of the scene with these values."""
        given = {**session.definitions, **values}
        scenario = ps.load_scenario(session.path, session.sizes, given, camera=session.sensor)
        A = channels_mean(light.transport(scenario, plan, session.seed, "gauss"))
        B, images = light.backgrounds(scenario), list(pictures.values())
        return designs.errors_of(scenario, A, B, images, snr=snr, sbr=sbr, pixels=pixels)

    settings = {
        "hidden_shape": session.hidden_shape,
        "ranges": {name: list(ends) for name, ends in ranges.items()},
        "grid": grid,
        "seed": session.seed,
        "snr": snr,
        "sbr": str(sbr),
        "images": [[name, image_sha256(image)] for name, image in pictures.items()],
        **plan.origin,
        **light.origin,
    }
    origin = {n: each for n, each in session.provenance.items() if n not in ("command", "scene")}
    with resumed_folder(out, {**origin, **settings}, "design", FILES):
        with progress("designing", "scenes") as report:
            rows = designs.run_design(points, errors, out / TABLE, report)
        ranking = designs.ranked(rows, "reported_error" if by is By.reported else "bound")
        _write_results(session, out, rows, ranking, {**settings, "by": by.value})
    best = ranking[0] if ranking else None
    _show_rows(rows, best)
    written(*(out / name for name in FILES if name != BEST or best is not None))


def _write_results(
    session: Session,
    out: Path,
    rows: "Sequence[Row]",
    ranking: "Sequence[Row]",
    settings: Mapping[str, Any],
) -> None:
    """Write the picture, the best scene, if there is one, and the record."""
    from periscopy_sim.evaluation.design import values_of
    from periscopy_sim.figures.design import draw_design

    best = ranking[0] if ranking else None
    caption = "{} patches, SNR {:g} dB, SBR {:g}".format(
        session.scenario.hidden.sizes, settings["snr"], float(settings["sbr"])
    )
    with staged_file(out / PICTURE) as file:
        draw_design(
            file, rows, best, units=session.scenario.document.units, caption=caption,
            metadata=session.metadata,
        )  # fmt: skip
    (out / BEST).unlink(missing_ok=True)  # of another --by
    if best is not None:
        remark = f"periscopy design: best of {len(ranking)} by {settings['by']}; {caption}"
        with staged_file(out / BEST) as file:
            write_copy(session.scenario.document, values_of(best), file, remark)
            ps.load_scenario(file, session.sizes, camera=session.sensor)
    record = {
        **settings,
        "best": best,
        "ranking": [row["point"] for row in ranking],
        "failed": {row["point"]: row["failure"] for row in rows if row["failure"]},
        "provenance": session.provenance,
    }
    with staged_file(out / RECORD) as file:
        write_json(file, record)


def _show_rows(rows: "Sequence[Row]", best: "Row | None") -> None:
    """Print the errors of the given and the best scene; warn of points that are no scenes."""
    from periscopy_sim.evaluation.design import NUMBERS, values_of

    shown = []
    for row in rows:
        place = ", ".join(f"{name}={value}" for name, value in values_of(row).items())
        if row["failure"]:
            warn(f"{place}: {row['failure']}")
        elif row["point"] == 0 or row is best:
            numbers = ("" if row[n] is None else f"{100 * row[n]:.3g} %" for n in NUMBERS)
            shown.append(["best" if row is best else "given", place, *numbers])
    words = (f"{name.replace('_', ' ')}, of white" for name in NUMBERS)
    show_table(shown, ["scene", "values", *words])
    if best is None:
        warn(sentence("no_best"))
    else:
        conclude(f"best: {shown[-1][1]}", "green")
