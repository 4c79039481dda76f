"""Things that reflect light in the monitor's place, flat ones and solid ones."""

from __future__ import annotations

from experiments.published.layout import OBJECTS
from experiments.published.setting import PublishedSetting, unexplained
from experiments.published.stills import OURS, PAPER, Still, draw
from experiments.report import Picture, Section, Table


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every capture of an object onto the monitor's plane."""
    pictures, tables, rows = [], [], []
    for folder, names in OBJECTS.items():
        captures = setting.readable(folder, names)
        tables += setting.not_read(folder, names)
        if not captures:
            continue
        scene = setting.fitted(folder)
        ours, found = scene.noise_aware, []
        for capture in captures:
            solution = ours.solve(capture.photograph)
            images = {
                OURS: solution.image,
                PAPER: scene.preconditioned.reconstruct(capture.photograph),
            }
            left = unexplained(ours, capture.photograph, solution)
            found.append(Still(capture, images, left, compared=False))
            rows.append(
                (
                    folder,
                    capture.name.rpartition("/")[2],
                    f"{capture.exposure:.4g}",
                    f"{100 * left:.2f}",
                )
            )
        pictures.append(
            Picture(
                draw(setting.out, f"objects_{folder}", found),
                f"{folder}: photographs and images (white: the 99.5th percentile of each).",
            )
        )
    if rows:
        caption = (
            "Unexplained by scene and noise-aware image, % of the photograph's root mean square."
        )
        header = ("folder", "capture", "exposure", "unexplained")
        tables.insert(0, Table(caption, header, rows))
    return Section(
        "objects",
        "Things that reflect light",
        text="Nothing says where these things stood, how they were lit or what they showed: the "
        "monitor's plane is assumed, matt, with the chair where the owners' code has it for these "
        "folders. No PSNR is told; what does not lie in that plane comes out displaced and "
        "blurred. Depth is not treated." + ("" if rows else " No capture of them can be read."),
        pictures=pictures,
        tables=tables,
    )
