"""`periscopy analyze`, how well a scene can be seen, and `periscopy design`, where to look."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli import messages, options, output
from periscopy_sim.cli.session import Session, WallSession
from periscopy_sim.figures import panels
from periscopy_sim.hidden import named
from periscopy_sim.measurement import noise_to_signal

MEANINGS = {
    "condition_A": "largest over smallest singular value of A: how much noise may grow",
    "condition_DA": "the same of D A, where D takes differences of neighbouring pixels",
    "background_rank": "dimensions of range(B), ambient light, projected out",
    "largest_angle": "degrees, the largest principal angle between range(A) and range(B)",
    "smallest_angle": "degrees, the smallest: near 0, some image looks like ambient light",
    "identity_error": "largest entry of |P A - I|: 0 but for rounding",
    "residual_background": "% of ambient light that P lets pass, mean of |P B_i|/(|P||B_i|)",
    "bound_ratio": "summed noise variance of patches, by A alone over by [A, B]: 1 at best",
}
"""Meaning, with its unit if any, of each printed number of `Diagnostics`."""


def analyze(
    session: WallSession,
    light: options.LightOptions,
    out: options.Out,
    rank_tolerance: Annotated[float, options.option("NUMBER", kind="tolerance")] = 1e-10,
) -> None:
    """Report how well a scene determines its hidden image.

    The report has condition numbers, angles, residual background and Cramér-Rao bounds.
    """
    from periscopy_sim.evaluation import design

    with output.output_folder(out, ["bounds*.npy"]) as folder:
        session.check_scene()
        scenario = session.lit(light, strata="gauss")
        mask, monitor_off = session.companions()
        session.transport(scenario)
        with output.fixable(f"scene '{scenario.path}'"), output.progress("analyzing"):
            result, wall = design.analyze(
                scenario, mask=mask, monitor_off=monitor_off, rank_tolerance=rank_tolerance
            )
        hidden = scenario.hidden
        bounds = hidden.images(result.bounds)
        alone = hidden.images(result.bounds_without_background)
        files = named("bounds", bounds) | named("bounds_without_background", alone)
        for name, values in files.items():
            np.save(folder / f"{name}.npy", values)
        # For noise of 0.1 % of a photograph of a white screen: a quantity without unit.
        noise = 1e-3 * float(wall.used.mean())
        both = noise * hidden.vector(result.bounds)
        panels.draw_bounds(
            folder / "bounds.png",
            {name: noise * each for name, each in alone.items()},
            {name: noise * each for name, each in bounds.items()},
            caption="Cramér-Rao bound at noise of 0.1 % of a white screen's mean photograph",
            metadata=session.metadata,
        )
        numbers: dict[str, Any] = {name: getattr(result, name) for name in MEANINGS}
        session.write_summary(
            folder / "summary.json", {"rank_tolerance": rank_tolerance, **numbers}
        )
    median, worst = 100 * np.median(both), 100 * both.max()
    output.show_table(
        [n.replace("_", " "), f"{value:.4g}", MEANINGS[n]] for n, value in numbers.items()
    )
    output.conclude(
        f"The median patch is known to ± {median:.2g} % of white, the worst to ± {worst:.2g} %, at "
        "noise of 0.1 % of a white screen's mean photograph."
    )


Rows = Sequence[dict[str, Any]]
"""Points of a design, see `periscopy_sim.evaluation.design.Row`."""

_VARY = "One or two scene <default>s: occluder_dx=-0.05:0.05."
_GRID = "Values of each parameter, all combined."
_BY = "Least Cramér-Rao bound, or least error that noise-aware reports."
_IMAGES = "Images that noise-aware recovers, by comma, or none."
BEST = "best.xml"


def design(
    session: Annotated[Session, {"hidden": ["15x18"]}],
    light: options.LightOptions,
    vary: Annotated[str, options.option("NAME=LOW:HIGH,...", _VARY)],
    out: options.ResumedFolder,
    grid: Annotated[int, options.option("NUMBER", _GRID, kind="grid")] = 11,
    by: Annotated[Literal["bound", "reported"], typer.Option(help=_BY)] = "bound",
    sbr: Annotated[float, options.option("RATIO", kind="sbr")] = 0.5,
    snr: options.Snr = 60.0,
    images: Annotated[str, options.option("LIST", _IMAGES)] = "mushroom,still_life,letters",
) -> None:
    """Find where to look and which occluder to take.

    The command compares scenes over one or two of their <default>s, and writes the best scene. The
    same command resumes an interrupted design.
    """
    from periscopy_sim.evaluation import design as designs
    from periscopy_sim.figures.design import draw_design

    ranges = options.parse_ranges(vary, "--vary")
    names = [] if images == "none" else options.parse_list("--images", images)
    if by == "reported" and not names:
        raise ps.PeriscopyError("--by reported needs images; leave --images out")
    session.check_scene()
    scenario = session.lit(light)
    with output.progress("designing", "scenes") as report:
        rows = designs.design(
            scenario, ranges, out, grid=grid, images=names, snr=snr, sbr=sbr, progress=report
        )
    ranking = designs.ranked(rows, "reported_error" if by == "reported" else "bound")
    document, best = session.scenario.document, ranking[0] if ranking else None
    caption = f"{scenario.hidden.sizes} patches, SNR {snr:g} dB, SBR {sbr:g}"
    record = {
        "hidden_shape": session.hidden_shape, "ranges": ranges, "grid": grid,
        "seed": session.seed, "snr": snr, "sbr": str(sbr), "images": names, "by": by,
        **scenario.plan(noise_to_signal(snr, sbr)).origin, **light.origin, "best": best,
        "ranking": [row["point"] for row in ranking],
        "failed": {row["point"]: row["failure"] for row in rows if row["failure"]},
        "provenance": session.provenance,
    }  # fmt: skip
    with output.output_files(out / "design.json", out / "design.png") as (json, picture):
        units, metadata = document.units, session.metadata
        draw_design(picture, rows, best, units=units, caption=caption, metadata=metadata)
        output.write_json(json, record)
    if best is None:
        (out / BEST).unlink(missing_ok=True)  # of another --by
    else:
        remark = f"periscopy design: best of {len(ranking)} by {by}; {caption}"
        with output.output_files(out / BEST) as (scene,):
            write_copy(document, designs.values_of(best), scene, remark)
            ps.load_scenario(scene, session.sizes, camera=session.sensor)
    output.written(out / "design.csv")
    _show_rows(rows, ranking)


def _show_rows(rows: Rows, ranking: Rows) -> None:
    """Print the errors of the given and the best scene; warn of points that are no scenes."""
    from periscopy_sim.evaluation.design import NUMBERS, values_of

    shown = []
    for row in rows:
        place = ", ".join(f"{name}={value}" for name, value in values_of(row).items())
        if row["failure"]:
            output.warn(f"{place}: {row['failure']}")
        elif row["point"] == 0 or row in ranking[:1]:
            numbers = ("" if row[n] is None else f"{100 * row[n]:.3g} %" for n in NUMBERS)
            shown.append(["best" if row in ranking[:1] else "given", place, *numbers])
    words = (f"{name.replace('_', ' ')}, of white" for name in NUMBERS)
    output.show_table(shown, ["scene", "values", *words])
    if ranking:
        output.conclude(f"best: {shown[-1][1]}", "green")
    else:
        output.warn(messages.sentence("no_best"))
