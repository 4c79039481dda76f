"""One lit block of the screen at a time: a column of A, measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import periscopy_sim as ps
from experiments.published.setting import BLOCKS, Capture, PublishedSetting
from experiments.report import Picture, Section, Table
from experiments.setting import FittedScene
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.model.transport_operator import background_basis
from periscopy_sim.numerics import Array

LIT = 0.5
"""Part of the brightest patch from which on a patch of the ground truth counts as lit."""

ACROSS = 2
"""Points of each pixel that a column is averaged over: its shadows have edges sharper than that."""


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
        (rows, columns, 3) A times the ground truth, times the gains; the matching column where the
        truth is unknown.
    correlation
        Of photograph and prediction with range(B) projected out of both: of the shadows.
    gains
        (3,) photograph over prediction, ambient light fitted freely.
    residual
        What gain, prediction and range(B) leave, over the photograph's root mean square.
    """

    capture: Capture
    stated: tuple[float, float] | None
    matching: tuple[int, int]
    predicted: Array
    correlation: float
    gains: Array
    residual: float


def run(setting: PublishedSetting) -> Section:
    """Compare every lit block with its column of A."""
    section = Section("single_pixels", "Single screen pixels beside the columns of A")
    captures = setting.captures(BLOCKS)
    blocks = compare(setting.fitted(BLOCKS), captures) if captures else []
    return replace(
        section,
        text="The screen shows one block of light, so that the photograph is one column of A, "
        "times a gain for each colour, and ambient light. The gain should be the same for all "
        "blocks; where it is not, the falloff with angle or a distance is off. The patch whose "
        "column is most like the photograph should be the lit one; the distance between the two is "
        "how far the scene is off, in patches, as seen from there."
        if blocks
        else "No capture of a lit block can be read.",
        pictures=[_draw(setting, blocks)] if blocks else [],
        tables=[*([_table(blocks)] if blocks else []), *setting.not_read(BLOCKS)],
    )


def compare(scene: FittedScene, captures: Sequence[Capture]) -> list[Block]:
    """Compare captures of a lit block with the columns of a scene's A."""
    Q = background_basis(scene.B)
    A = ps.render_transport(scene.scenario.averaged(ACROSS), seed=scene.seed)
    return [_block(capture, A, Q, scene.hidden) for capture in captures]


def _block(capture: Capture, A: Array, Q: Array, hidden: tuple[int, int]) -> Block:
    def shadows_of(light: Array) -> Array:
        return np.asarray(light - Q @ (Q.T @ light))

    photograph = capture.photograph
    y, shadows = photograph.reshape(-1, 3), shadows_of(A)
    y_shadows = shadows_of(y)
    norms = np.linalg.norm(shadows, axis=0)
    likeness = (shadows.T @ y_shadows).sum(axis=1) / np.where(norms > 0, norms, np.inf)
    best = int(np.argmax(likeness))
    f, stated = np.zeros((A.shape[1], 3)), None
    f[best] = 1
    if capture.truth is not None:
        f, stated = capture.truth.reshape(-1, 3), lit_center(capture.truth)
    predicted = shadows @ f
    energy = np.sum(predicted**2, axis=0)
    gains = np.sum(predicted * y_shadows, axis=0) / np.where(energy > 0, energy, np.inf)
    row, column = divmod(best, hidden[1])
    lit = energy > 0
    return Block(
        capture,
        stated,
        (row, column),
        (A @ f * gains).reshape(photograph.shape),
        float(np.mean([_cosine(y_shadows[:, c], predicted[:, c]) for c in np.flatnonzero(lit)])),
        gains,
        float(np.sqrt(np.mean((y_shadows - gains * predicted) ** 2) / np.mean(y**2))),
    )


def _cosine(a: Array, b: Array) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


def lit_center(truth: Array) -> tuple[float, float]:
    """Return (row, column) of the mean of the patches that are lit in a ground truth, (R, C, 3)."""
    light = truth.sum(axis=2)
    row, column = np.argwhere(light >= LIT * light.max()).mean(axis=0)
    return float(row), float(column)


def _table(blocks: Sequence[Block]) -> Table:
    mean = np.mean([block.gains for block in blocks], axis=0)

    def cells(block: Block) -> tuple[str, ...]:
        stated, apart = "unknown", ""
        if block.stated is not None:
            stated = "{:.1f}, {:.1f}".format(*block.stated)
            apart = "{:+.1f}, {:+.1f}".format(*np.subtract(block.matching, block.stated))
        ratios = block.gains / np.where(mean > 0, mean, np.inf)
        return (
            stated, "{}, {}".format(*block.matching), apart, f"{block.correlation:.4f}",
            " ".join(f"{ratio:.3f}" for ratio in ratios), f"{100 * block.residual:.2f}",
        )  # fmt: skip

    return Table(
        "Patches are (row, column) from the top left, as a viewer facing the monitor sees it; "
        "correlation with the column, of the shadows alone (range(B) projected out); gain in "
        "red, green and blue over its mean over the blocks; residual, % of the photograph's root "
        "mean square.",
        ("capture", "lit patch", "most like", "down, right of it", "correlation", "gain over mean",
         "residual"),
        [(block.capture.name, *cells(block)) for block in blocks],
    )  # fmt: skip


def _draw(setting: PublishedSetting, blocks: Sequence[Block]) -> Picture:
    rows = {
        block.capture.name: [
            ("photograph", displayable(block.capture.photograph)),
            ("prediction", displayable(block.predicted)),
        ]
        for block in blocks
    }
    file = setting.out / "single_pixels.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    draw_panels(file, rows)
    return Picture(file, "Photographs and predictions; white is the 99.5th percentile of each.")
