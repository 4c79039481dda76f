"""Hidden worlds other than a monitor, each reconstructed by the command line.

Plain Mitsuba photographs each world (64 x 64 pixels, SBR 1, 60 dB); the command knows the scene
file, not the pictures. Images are gain-matched.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, show_light
from experiments.page import Inputs, described
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.worlds.making import SCENES, Array, World

SCREEN = (18, 24)

WORLDS = {
    "two cards, 0.1 m apart in depth": World(
        "cards.xml",
        "cards.xml",
        {"rear": ("mushroom", (15, 10)), "front": ("still_life", (15, 10))},
    ),
    "a curved screen": World("curved.xml", "curved.xml", {"screen": ("mushroom", SCREEN)}),
    "a card that a lamp lights": World(
        "glow.xml", "lit.xml", {"card": ("still_life", SCREEN)}, {"spot_light": "1"}
    ),
    "a scene outside a window": World("window.xml", "window.xml", {"outside": ("sunset", SCREEN)}),
    "a frosted window": World("pane.xml", "pane.xml", {"outside": ("sunset", SCREEN)}),
    "the scene outside, taken for a frosted window": World(
        "window.xml", "pane.xml", {"outside": ("sunset", SCREEN)}
    ),
    "two cards, 0.5 and 1 m behind a door": World(
        "doorway.xml",
        "doorway.xml",
        {"near": ("mushroom", (15, 10)), "far": ("still_life", (15, 10))},
    ),
}


def run(setting: Inputs) -> Section:
    """Photograph and reconstruct every world."""
    rows, pictures, claims = [], [], []
    for number, (name, world) in enumerate(WORLDS.items()):
        folder = setting.out / "worlds" / str(number)
        truth, photograph, error = _photographed(world, folder, setting.seed)
        summary = _reconstruct(world, folder)
        files = {each: folder / "out" / f"reconstruction_hidden_{each}.npy" for each in truth}
        if len(truth) == 1:
            files = dict.fromkeys(truth, folder / "out" / "reconstruction.npy")
        images = {each: np.load(file) for each, file in files.items()}
        quality = {each: ps.psnr_gain_matched(images[each], truth[each]) for each in truth}
        decibels = ", ".join(f"{value:.1f}" for value in quality.values())
        claims.append(Claim(f"{name}, PSNR", "", f"{decibels} dB", Verdict.MEASURED))
        rows.append(
            (
                name,
                decibels,
                f"{100 * summary['unexplained']:.3f}",
                f"{100 * summary['noise_alone']:.3f}",
                f"{error:.2f}",
                f"{sum(summary['seconds'].values()):.1f}",
            )
        )
        _draw(setting.out, f"world_{number}", photograph, truth, images)
        pictures.append(Picture(setting.out / f"world_{number}.png", name))
    header = (
        "world",
        "PSNR, dB",
        "unexplained, %",
        "noise, %",
        "rendering's error over the noise",
        "s",
    )
    table = Table("Reconstructions by the command line, default options.", header, rows)
    return Section(
        "worlds",
        "Hidden worlds",
        text=described(__doc__),
        claims=claims,
        pictures=pictures,
        tables=[table],
    )


def _photographed(world: World, folder: Path, seed: int) -> tuple[dict[str, Array], Array, float]:
    """Return the truth, the photograph and the rendering's error; rendered once."""
    kept = folder / "photographed.npz"
    if not kept.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        truth = world.truth(folder)
        photograph, error = world.photograph(folder, truth, seed)
        np.savez(kept, photograph=photograph, error=error, **truth)
    fields = dict(np.load(kept))
    photograph, error = fields.pop("photograph"), float(fields.pop("error"))
    np.save(folder / "photograph.npy", photograph)
    return fields, photograph, error


def _reconstruct(world: World, folder: Path) -> dict[str, Any]:
    """Run `periscopy reconstruct` in a process of its own; return its summary."""
    sizes = {name: "{}x{}".format(*shape) for name, (_, shape) in world.shown.items()}
    hidden = [*sizes.values()] if len(sizes) == 1 else [f"hidden_{n}={s}" for n, s in sizes.items()]
    options = [part for each in hidden for part in ("--hidden", each)]
    command = [sys.executable, "-m", "periscopy_sim", "reconstruct", folder / "photograph.npy"]
    command += ["--scene", SCENES / world.assumed, *options, "--out", folder / "out"]
    subprocess.run(command, check=True)
    summary: dict[str, Any] = json.loads((folder / "out" / "summary.json").read_text("utf-8"))
    return summary


def _draw(
    out: Path, name: str, photograph: Array, truth: dict[str, Array], images: dict[str, Array]
) -> None:
    """Draw the photograph, what was hidden, and the reconstruction."""
    panels = {"photograph": photograph}
    panels |= {f"hidden: {each}" if len(truth) > 1 else "hidden": f for each, f in truth.items()}
    for each, image in images.items():
        match = np.sum(image * truth[each], axis=(0, 1)) / np.sum(image**2, axis=(0, 1))
        panels[f"recovered: {each}" if len(truth) > 1 else "recovered"] = image * match
    widths = [each.shape[1] / each.shape[0] for each in panels.values()]
    height = min(PAGE / sum(widths), 2.0)
    with drawn(out, name, height * sum(widths), height + 0.25) as figure:
        axes = figure.subplots(1, len(panels), width_ratios=widths)
        for ax, (title, image) in zip(axes, panels.items(), strict=True):
            show_light(ax, image, None if title == "photograph" else 1.0)
            ax.set_title(title)
