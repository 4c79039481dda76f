"""`periscopy transport`: the light transport matrix of a scene."""

from __future__ import annotations

import numpy as np

from periscopy_sim.cli import inputs
from periscopy_sim.cli.arguments import Define, Hidden, OutFile, Samples, SceneArgument, Seed
from periscopy_sim.cli.output import say, write_json
from periscopy_sim.errors import OutputError


def transport(
    scene: SceneArgument,
    hidden: Hidden,
    out: OutFile,
    samples: Samples = 16,
    model: inputs.ModelOption = inputs.Model.rendered,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Render the light transport matrix A as an (M, N) float32 NPY file, and a JSON beside it."""
    from periscopy_sim.storage.outputs.staging import staged_file

    if out.suffix != ".npy":
        raise OutputError(f"--out {out}: the matrix is written as .npy; name a file that ends so")
    with staged_file(out) as matrix_file, staged_file(out.with_suffix(".json")) as record_file:
        scenario = inputs.load(scene, hidden, define)
        A = inputs.render_transport(scenario, samples, seed, model)
        np.save(matrix_file, A)
        record = {
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": model.value,
            "samples": samples,
            **inputs.provenance_of(scenario, seed),
        }
        write_json(record_file, record)
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {out.with_suffix('.json')}")
