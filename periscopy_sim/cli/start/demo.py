"""`periscopy demo`: photograph and reconstruction of a shipped scene."""

from __future__ import annotations

from typing import Annotated

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli.light import SAMPLES, Light
from periscopy_sim.cli.options import Model, Out, Seed, option
from periscopy_sim.cli.output import output_folder, say
from periscopy_sim.cli.session import Session
from periscopy_sim.evaluation import metrics
from periscopy_sim.figures import panels
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.rendering.variant import require_vectorized, use_variant
from periscopy_sim.storage.formats.exr import write_exr

SBR = 0.5
SNR = 60.0
CAPTION = (
    f"chair scene, ambient light {1 / SBR:g} times the signal (SBR {SBR:g}), SNR {SNR:g} dB; PSNR "
    "after one gain per channel"
)


def demo(
    out: Out,
    hidden: Annotated[str | None, option("ROWSxCOLUMNS", "Patches of the hidden image.")] = None,
    resolution: Annotated[int | None, option("NUMBER", "Pixels along each side.", min=2)] = None,
    image: Annotated[str, option("IMAGE", "The hidden image.")] = "mushroom",
    seed: Seed = 0,
    effort: Annotated[
        float | None,
        option("NUMBER", "Fraction of the path tracer's samples.", min=1e-4, max=1, hidden=True),
    ] = None,
) -> None:
    """Photograph a shipped scene, and recover its hidden image."""
    with output_folder(out) as folder:
        require_vectorized("the demo")
        say(f"rendering with {use_variant()}")
        fraction = effort or 1.0
        session = Session("chair", hidden or "29x36", [f"resolution={resolution or 126}"], seed)
        scenario, timed = session.scenario, session.timed
        truth = session.hidden_image(image)
        with timed("transport matrix"):
            A = session.transport(Light(SAMPLES, Model.rendered))
        with timed("photograph"):
            signal = session.synthetic_photograph(truth, max(1, round(fraction * 4096)))
        with timed("ambient light"):
            ambient = session.ambient_light("ceiling_panels", 3e-4 / fraction**0.5)
        photograph = add_noise(composite(signal, ambient, SBR), SNR, seed)
        B = ps.point_light_backgrounds(scenario)
        with timed("form the preconditioner"):
            periscope = ps.Periscope.for_scene(scenario, A, B)
        with timed("factor for the noise-aware method"):
            method = ps.NoiseAware.for_scene(scenario, A, B)
        for each in (periscope, method):
            each.reconstruct(photograph)  # compiles
        with timed("reconstruct by the paper's method"):
            by_paper = periscope.reconstruct(photograph)
        with timed("reconstruct"):
            recovered = method.reconstruct(photograph)
        text = session.metadata
        psnr, psnr_by_paper = (metrics.psnr(image, truth) for image in (recovered, by_paper))
        matched, matched_by_paper = (
            metrics.gain_matched(image, truth) for image in (recovered, by_paper)
        )
        np.save(folder / "A.npy", A)
        np.save(folder / "reconstruction.npy", recovered.astype(np.float32))
        write_exr(folder / "photograph.exr", photograph, text)
        panels.write_enlarged(folder / "truth.png", truth, text)
        panels.write_enlarged(folder / "reconstruction.png", matched, text)
        panels.draw_panels(
            folder / "demo.png",
            [
                ("hidden image", panels.displayable(truth, white=1)),
                ("photograph of the wall", panels.displayable(photograph)),
                (f"the paper's method: {psnr_by_paper:.1f} dB", matched_by_paper),
                (f"noise-aware method: {psnr:.1f} dB", matched),
            ],
            caption=CAPTION,
            metadata=text,
        )
        session.write_summary(
            folder / "summary.json",
            {
                "psnr": psnr,
                "psnr_preconditioned": psnr_by_paper,
                "mean_squared_error": metrics.mean_squared_error(recovered, truth),
                "sbr": SBR,
                "snr": SNR,
            },
        )
    for stage, seconds in timed.seconds.items():
        say(f"{stage:33} {seconds:8.3f} s")
    say(f"PSNR {psnr:.1f} dB, by the paper's method {psnr_by_paper:.1f} dB")
