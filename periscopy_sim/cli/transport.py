"""`periscopy transport`: the light transport matrix of a scene."""

from __future__ import annotations

import numpy as np

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.output import say, write_json
from periscopy_sim.storage.outputs.staging import staged_file


def transport(
    scene: arguments.SceneArgument,
    hidden: arguments.Hidden,
    out: arguments.OutFile,
    samples: arguments.Samples = 16,
    model: inputs.ModelOption = inputs.Model.rendered,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
) -> None:
    """Render the light transport matrix A of a scene.

    It is written as an (M, N) float32 NPY file, and a JSON file beside it.
    """
    arguments.require_suffix(out, ".npy", "the matrix")
    record_file = out.with_suffix(".json")
    with staged_file(out) as staged, staged_file(record_file) as staged_record:
        scenario = inputs.load(scene, hidden, define)
        inputs.check_memory(scenario)
        A = inputs.render_transport(scenario, samples, seed, model)
        np.save(staged, A)
        record = {
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": model.value,
            "samples": samples,
            **inputs.provenance_of(scenario, seed),
        }
        write_json(staged_record, record)
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {record_file}")
