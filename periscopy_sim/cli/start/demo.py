"""`periscopy demo`: photograph and reconstruction of a shipped scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np

from periscopy_sim.cli.light import TransportRequest
from periscopy_sim.cli.options import Out, Seed, option
from periscopy_sim.cli.output import fixable, output_folder, say
from periscopy_sim.cli.session import Session

if TYPE_CHECKING:
    from periscopy_sim.scenario import Array

SBR = 0.5
SNR = 60.0
LAMPS = ((-1.3, 1.7, 1.1), (1.9, 3.2, 1.4))
"""(across, away, up), metres, of Eq. 4's lamps, which replace path tracing by scalar variants."""
COLOUR = (1.0, 0.9, 0.85)


def demo(
    out: Out,
    hidden: Annotated[str | None, option("ROWSxCOLUMNS", "Patches of the hidden image.")] = None,
    resolution: Annotated[int | None, option("NUMBER", "Pixels along each side.", min=2)] = None,
    image: Annotated[str, option("IMAGE", "The hidden image.")] = "mushroom",
    seed: Seed = 0,
    effort: Annotated[
        float, option("NUMBER", "Fraction of the path tracer's samples.", min=0, max=1, hidden=True)
    ] = 1.0,
) -> None:
    """Photograph a shipped scene, and recover its hidden image."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation import metrics
    from periscopy_sim.figures import panels
    from periscopy_sim.measurement import add_noise, composite
    from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
    from periscopy_sim.reconstruction.preconditioned.still import Periscope
    from periscopy_sim.rendering.variant import is_vectorized, use_variant
    from periscopy_sim.storage.formats.exr import write_exr

    with output_folder(out) as folder:
        say(f"rendering with {use_variant()}")
        fast = is_vectorized()
        patches = hidden or ("29x36" if fast else "14x18")
        pixels = resolution or (126 if fast else 63)
        session = Session("chair", patches, [f"resolution={pixels}"], seed)
        scenario, timed = session.scenario, session.timed
        truth = session.hidden_image(image)
        with timed("transport matrix"):
            A = TransportRequest(16, seed).matrix(scenario)
        signal, ambient = _light(session, truth, effort) if fast else _slow_light(session, truth)
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
        text = session.metadata
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
    say(
        f"PSNR {psnr:.1f} dB, by the paper's method {psnr_by_paper:.1f} dB, after one gain per "
        "channel that fits the truth"
    )


def _light(session: Session, truth: Array, effort: float) -> tuple[Array, Array]:
    """Path trace the monitor's light on the wall and the room's, (rows, columns, 3) each."""
    with session.timed("photograph"):
        signal = session.synthetic_photograph(truth, max(1, round(effort * 4096)))
    with session.timed("ambient light"):
        target = 3e-4 / math.sqrt(max(effort, 1e-3))
        return signal, session.ambient_light("ceiling_panels", target)


def _slow_light(session: Session, truth: Array) -> tuple[Array, Array]:
    """Return direct light, where path tracing takes minutes, by another A and by Eq. 4."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds

    scenario = session.scenario
    with session.timed("photograph"):
        again = TransportRequest(16, session.seed + 1).matrix(scenario)
        seen = again @ truth.reshape(-1, 3)
        signal = seen.reshape(*scenario.photograph_shape, 3) * scenario.channel_gain
    with session.timed("ambient light"):
        lamps = point_light_backgrounds(scenario, np.array(LAMPS)).sum(axis=1)
        return signal, np.multiply.outer(lamps, COLOUR).reshape(signal.shape)
