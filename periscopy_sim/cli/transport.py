"""`periscopy transport`: the light transport matrix of a scene."""

from __future__ import annotations

import json

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.fitting.transport_matrix import (
    AskedTransport,
    BouncesOption,
    Model,
    ModelOption,
    check_memory,
    parse_bounces,
)
from periscopy_sim.cli.output import as_json, say


def transport(
    scene: arguments.SceneArgument,
    hidden: arguments.Hidden,
    out: arguments.OutFile,
    samples: arguments.Samples = 16,
    model: ModelOption = Model.rendered,
    bounces: BouncesOption = "direct",
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
) -> None:
    """Render the light transport matrix A of a scene.

    It is written as an (M, N) float32 NPY file, and a JSON file beside it. Where light bounces, the
    NPY file holds the mean of the channels' matrices, and an NPZ file what they differ by.
    """
    from periscopy_sim.storage.transport_matrix import bounced_of, record_of, transport_writer

    arguments.require_suffix(out, ".npy", "the matrix")
    asked = AskedTransport(samples, seed, model, parse_bounces(bounces))
    with transport_writer(out, asked.bounces) as write:
        scenario = inputs.load(scene, hidden, define)
        check_memory(scenario)
        A = asked.matrix(scenario)
        record = {
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": model.value,
            "samples": samples,
            **inputs.provenance_of(scenario, seed),
        }
        write(A, json.loads(as_json(record)))
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {record_of(out)}")
    if not asked.is_direct:
        say(f"wrote {bounced_of(out)}")
