"""180 x 144 patches seen by 252 x 252 pixels: A, 6.6 GB, in a memory map, the image without P."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.benchmarks.scene import seconds_text, times_table
from experiments.drawing import PAGE, drawn, show_light
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import SNR, Setting

Array = NDArray[np.float64]

HIDDEN = (144, 180)
RESOLUTION = 252
SBR = 1.0
ROWS = 2048
"""Rows of A read at once to make the photograph."""

MINUTES, GIGABYTES = 15, 12


def large(setting: Setting) -> Section:
    """Render A into a file and recover the image from it, once, with the peak of memory."""
    seconds: dict[str, float] = {}

    @contextmanager
    def timed(stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        seconds[stage] = time.perf_counter() - start
        print(f"large: {stage}: {seconds_text(seconds[stage])}", flush=True)

    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN, {"resolution": RESOLUTION})
    out = setting.out
    out.mkdir(parents=True, exist_ok=True)
    file = out / "large_A.npy"
    try:
        with timed("A"):
            A = np.lib.format.open_memmap(file, "w+", np.float32, scene.transport_shape)
            ps.render_transport(scene, out=A)
            A.flush()
        A = np.load(file, mmap_mode="r")
        B = ps.point_light_backgrounds(scene)
        truth = ps.read_hidden_image(ps.find_image("mushroom"), HIDDEN)
        photograph = _photograph(A, B, truth, (*scene.photograph_shape, 3))
        method = ps.IterativePeriscope.for_scene(scene, A, B)
        with timed("once for the scene"):
            method.eigenvectors  # noqa: B018 (found when first asked for)
        with timed("the photograph"):
            solution = method.solve(photograph)
    finally:
        file.unlink(missing_ok=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    total = sum(seconds.values())
    with drawn(out, "large", PAGE, 2.3) as figure:
        panels = {
            f"photograph, SBR {SBR:g}, {SNR:.0f} dB": (photograph, None),
            "hidden image": (truth, 1.0),
            f"reconstruction, {ps.psnr(solution.image, truth):.1f} dB": (
                ps.gain_matched(solution.image, truth),
                1.0,
            ),
        }
        for ax, (title, (image, white)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
            show_light(ax, image, white)
            ax.set_title(title)
    return Section(
        "large",
        "180 x 144 patches, 252 x 252 pixels",
        claims=[
            Claim(
                "A and the image, no explicit P",
                f"under {MINUTES} minutes",
                f"{total / 60:.1f} minutes",
                Verdict.of(total < 60 * MINUTES),
            ),
            Claim(
                "largest resident memory of the process, mapped pages included",
                f"under {GIGABYTES} GB",
                f"{peak:.1f} GB",
                Verdict.of(peak < GIGABYTES),
                f"A alone has {4e-9 * A.size:.1f} GB.",
            ),
            Claim(
                "iterations of the proximal gradient method, a pass over A each",
                "",
                str(solution.iterations),
                Verdict.MEASURED if solution.converged else Verdict.DIFFERS,
            ),
        ],
        pictures=[Picture(out / "large.png", "The photograph is A f plus light of B.")],
        tables=[times_table("Where the time goes", {**seconds, "all": total})],
    )


def _photograph(
    A: NDArray[np.float32], B: Array, truth: Array, shape: tuple[int, int, int]
) -> Array:
    f = truth.reshape(-1, 3).astype(np.float32)
    signal = np.concatenate([A[k : k + ROWS] @ f for k in range(0, len(A), ROWS)])
    light = B @ np.random.default_rng(0).random((B.shape[1], 1)) * np.ones(3)
    exposed = ps.composite(signal.reshape(shape), light.reshape(shape), SBR)
    return ps.add_noise(exposed, SNR, 0)
