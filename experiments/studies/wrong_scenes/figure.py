"""The figures: coverage and dB of every draw; the pictures of one draw of each scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, show_light
from experiments.studies.wrong_scenes.coverage import LEVELS, ONE, expected_band, of_draws
from experiments.studies.wrong_scenes.outcome import SCENES, Outcome
from experiments.studies.wrong_scenes.plain_scenes import SHOWN
from experiments.studies.wrong_scenes.subjects import NAMES

Array = NDArray[np.float64]

COLOURS = dict(
    zip(
        NAMES,
        (COLORS[c] for c in ("preconditioned", "differencing", "noise-aware", "truncated-svd")),
        strict=True,
    )
) | {name: f"C{index}" for index, name in enumerate(SHOWN, 4)}
"""Of each scene."""

WANTED = {"numbers of the scene": (0.55, 0.80), "patches": (0.60, 0.85)}
"""What 68 % intervals are to cover."""

WIDER = 1.5
"""Times that the panel of dB is wider than those of coverage."""


def draw_coverage(out: Path, outcomes: Sequence[Outcome]) -> Path:
    """Draw `wrong_scenes`: a row for each SBR, numbers' and patches' coverage, and dB by draw."""
    sbrs = sorted({outcome.sbr for outcome in outcomes})
    with drawn(out, "wrong_scenes", PAGE, 0.6 + 1.95 * len(sbrs)) as figure:
        grid = figure.subplots(len(sbrs), 3, squeeze=False, width_ratios=[1, 1, WIDER])
        for row, sbr in zip(grid, sbrs, strict=True):
            own = [outcome for outcome in outcomes if outcome.sbr == sbr]
            _draw_covered(row[0], own, lambda o: o.z, "numbers of the scene", band=True)
            _draw_covered(row[1], own, lambda o: o.patch_z, "patches", band=False)
            _draw_decibels(row[2], own)
            row[0].set_ylabel(f"SBR {sbr:g}\ntruth within, %")
        for ax in grid[-1, :2]:
            ax.set_xlabel("nominal level of intervals, %")
        grid[-1, 2].set_xlabel("draws of all of a ruler's errors at once")
        for ax, title in zip(grid[0], (*WANTED, "hidden image"), strict=True):
            ax.set_title(title)
        grid[0, 0].legend(loc="lower right")
        figure.legend(*grid[0, 2].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return out / "wrong_scenes.png"


def _scenes(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the scenes that there are draws of."""
    return [name for name in COLOURS if any(outcome.subject == name for outcome in outcomes)]


def _draw_covered(
    ax: Any,
    outcomes: Sequence[Outcome],
    z_of: Callable[[Outcome], Array],
    what: str,
    *,
    band: bool,
) -> None:
    """Draw the coverage of all draws and each scene's against the nominal one.

    The wanted range is a bar at 68 %. Grey is where all draws' would lie if standard errors were
    right, or, without this band, all draws' standard error.
    """
    ax.plot([0, 1], [0, 1], color="black", linewidth=0.6, linestyle=":")
    mean, error = of_draws(outcomes, z_of)
    grey = expected_band(outcomes) if band else (mean - error, mean + error)
    ax.fill_between(LEVELS, *grey, color="0.85", linewidth=0)
    ax.plot([ONE, ONE], WANTED[what], color="black", linewidth=3, alpha=0.35, solid_capstyle="butt")
    scenes = _scenes(outcomes)
    for scene in scenes:
        own = [outcome for outcome in outcomes if outcome.subject == scene]
        ax.plot(LEVELS, of_draws(own, z_of)[0], color=COLOURS[scene], linewidth=0.9, label=scene)
    if len(scenes) > 1:
        ax.plot(LEVELS, mean, color="black", label="all")
    ax.set(xlim=(0, 1), ylim=(0, 1), box_aspect=1)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks(np.linspace(0, 1, 5), ["0", "25", "50", "75", "100"])


def _draw_decibels(ax: Any, outcomes: Sequence[Outcome]) -> None:
    """Draw each draw's registered dB, from the ruler's scene to the calibrated, and the true."""
    at, ticks = 0.0, []
    for scene in _scenes(outcomes):
        colour = COLOURS[scene]
        own = [outcome for outcome in outcomes if outcome.subject == scene]
        places = at + np.arange(len(own))
        for place, outcome in zip(places, own, strict=True):
            ruler, calibrated, true = (outcome.registered[name] for name in SCENES)
            first = place == 0
            ax.plot([place, place], [ruler, calibrated], color=colour, linewidth=0.8, alpha=0.5)
            ax.plot(place, ruler, "o", ms=3, mfc="white", mec="0.5", mew=0.8,
                    label="the ruler's scene" if first else None)  # fmt: skip
            ax.plot(place, calibrated, "o" if outcome.trusted else "X", ms=4.5, color=colour, mew=0)
            ax.plot(place, true, "_", ms=6, mew=1.2, color="black",
                    label="the true scene" if first else None)  # fmt: skip
        ticks.append((float(places.mean()), scene))
        at += len(own) + 1.0
    ax.plot([], [], "o", ms=4.5, color="0.35", mew=0, label="calibrated")
    ax.plot([], [], "X", ms=4.5, color="0.35", mew=0, label="calibrated, not trusted")
    ax.set_xticks(*zip(*ticks, strict=True))
    ax.tick_params(axis="x", length=0)
    ax.set(ylabel="registered PSNR, dB", box_aspect=1 / WIDER)
    ax.margins(x=0.04)


def draw_images(out: Path, outcomes: Sequence[Outcome]) -> Path:
    """Draw `wrong_scenes_images`: of each scene and SBR, the draw of the median loss of dB."""
    sbrs = sorted({outcome.sbr for outcome in outcomes})
    scenes = _scenes(outcomes)
    with drawn(out, "wrong_scenes_images", PAGE, 0.3 + 1.05 * len(scenes)) as figure:
        columns = 1 + len(SCENES) * len(sbrs)
        grid = figure.subplots(len(scenes), columns, squeeze=False)
        for row, scene in zip(grid, scenes, strict=True):
            for ax in row:
                ax.set_axis_off()
            for k, sbr in enumerate(sbrs):
                own = [o for o in outcomes if (o.subject, o.sbr) == (scene, sbr)]
                if not own:
                    continue
                shown = sorted(own, key=loss)[len(own) // 2]
                show_light(row[0], shown.truth, 1)
                row[0].set_title(f"{scene}\nhidden image", fontsize=7)
                for j, (name, image) in enumerate(zip(SCENES, shown.images, strict=True)):
                    ax = row[1 + len(SCENES) * k + j]
                    show_light(ax, ps.registered(image, shown.truth).image, 1)
                    numbers = f"{shown.psnr[name]:.1f} / {shown.registered[name]:.1f} dB"
                    ax.set_title(f"SBR {sbr:g}, {name}\n{numbers}", fontsize=7)
    return out / "wrong_scenes_images.png"


def loss(outcome: Outcome) -> float:
    """Return by how many dB, registered, the true scene's picture is better than the calibrated."""
    return outcome.registered["true"] - outcome.registered["calibrated"]
