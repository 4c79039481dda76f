"""One lit block of the screen at a time: a column of A, measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, label_row, show_light
from experiments.published.data_set import Capture
from experiments.published.layout import BLOCKS, Placement, place_of
from experiments.published.setting import PublishedSetting
from experiments.report import Picture, Section, Table
from experiments.setting import FittedScene
from periscopy_sim.model.ambient import background_basis

Array = NDArray[np.float64]

LIT = 0.5
"""Part of the brightest patch from which on a patch of the ground truth counts as lit."""

ACROSS = 2
"""Points of each pixel that a column is averaged over: its shadows have edges sharper than that."""

FALLOFFS = ((18.0, 1.0), (20.0, 0.0), (0.0, 0.0))
"""Vertical and horizontal exponents of the monitor's falloff: fitted by [15], also used there, and
none."""


@dataclass(frozen=True, eq=False)
class Block:
    """A capture of one lit block beside what A says of it.

    Attributes
    ----------
    capture
        The capture.
    stated
        (row, column) of the lit block by the ground truth, of its centre; None if unknown.
    matching
        (row, column) of the patch whose column of A is most like the photograph.
    predicted
        (rows, columns, 3) A times the ground truth; the matching column where that is unknown.
    correlation
        Of photograph and prediction, both less their means.
    shadows
        The same, range(B) projected out of both: of what the chair's shadows alone tell.
    gains
        (3,) photograph over prediction, ambient light fitted freely.
    residual
        (rows, columns, 3) what gain, prediction and range(B) leave, over the root mean square.
    """

    capture: Capture
    stated: tuple[float, float] | None
    matching: tuple[int, int]
    predicted: Array
    correlation: float
    shadows: float
    gains: Array
    residual: Array


def run(setting: PublishedSetting) -> Section:
    """Compare every lit block with its column of A."""
    (folder, names), *_ = BLOCKS.items()
    captures, missing = setting.readable(folder, names), setting.not_read(folder, names)
    if not captures:
        text = "No capture of a lit block can be read."
        return Section("single_pixels", _TITLE, text=text, tables=missing)
    scene = setting.fitted(folder)
    blocks = compare(scene, captures)
    tables = [_table(blocks)]
    if falloffs := _falloffs(setting, setting.best(place_of(folder)), captures):
        tables.append(falloffs)
    _draw(setting, blocks)
    return Section(
        "single_pixels",
        _TITLE,
        text="The screen shows one block of light, so that the photograph is one column of A, "
        "times a gain for each colour, and ambient light. The gain should be the same for all "
        "blocks; where it is not, the falloff with angle or a distance is off. The patch whose "
        "column is most like the photograph should be the lit one; the distance between the two is "
        "how far the scene is off, in patches, as seen from there.",
        pictures=[
            Picture(
                setting.out / "single_pixels.png",
                "Photographs, their predictions (each: white is the 99.5th percentile) and "
                "residuals, % of the photograph's root mean square, mean over the channels.",
            )
        ],
        tables=[*tables, *missing],
    )


_TITLE = "Single screen pixels beside the columns of A"


def compare(scene: FittedScene, captures: Sequence[Capture]) -> list[Block]:
    """Compare captures of a lit block with the columns of a scene's A."""
    Q = background_basis(scene.B)
    A = ps.render_transport(scene.scenario.averaged(ACROSS), seed=scene.seed)
    shadows = A - Q @ (Q.T @ A)
    return [_block(capture, A, shadows, Q, scene.hidden) for capture in captures]


def _block(capture: Capture, A: Array, shadows: Array, Q: Array, hidden: tuple[int, int]) -> Block:
    y = capture.photograph.reshape(-1, 3)
    y_shadows = _without(Q, y)
    norms = np.linalg.norm(shadows, axis=0)
    likeness = (shadows.T @ y_shadows).sum(axis=1) / np.where(norms > 0, norms, np.inf)
    best = int(np.argmax(likeness))
    f = np.zeros((A.shape[1], 3))
    f[best] = 1
    stated = None
    if capture.truth is not None and capture.truth.any():
        f = capture.truth.reshape(-1, 3)
        stated = lit_center(capture.truth)
    p, p_shadows = A @ f, shadows @ f
    energy = np.sum(p_shadows**2, axis=0)
    gains = np.sum(p_shadows * y_shadows, axis=0) / np.where(energy > 0, energy, np.inf)
    left = (y_shadows - gains * p_shadows) / np.sqrt(np.mean(y**2))
    row, column = divmod(best, hidden[1])
    return Block(
        capture,
        stated,
        (row, column),
        p.reshape(capture.photograph.shape),
        _correlation(y - y.mean(axis=0), p - p.mean(axis=0)),
        _correlation(y_shadows, p_shadows),
        gains,
        left.reshape(capture.photograph.shape),
    )


