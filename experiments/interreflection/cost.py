"""What methods lose where light bounces, and what a matrix that holds it gains.

Photographs are of the bright room, at 60 dB, under an overcast sky and under ceiling panels, by
another rendering of A than the methods have (that A f is the path-traced photograph, the first
section shows). Methods are fitted to the direct A, as by default, and to that of all bounces. The
first column is of a photograph in which nothing bounces.

`python -m experiments.interreflection --out DIR --only cost`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, label_row, show_light
from experiments.interreflection.rooms import BRIGHT, Array, Workplace, both_matrices, photograph
from experiments.page import described
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import SNR
from periscopy_sim.cli.ambient import ambient_photographs
from periscopy_sim.evaluation.methods import fit_methods
from periscopy_sim.scenario import Scenario

HIDDEN = (29, 36)
SBRS = (0.1, 0.5, 2.0, 10.0)
PLACES = ("overcast", "ceiling_panels")
METHODS = ("noise-aware", "preconditioned", "differencing", "truncated-svd")
CASES = {
    "nothing bounces": ("direct", "direct"),
    "direct A": ("all", "direct"),
    "A of all bounces": ("all", "all"),
}
"""Of each, what the photograph holds, and what the method's A does."""

SHOWN = 0.5
MOST_LOST = 0.5
"""dB that noise-aware may lose at `SHOWN`, with A of all bounces."""

Images = Mapping[tuple[str, str, float, str], Array]
"""By method, case, SBR and place."""


def run(place: Workplace) -> Section:
    """Reconstruct every photograph by every method."""
    scenario, truth = BRIGHT.at(HIDDEN), BRIGHT.shown(HIDDEN)
    direct, bounced = both_matrices(scenario, place.seed)
    matrices = {"direct": direct, "all": np.asarray(bounced)}
    of_photographs = both_matrices(scenario, place.seed + 1, samples=64, pixel_samples=4)
    lights = dict(zip(("direct", "all"), of_photographs, strict=True))
    signals = {name: photograph(scenario, A, truth) for name, A in lights.items()}
    ambient = ambient_photographs(PLACES, scenario, place.rendered, place.seed)
    images = dict(_images(scenario, matrices, signals, ambient))
    psnr = {key: ps.psnr(image, truth) for key, image in images.items()}

    def mean_of(method: str, case: str, sbr: float) -> float:
        return float(np.mean([psnr[method, case, sbr, name] for name in PLACES]))

    _draw(place, mean_of)
    _draw_images(place, images, truth)
    rows = [
        (f"{sbr:g}", method, *(f"{mean_of(method, case, sbr):.1f}" for case in CASES))
        for sbr in SBRS
        for method in METHODS
    ]
    none, short, whole = (mean_of("noise-aware", case, SHOWN) for case in CASES)
    return Section(
        name="cost",
        title="What methods lose",
        text=described(__doc__),
        claims=[
            Claim(
                f"noise-aware at SBR {SHOWN:g}: dB lost with A of all bounces",
                f"at most {MOST_LOST}",
                f"{none - whole:.2f}; with the direct A {none - short:.2f}",
                Verdict.of(none - whole <= MOST_LOST),
            )
        ],
        tables=[Table("PSNR in dB, mean of both places.", ("SBR", "method", *CASES), rows)],
        pictures=[
            Picture(place.out / "cost.png", "Mean PSNR of both places over SBR."),
            Picture(
                place.out / "cost_images.png",
                f"Hidden images at SBR {SHOWN:g} under an overcast sky, gain-matched.",
            ),
        ],
    )


def _images(
    scenario: Scenario,
    matrices: Mapping[str, NDArray[np.float32]],
    signals: Mapping[str, Array],
    ambient: Mapping[str, Array],
) -> list[tuple[tuple[str, str, float, str], Array]]:
    """Return what each method makes of each case."""
    B = ps.point_light_backgrounds(scenario)
    found = []
    for held, A in matrices.items():
        fitted = fit_methods(list(METHODS), scenario, A, B)
        for case, (shown, by) in CASES.items():
            if by != held:
                continue
            for sbr in SBRS:
                for number, (name, light) in enumerate(ambient.items()):
                    seed = 1000 * number + round(100 * sbr)
                    y = ps.add_noise(ps.composite(signals[shown], light, sbr), SNR, seed)
                    found += [
                        ((method, case, sbr, name), np.asarray(each.reconstruct(y)))
                        for method, each in fitted.items()
                    ]
    return found


def _draw(place: Workplace, psnr: Callable[[str, str, float], float]) -> None:
    """Draw `cost`: dB over SBR, a panel for each method."""
    lines = dict(zip(CASES, (":", "--", "-"), strict=True))
    with drawn(place.out, "cost", PAGE, 2.1) as figure:
        axes = figure.subplots(1, len(METHODS), sharey=True)
        for ax, method in zip(axes, METHODS, strict=True):
            for case, line in lines.items():
                values = [psnr(method, case, sbr) for sbr in SBRS]
                ax.plot(SBRS, values, line, color=COLORS[method], label=case, marker=".", ms=4)
            ax.set(xscale="log", xlabel="SBR", title=method)
            ax.set_xticks(SBRS, [f"{sbr:g}" for sbr in SBRS])
            ax.minorticks_off()
            ax.grid(visible=True, linewidth=0.3)
        axes[0].set_ylabel("PSNR, dB")
        handles = axes[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=len(CASES))


def _draw_images(place: Workplace, images: Images, truth: Array) -> None:
    """Draw `cost_images`: each method's pictures of the three cases."""
    with drawn(place.out, "cost_images", PAGE, 1.4 * len(METHODS)) as figure:
        grid = figure.subplots(len(METHODS), 1 + len(CASES))
        for row, method in zip(grid, METHODS, strict=True):
            show_light(row[0], truth, 1)
            label_row(row[0], method)
            for ax, case in zip(row[1:], CASES, strict=True):
                image = images[method, case, SHOWN, PLACES[0]]
                show_light(ax, ps.gain_matched(image, truth), 1)
                ax.set_title(f"{case}: {ps.psnr(image, truth):.1f} dB")
        grid[0, 0].set_title("hidden image")
