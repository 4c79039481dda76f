"""`periscopy transport`: the light transport matrix of a scene."""

from __future__ import annotations

import json

from periscopy_sim.cli import options
from periscopy_sim.cli.light import TransportRequest, check_memory
from periscopy_sim.cli.output import as_json, say
from periscopy_sim.cli.session import Session


def transport(
    scene: options.SceneArgument,
    hidden: options.Hidden,
    out: options.OutFile,
    samples: options.Samples = 16,
    model: options.ModelOption = options.Model.rendered,
    bounces: options.BouncesOption = "direct",
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Render the light transport matrix A of a scene.

    The command writes an (M, N) float32 NPY file and a JSON file. Where light bounces, the NPY
    file holds the mean of the channels' matrices, and an NPZ file their differences from it.
    """
    from periscopy_sim.storage.transport_matrix import bounced_of, record_of, transport_writer

    options.require_suffix(out, ".npy", "the matrix")
    request = TransportRequest(samples, seed, model, options.parse_bounces(bounces))
    session = Session(scene, hidden, define, seed)
    with transport_writer(out, request.bounces) as write:
        check_memory(session.scenario)
        A = request.matrix(session.scenario)
        record = {
            "photograph_shape": session.scenario.photograph_shape,
            "hidden_shape": session.scenario.hidden_shape,
            "model": model.value,
            "samples": samples,
            **session.provenance,
        }
        write(A, json.loads(as_json(record)))
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {record_of(out)}")
    if not request.is_direct:
        say(f"wrote {bounced_of(out)}")
