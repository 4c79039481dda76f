"""`periscopy analyze`: how well a scene can be seen."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import inputs
from periscopy_sim.cli.arguments import (
    Define,
    Hidden,
    MaskOption,
    Out,
    Samples,
    SceneArgument,
    Seed,
)
from periscopy_sim.cli.output import fixable, progress, say, write_json

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)


def analyze(
    scene: SceneArgument,
    hidden: Hidden,
    out: Out,
    samples: Samples = 16,
    model: inputs.ModelOption = inputs.Model.rendered,
    rank_tolerance: Annotated[
        float,
        typer.Option(
            min=1e-15, max=0.5, metavar="NUMBER", help="Relative tolerance on B's singular values."
        ),
    ] = 1e-10,
    mask: MaskOption = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Condition numbers, angles, residual background and Cramer-Rao bounds of a scene."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation import diagnostics
    from periscopy_sim.figures import panels
    from periscopy_sim.reconstruction.observation import observation_of
    from periscopy_sim.storage.outputs.provenance import as_text
    from periscopy_sim.storage.outputs.staging import staged_folder

    with staged_folder(out) as folder:
        scenario = inputs.load(scene, hidden, define)
        used = inputs.read_mask(mask, scenario)
        A = inputs.render_transport(scenario, samples, seed, model)
        B = point_light_backgrounds(scenario)
        with fixable(f"scene '{scenario.path}'"), progress("analyzing") as report:
            found = diagnostics.diagnose(
                A,
                B,
                scenario.photograph_shape,
                scenario.hidden_shape,
                mask=used,
                rank_tolerance=rank_tolerance,
            )
            observed = observation_of(A, scenario.hidden_shape, mask=used)
            seen, modelled = observed.used(A), observed.used(B)
            report(0.4)
            table = []
            for number, tolerance in enumerate(TOLERANCES, 1):
                table.append(diagnostics.rank_row(seen, modelled, tolerance))
                report(0.4 + 0.6 * number / len(TOLERANCES))
        provenance = inputs.provenance_of(scenario, seed)
        # For noise of 0.1 % of a photograph of a white screen: a quantity without unit.
        noise = 1e-3 * float(seen.sum(axis=1).mean())
        maps = {
            "bounds": found.bounds,
            "bounds_without_background": found.bounds_without_background,
        }
        for name, values in maps.items():
            np.save(folder / f"{name}.npy", values)
        panels.draw_maps(
            folder / "bounds.png",
            [
                ("A alone", noise * found.bounds_without_background),
                ("[A, B]", noise * found.bounds),
            ],
            "standard error of a patch, white = 1",
            caption="Cramér-Rao bound at noise of 0.1 % of a white screen's mean photograph",
            metadata=as_text(provenance),
        )
        numbers: dict[str, Any] = {
            name: value for name, value in vars(found).items() if not isinstance(value, np.ndarray)
        }
        settings = {
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": model.value,
            "samples": samples,
            "rank_tolerance": rank_tolerance,
            **inputs.mask_record(mask, used),
        }
        record = {**settings, **numbers, "rank_table": table, "provenance": provenance}
        write_json(folder / "summary.json", record)
    for name, value in numbers.items():
        say(f"{name.replace('_', ' '):24} {value:.6g}")
    say("rank tolerance, rank, largest residual |P B_i|/(|P||B_i|), noise gain trace(P P')")
    for row in table:
        say(
            f"{row['tolerance']:14.0e}  {row['rank']:4d}  {row['residual_background']:10.1e}  "
            f"{row['noise_gain']:.6e}"
        )
    say(f"wrote {out}/summary.json, bounds.png, bounds.npy, bounds_without_background.npy")
