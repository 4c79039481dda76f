"""`periscopy transport`: the light transport matrix of a scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from periscopy_sim.cli import options
from periscopy_sim.cli.light import SAMPLES, MonitorLight
from periscopy_sim.cli.output import as_json, say
from periscopy_sim.cli.session import Session


def transport(
    session: Session,
    light: Annotated[MonitorLight, {"samples": SAMPLES, "model": options.Model.rendered}],
    out: options.OutFile,
) -> None:
    """Render the light transport matrix A of a scene.

    The command writes an (M, N) float32 NPY file and a JSON file. Where light bounces, the NPY
    file holds the mean of the channels' matrices, and an NPZ file their differences from it.
    """
    options.require_suffix(out, ".npy", "the matrix")
    write_transport(session, light, out)


def write_transport(session: Session, light: MonitorLight, out: Path) -> None:
    """Compute A; write it with the files beside it, and print their names."""
    from periscopy_sim.storage.transport_matrix import bounced_of, record_of, transport_writer

    with transport_writer(out, light.most_bounces) as write:
        session.check_scene()
        A = light.transport(session.scenario, session.seed)
        record = {
            "photograph_shape": session.scenario.photograph_shape,
            "hidden_shape": session.scenario.hidden_shape,
            "model": light.model,
            "samples": light.samples,
            **session.provenance,
        }
        write(A, json.loads(as_json(record)))
    beside = record_of(out), *(file for file in (bounced_of(out),) if file.is_file())
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {', '.join(map(str, beside))}")
