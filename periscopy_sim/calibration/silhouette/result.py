"""The silhouette of an occluder nobody measured, and how far it is to be believed."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from periscopy_sim.calibration.silhouette.mask import opaque, usual_opacity
from periscopy_sim.calibration.silhouette.plane import Cells, MaskPlane
from periscopy_sim.numerics import Array

UNDECIDED, DECIDED = (0.2, 0.8), 0.9
"""Opacities, over the usual one, between which a cell is neither opaque nor open, and the fraction
of cells seen that must be one of both."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A flat mask that explains photographs, estimated with the hidden image or by known pictures.

    Beside an unknown image, both may be shifted against each other.

    Attributes
    ----------
    name
        Id of the shape whose place it takes.
    plane
        The rectangle of its cells.
    opacities
        (rows, columns) of cells, 0 to 1, top left first as one sees it who faces the wall.
    seen
        (rows, columns) whether the photograph shows the cell's shadow; else its neighbours decide.
    image
        (R, C, 3) the hidden image, linear, of several surfaces a mapping by id: the one estimated
        with the mask, or the first one shown.
    unexplained, unexplained_open
        Residual of the photographs with the mask and without one, over their root mean square.
    residual
        (rows, columns, 3) of the first photograph, likewise.
    evidence
        Twice the negative logarithm of the photograph's likelihood: less is better.
    agreeing, starts
        How many of the search's starts ended at this mask; of how many. Both are 0 where pictures
        are known.
    """

    name: str
    plane: MaskPlane
    opacities: Array
    seen: Cells
    image: Any = field(repr=False)
    unexplained: float
    unexplained_open: float
    residual: Array = field(repr=False)
    evidence: float
    agreeing: int = 0
    starts: int = 0

    @property
    def opaque(self) -> Cells:
        """(rows, columns) whether cells are opaque rather than not."""
        return opaque(self.opacities)

    @property
    def decided(self) -> float:
        """Fraction of the cells seen that are clearly opaque or clearly open."""
        of_usual = self.opacities / max(usual_opacity(self.opacities), 1e-300)
        low, high = UNDECIDED
        return float(np.mean(((of_usual < low) | (of_usual > high))[self.seen]))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it is not to be believed; empty if nothing speaks against it."""
        doubts = []
        if self.unexplained > self.unexplained_open / 2:
            doubts.append(
                "the mask explains less than half of what the photograph shows without it"
            )
        if self.decided < DECIDED:
            doubts.append(
                f"{100 * (1 - self.decided):.0f} % of the cells are neither opaque nor open"
            )
        if self.starts and self.agreeing < 2:
            doubts.append(
                f"only one of the search's {self.starts} starts ended near it: there may be a "
                "better one"
            )
        return tuple(doubts)

    def record(self) -> dict[str, Any]:
        """Return the silhouette as its JSON file has it."""
        return {
            "shape": self.name,
            "trusted": not self.doubts,
            "doubts": self.doubts,
            "rectangle": asdict(self.plane),
            "opaque": ["".join("#" if cell else "." for cell in row) for row in self.opaque],
            "cells_seen": int(self.seen.sum()),
            "cells_decided": self.decided,
            "starts_agreeing": self.agreeing,
            "opacities": self.opacities,
            "unexplained_open": self.unexplained_open,
            "unexplained": self.unexplained,
            "starts": self.starts,
            "evidence": self.evidence,
        }