def _without(Q: Array, y: Array) -> Array:
    """Return what of (M, 3) lies outside an orthonormal basis."""
    return y - Q @ (Q.T @ y)


def _correlation(a: Array, b: Array) -> float:
    """Return the cosine between two, (M, 3), over the channels that both are lit in."""
    lit = (np.linalg.norm(a, axis=0) > 0) & (np.linalg.norm(b, axis=0) > 0)
    if not lit.any():
        return 0.0
    cosines = [
        float(np.vdot(a[:, c], b[:, c]) / (np.linalg.norm(a[:, c]) * np.linalg.norm(b[:, c])))
        for c in np.flatnonzero(lit)
    ]
    return float(np.mean(cosines))


def lit_center(truth: Array) -> tuple[float, float]:
    """Return (row, column) of the mean of the patches that are lit in a ground truth, (R, C, 3)."""
    light = truth.sum(axis=2)
    places = np.argwhere(light >= LIT * light.max())
    row, column = places.mean(axis=0)
    return float(row), float(column)


def _table(blocks: Sequence[Block]) -> Table:
    mean = np.mean([block.gains for block in blocks], axis=0)

    def cells(block: Block) -> tuple[str, ...]:
        stated, apart = "unknown", ""
        if block.stated is not None:
            stated = f"{block.stated[0]:.1f}, {block.stated[1]:.1f}"
            down, right = np.subtract(block.matching, block.stated)
            apart = f"{down:+.1f}, {right:+.1f}"
        ratios = " ".join(
            f"{gain / whole:.3f}" if whole > 0 else "dark"
            for gain, whole in zip(block.gains, mean, strict=True)
        )
        left = 100 * np.sqrt(np.mean(block.residual**2))
        return (
            stated, f"{block.matching[0]}, {block.matching[1]}", apart,
            f"{block.correlation:.4f}", f"{block.shadows:.4f}", ratios, f"{left:.2f}",
        )  # fmt: skip

    return Table(
        "Patches are (row, column) from the top left, as a viewer facing the monitor sees it; "
        "correlation with the column, and of the shadows alone (range(B) projected out); gain in "
        "red, green and blue over its mean over the blocks; residual, % of the photograph's root "
        "mean square.",
        (
            "capture", "lit patch", "most like", "down, right of it", "correlation", "of shadows",
            "gain over mean", "residual",
        ),
        [(_title(block), *cells(block)) for block in blocks],
    )  # fmt: skip


def _title(block: Block) -> str:
    name = block.capture.name.rpartition("/")[2]
    return name.removeprefix("image_test_").replace("_", " ")


def _falloffs(
    setting: PublishedSetting, placement: Placement, captures: Sequence[Capture]
) -> Table | None:
    """Return how well laws of the monitor's falloff agree; None if the scene takes no exponents."""
    rows = []
    for vertical, horizontal in FALLOFFS:
        exponents = {"vertical_exponent": vertical, "horizontal_exponent": horizontal}
        try:
            blocks = compare(setting.scene(placement, exponents), captures)
        except ps.PeriscopyError:
            return None
        gains = np.array([block.gains.mean() for block in blocks])
        left = np.mean([np.mean(block.residual**2) for block in blocks])
        rows.append(
            (
                f"{vertical:g}, {horizontal:g}",
                " ".join(f"{gain:.3f}" for gain in gains / gains.mean()),
                f"{gains.std() / gains.mean():.3f}",
                f"{np.mean([block.correlation for block in blocks]):.4f}",
                f"{100 * np.sqrt(left):.2f}",
            )
        )
    return Table(
        "Laws of the monitor's falloff: exponents of the cosines of the vertical and of the "
        "horizontal angle. The right law gives all blocks one gain.",
        ("exponents", "gain over mean, each block", "its spread", "correlation", "residual, %"),
        rows,
    )


def _draw(setting: PublishedSetting, blocks: Sequence[Block]) -> None:
    with drawn(setting.out, "single_pixels", PAGE, 5.2) as figure:
        axes = figure.subplots(3, len(blocks), squeeze=False)
        most = 100 * max(np.abs(block.residual.mean(axis=2)).max() for block in blocks)
        for column, block in enumerate(blocks):
            show_light(axes[0, column], block.capture.photograph)
            axes[0, column].set_title(_title(block))
            show_light(axes[1, column], block.predicted * block.gains)
            image = axes[2, column].imshow(
                100 * block.residual.mean(axis=2), cmap="RdBu_r", vmin=-most, vmax=most
            )
            axes[2, column].set_axis_off()
        figure.colorbar(image, ax=list(axes[2]), shrink=0.8)
        for ax, text in zip(axes[:, 0], ("photograph", "prediction", "residual, %"), strict=True):
            label_row(ax, text)
