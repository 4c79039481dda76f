"""`periscopy demo`: photograph and reconstruction of a shipped scene."""

from __future__ import annotations

from typing import Annotated

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.output import say, say_written
from periscopy_sim.cli.photograph import photograph
from periscopy_sim.cli.reconstruct import reconstruct
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.figures import panels
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.staging import staged_file

METHODS = {"preconditioned": "the paper's method", "noise-aware": "noise-aware method"}
"""The methods compared, and how the picture calls them."""


def demo(
    out: options.Out,
    hidden: Annotated[
        str | None, options.option("ROWSxCOLUMNS", "Patches of the hidden image.")
    ] = None,
    resolution: Annotated[
        int | None, options.option("NUMBER", "Pixels along each side.", min=2)
    ] = None,
    seed: options.Seed = 0,
    effort: Annotated[
        float | None,
        options.option("NUMBER", "Fraction of the path tracer's samples.", min=1e-4, max=1),
    ] = None,
) -> None:
    """Photograph a shipped scene, and recover its hidden image."""
    photo, ambient, image = out / "photograph.exr", out / "ambient.exr", "mushroom"
    with staged_file(ambient) as file:
        say(f"rendering with {use_variant()}")
        fast = is_vectorized()  # scalar variants are about 100 times slower
        patches, pixels, fraction = ("29x36", 126, 1.0) if fast else ("14x18", 63, 0.03)
        fraction = effort or fraction
        named = "chair", hidden or patches, [f"resolution={resolution or pixels}"], seed
        scene = PhotoSession(*named)
        if fast:
            light = scene.ambient_light("ceiling_panels", 3e-4 / fraction**0.5)
        else:  # scalar variants trace none: all lamps of Eq. 4
            lamps = ps.point_light_backgrounds(scene.scenario).sum(axis=1)
            light = np.tile(lamps.reshape(*scene.scenario.photograph_shape, 1), 3)
        write_exr(file, light, scene.metadata)
    photograph(scene, image, photo, max(1, round(fraction * 4096)), str(ambient), sbr=0.5, snr=60.0)
    truth = scene.hidden_image(image)
    shown = [("hidden image", panels.displayable(truth, white=1))]
    shown.append(("photograph of the wall", panels.displayable(scene.photograph(photo).values)))
    for method, title in METHODS.items():
        reconstruct(
            photo=photo, session=PhotoSession(*named), light=Light(), out=out / method,
            method=method, numbers=options.StillNumbers(), truth=image,
        )  # fmt: skip
        recovered = np.load(out / method / "reconstruction.npy")
        matched = ps.gain_matched(recovered, truth)
        shown.append((f"{title}: {ps.psnr(recovered, truth):.1f} dB", matched))
    caption = "chair scene, SBR 0.5, SNR 60 dB; PSNR after one gain per channel"
    with staged_file(out / "demo.png") as file:
        panels.draw_panels(file, shown, caption=caption, metadata=scene.metadata)
    say_written(out / "demo.png")
