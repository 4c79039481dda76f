"""`periscopy demo`: the main job, end to end, on shipped inputs."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.fitting.transport_matrix import AskedTransport
from periscopy_sim.cli.output import Stopwatch, fixable, progress, say, told_folder, write_json
from periscopy_sim.storage.outputs.provenance import as_text

SBR = 0.5
SNR = 60.0
LAMPS = ((-1.3, 1.7, 1.1), (1.9, 3.2, 1.4))
"""Where only scalar works, ambient light is that of these (across, away, up), metres, by Eq. 4."""
COLOUR = (1.0, 0.9, 0.85)


def demo(
    out: arguments.Out,
    hidden: Annotated[
        str | None, option("ROWSxCOLUMNS", "Hidden patches; 29x36, or 14x18 if only scalar works.")
    ] = None,
    resolution: Annotated[
        int | None,
        option("NUMBER", "Pixels along each side; 126, or 63 if only scalar works.", min=2),
    ] = None,
    image: Annotated[str, option("IMAGE", "What the monitor shows.")] = "mushroom",
    seed: arguments.Seed = 0,
    effort: Annotated[
        float, option("NUMBER", "Part of the path tracer's samples.", min=0, max=1, hidden=True)
    ] = 1.0,
) -> None:
    """Photograph a shipped scene, and recover what it hides.

    A hidden monitor and ambient light shine on the wall that is photographed.
    """
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation import metrics
    from periscopy_sim.figures import panels
    from periscopy_sim.measurement import add_noise, composite
    from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
    from periscopy_sim.reconstruction.preconditioned.still import Periscope
    from periscopy_sim.rendering.ambient.background import render_background
    from periscopy_sim.rendering.variant import is_vectorized, use_variant
    from periscopy_sim.storage.formats.exr import write_exr

    timed = Stopwatch()
    with told_folder(out) as folder:
        variant = use_variant()
        say(f"rendering with {variant}")
        fast = is_vectorized()

        patches = hidden or ("29x36" if fast else "14x18")
        pixels = resolution or (126 if fast else 63)
        scenario = inputs.load("chair", patches, [f"resolution={pixels}"])
        truth = inputs.hidden_image(image, scenario.hidden_shape)
        with timed("transport matrix"):
            A = AskedTransport(16, seed).matrix(scenario)
        with timed("photograph"):
            if fast:
                signal = inputs.photograph(scenario, truth, max(1, round(effort * 4096)), seed)
            else:  # path tracing takes minutes: another rendering of A shows the image
                again = AskedTransport(16, seed + 1).matrix(scenario)
                seen = again @ truth.reshape(-1, 3)
                signal = seen.reshape(*scenario.photograph_shape, 3) * scenario.channel_gain
        with timed("ambient light"), progress("path tracing the ambient light") as report:
            if fast:
                ambient = render_background(
                    "ambient/ceiling_panels",
                    scenario,
                    target=3e-4 / math.sqrt(max(effort, 1e-3)),
                    seed=seed + 1,
                    progress=report,
                ).photograph
            else:
                lamps = point_light_backgrounds(scenario, np.array(LAMPS)).sum(axis=1)
                ambient = np.multiply.outer(lamps, COLOUR).reshape(signal.shape)
        photograph = add_noise(composite(signal, ambient, SBR), SNR, seed)
        B = point_light_backgrounds(scenario)
        with timed("form the preconditioner"), fixable(f"scene '{scenario.path}'"):
            periscope = Periscope.for_scene(scenario, A, B)
        with timed("factor for the noise-aware method"):
            method = NoiseAware.for_scene(scenario, A, B)
        for each in (periscope, method):
            each.reconstruct(photograph)  # compiles
        with timed("reconstruct by the paper's method"):
            by_paper = periscope.reconstruct(photograph)
        with timed("reconstruct"):
            recovered = method.reconstruct(photograph)
        light = "ambient light" if fast else "direct light of the monitor, lamps' light"
        provenance = inputs.provenance_of(scenario, seed)
        text = as_text(provenance)
        matched = metrics.gain_matched(recovered, truth)
        psnr, psnr_by_paper = (metrics.psnr(image, truth) for image in (recovered, by_paper))
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
                (
                    f"the paper's method: {psnr_by_paper:.1f} dB",
                    metrics.gain_matched(by_paper, truth),
                ),
                (f"noise-aware method: {psnr:.1f} dB", matched),
            ],
            caption=f"chair scene, {light} {1 / SBR:g} times the signal (SBR {SBR:g}), "
            f"SNR {SNR:g} dB; PSNR after one gain per channel",
            metadata=text,
        )
        summary = {
            "psnr": psnr,
            "psnr_preconditioned": psnr_by_paper,
            "mean_squared_error": metrics.mean_squared_error(recovered, truth),
            "sbr": SBR,
            "snr": SNR,
            "hidden_shape": scenario.hidden_shape,
            "photograph_shape": scenario.photograph_shape,
            "seconds": timed.seconds,
            "provenance": provenance,
        }
        write_json(folder / "summary.json", summary)
    for stage, seconds in timed.seconds.items():
        say(f"{stage:33} {seconds:8.3f} s")
    say(
        f"PSNR {psnr:.1f} dB, by the paper's method {psnr_by_paper:.1f} dB, after one gain per "
        "channel that fits the truth"
    )
