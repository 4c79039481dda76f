"""The report of a method on a photograph, beside its hidden image: numbers, and notes as codes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from periscopy_sim.model.residual import Residual
from periscopy_sim.numerics import Array, Image


@dataclass(frozen=True)
class Note:
    """A note for the user: a code, whose sentence `cli.messages` holds, and its values."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Report:
    """A solution's numbers, pictures, notes and warnings.

    Attributes
    ----------
    numbers
        Numbers that a summary records, by name.
    notes, warnings
        Facts that a user may want to know, and reasons why the image may be wrong.
    stages
        Titles and images, (R, C, 3), that led to the solution.
    standard_errors
        (R, C, 3) of each patch; None where the method knows none.
    residual
        None where the method does not know A, or the photograph's rows and columns.
    """

    numbers: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[Note] = ()
    warnings: Sequence[Note] = ()
    stages: Sequence[tuple[str, Image]] = ()
    standard_errors: Array | None = None
    residual: Residual | None = None
