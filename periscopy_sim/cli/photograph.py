"""`periscopy photograph`: a synthetic photograph of the wall."""

from __future__ import annotations

from typing import Annotated, Any

import typer

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.options import LIGHT, option
from periscopy_sim.cli.output import fixable, say
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.formats.exr import write_exr
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
        float | None,
        option("RATIO", "Signal-to-background ratio.", min=1e-6, max=1e6, group=LIGHT),
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
        y = session.synthetic_photograph(shown, samples)
        with fixable("photograph"):
            if background is not None and sbr is not None:
                y = ps.composite(y, background, sbr)
            y = y if colours is None else colours.mix(y)
            y = y if snr is None else ps.add_noise(y, snr, session.seed)
        write_exr(file, y, as_text({**settings, **session.provenance}))
    say(f"wrote {out} {y.shape[0]}x{y.shape[1]}")
