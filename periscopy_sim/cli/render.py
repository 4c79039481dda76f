"""`periscopy photograph`, `periscopy ambient` and `periscopy transport`: what a scene renders."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import SAMPLES, MonitorLight
from periscopy_sim.cli.options import LIGHT, option
from periscopy_sim.cli.output import progress, say
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.ambient_library import ambient_photographs
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_file


def photograph(
    session: Annotated[Session, {"hidden": "29x36"}],
    image: Annotated[
        str, typer.Argument(metavar="IMAGE", help="The hidden image: a file, or a shipped one.")
    ],
    out: options.OutFile,
    samples: Annotated[
        int, option("NUMBER", "Camera samples a pixel.", min=1, max=2**20, group=LIGHT)
    ] = 4096,
    ambient: Annotated[
        str | None,
        option("LIGHT", "Ambient light to add: a photograph or a shipped condition.", group=LIGHT),
    ] = None,
    sbr: Annotated[
        float | None, option("RATIO", "Signal-to-background ratio.", min=1e-6, max=1e6, group=LIGHT)
    ] = None,
    colour_matrix: options.ColourMatrixOption = None,
    snr: options.OptionalSnr = None,
) -> None:
    """Path trace a photograph of the wall, as an EXR file."""
    options.require_suffix(out, ".exr", "the photograph")
    if (ambient is None) != (sbr is None):
        raise PeriscopyError("--ambient and --sbr go together; give both or neither")
    colours = None if colour_matrix is None else ps.read_colour_matrix(colour_matrix)
    settings: dict[str, Any] = {
        "image": image, "hidden": session.hidden, "samples": samples, "ambient": ambient,
        "sbr": sbr, "snr": snr,
        "colour_matrix": None if colours is None else colours.matrix.tolist(),
    }  # fmt: skip
    with staged_file(out) as file:
        session.check_shadows()
        shown = session.hidden_image(image)
        background = None if ambient is None else session.ambient_light(ambient)
        with progress("path tracing the photograph") as report:
            y = ps.render_photograph(
                session.scenario, shown, samples=samples, seed=session.seed, progress=report
            )
        if background is not None and sbr is not None:
            y = ps.composite(y, background, sbr)
        y = y if colours is None else colours.mix(y)
        y = y if snr is None else ps.add_noise(y, snr, session.seed)
        write_exr(file, y, as_text({**settings, **session.provenance}))
    say(f"wrote {out} {y.shape[0]}x{y.shape[1]}")


def ambient(
    scene: options.SceneOption,
    out: options.ResumedFolder,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="Scene files or shipped conditions.")
    ] = None,
    target: Annotated[
        float, option("NUMBER", "Relative error of a pixel to reach.", min=1e-5, max=1)
    ] = 3e-4,
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Photograph the wall of a scene under ambient light.

    The command path traces each condition and writes NAME.exr.
    """
    chosen = names or [*REALISTIC, *ADVERSARIAL]
    scenario = Session(scene, "1x1", define).scenario
    ambient_photographs(chosen, scenario, out, seed, target=target, progress=progress)
    for file in (out / f"{Path(name).stem}.exr" for name in chosen):
        held = read_exr(file)[1]
        error = np.hypot(float(held["relative_error"]), float(held["brightness_error"]))
        say(f"wrote {file}  relative error of a pixel {error:.1e}")


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
        write(A, record)
    beside = record_of(out), *(file for file in (bounced_of(out),) if file.is_file())
    say(f"wrote {out} {A.shape[0]}x{A.shape[1]} and {', '.join(map(str, beside))}")
