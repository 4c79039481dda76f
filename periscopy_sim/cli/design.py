"""`periscopy design`: where to look, and which occluder to take."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated

import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.prior import start_values
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import option
from periscopy_sim.cli.output import progress, say, say_written, warn, write_json
from periscopy_sim.cli.session import Session, check_memory
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.storage.outputs.resume import resumed_folder
from periscopy_sim.storage.outputs.staging import staged_file

FILES = TABLE, RECORD, PICTURE, BEST = "design.csv", "design.json", "design.png", "best.xml"


class By(StrEnum):
    """Criterion that ranks the points."""

    bound = "bound"
    told = "told"


def design(
    session: Annotated[Session, {"hidden": "15x18"}],
    light: Light,
    vary: Annotated[
        str, option("NAME=LOW:HIGH,...", "One or two scene <default>s: occluder_dx=-0.05:0.05.")
    ],
    out: options.ResumedFolder,
    grid: Annotated[
        int, option("NUMBER", "Values of each parameter, all combined.", kind="grid")
    ] = 11,
    by: Annotated[
        By, typer.Option(help="Least Cramer-Rao bound, or least error that noise-aware reports.")
    ] = By.bound,
    sbr: Annotated[
        float, option("RATIO", "Signal-to-background ratio; inf: no ambient light.", kind="sbr")
    ] = 0.5,
    snr: options.Snr = 60.0,
    images: Annotated[
        str, option("LIST", "Images that noise-aware recovers, by comma, or none.")
    ] = "mushroom,still_life,letters",
) -> None:
    """Find where to look and which occluder to take.

    The command compares scenes over one or two of their <default>s, and writes the best scene. The
    same command resumes an interrupted design.
    """
    from periscopy_sim.evaluation import design as designs
    from periscopy_sim.evaluation.sweep import image_sha256
    from periscopy_sim.figures.design import draw_design
    from periscopy_sim.rendering.transport.bounced import channels_mean

    path, given, seed = session.path, session.definitions, session.seed
    ranges = options.parse_ranges(vary, "--vary")
    if len(ranges) > 2:
        raise PeriscopyError("--vary: name one or two parameters")
    start = start_values(session.scenario.document, list(ranges))
    given_point = dict(zip(ranges, map(designs.as_text, start), strict=True))
    points = [given_point, *designs.grid_of(ranges, grid)]
    names = [] if images == "none" else options.parse_list("--images", images)
    if by is By.told and not names:
        raise PeriscopyError("--by told needs images; leave --images out")
    shown = {name: session.hidden_image(name) for name in names}
    check_memory(session.scenario)
    session.check_lights()
    plan = light.plan(session.scenario, noise_to_signal(snr, sbr), seed)
    pixels = session.scenario.transport_shape[0]

    def errors(values: Mapping[str, str]) -> dict[str, float]:
        """Return the errors of the scene with these values."""
        scenario = ps.load_scenario(path, session.size, {**given, **values})
        A = channels_mean(light.transport(scenario, plan, seed, "gauss"))
        B, images = light.backgrounds(scenario), list(shown.values())
        return designs.errors_of(scenario, A, B, images, snr=snr, sbr=sbr, pixels=pixels)

    settings = {
        "hidden_shape": list(session.size),
        "ranges": {name: list(ends) for name, ends in ranges.items()},
        "grid": grid,
        "seed": seed,
        "snr": snr,
        "sbr": str(sbr),
        "images": [[name, image_sha256(image)] for name, image in shown.items()],
        **plan.origin,
        **light.origin,
    }
    origin = {n: each for n, each in session.provenance.items() if n not in ("command", "scene")}
    caption = f"{session.hidden} patches, SNR {snr:g} dB, SBR {sbr:g}"
    with resumed_folder(out, {**origin, **settings}, "design", FILES):
        with progress("designing", "scenes") as report:
            rows = designs.run_design(points, errors, out / TABLE, report)
        order = designs.ranked(rows, "told_error" if by is By.told else "bound")
        best = order[0] if order else None
        with staged_file(out / PICTURE) as file:
            draw_design(file, rows, best, caption=caption, metadata=session.metadata)
        (out / BEST).unlink(missing_ok=True)  # of another --by
        if best is not None:
            remark = f"periscopy design: best of {len(order)} by {by.value}; {caption}"
            with staged_file(out / BEST) as file:
                write_copy(session.scenario.document, designs.values_of(best), file, remark)
                ps.load_scenario(file, session.size)
        record = {
            **settings,
            "by": by.value,
            "best": best,
            "ranking": [row["point"] for row in order],
            "failed": {row["point"]: row["failure"] for row in rows if row["failure"]},
            "provenance": session.provenance,
        }
        with staged_file(out / RECORD) as file:
            write_json(file, record)
    for row in rows:
        place = ", ".join(f"{name}={value}" for name, value in designs.values_of(row).items())
        if row["failure"]:
            warn(f"{place}: {row['failure']}")
        elif row["point"] == 0 or row is best:
            numbers = {name: row[name] for name in designs.NUMBERS if row[name] is not None}
            shown_errors = ", ".join(f"{name} {100 * each:.3g} %" for name, each in numbers.items())
            say(f"{'best' if row is best else 'given scene'} ({place}): {shown_errors} of white")
    if best is None:
        warn(sentence("no_best"))
    say_written(*(out / name for name in FILES if name != BEST or best is not None))
