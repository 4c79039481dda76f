"""`periscopy analyze`: how well a scene can be seen."""

from typing import Annotated, Any

import numpy as np

from periscopy_sim.cli import options
from periscopy_sim.cli.light import LightOptions
from periscopy_sim.cli.options import option
from periscopy_sim.cli.output import conclude, fixable, output_folder, progress, show_table
from periscopy_sim.cli.session import WallSession
from periscopy_sim.figures import panels
from periscopy_sim.hidden import named

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
    light: LightOptions,
    out: options.Out,
    rank_tolerance: Annotated[float, option("NUMBER", kind="tolerance")] = 1e-10,
) -> None:
    """Report how well a scene determines its hidden image.

    The report has condition numbers, angles, residual background and Cramér-Rao bounds.
    """
    from periscopy_sim.evaluation import diagnostics

    with output_folder(out, ["bounds*.npy"]) as folder:
        session.check_scene()
        scenario = session.lit(light, strata="gauss")
        mask, monitor_off = session.companions()
        session.transport(scenario)
        with fixable(f"scene '{scenario.path}'"), progress("analyzing"):
            result, wall = diagnostics.analyze(
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
    show_table([n.replace("_", " "), f"{value:.4g}", MEANINGS[n]] for n, value in numbers.items())
    conclude(
        f"The median patch is known to ± {median:.2g} % of white, the worst to ± {worst:.2g} %, at "
        "noise of 0.1 % of a white screen's mean photograph."
    )
