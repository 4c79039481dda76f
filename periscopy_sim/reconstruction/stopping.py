"""Where iterations stop."""

from __future__ import annotations


def check_stopping(tolerance: float, max_iterations: int = 1) -> None:
    """Refuse numbers that iterations cannot stop at.

    Parameters
    ----------
    tolerance
        Relative; between 0 and 1.
    max_iterations
        At least 1.

    Raises
    ------
    ValueError
        Naming the number.
    """
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is {tolerance}: give a number between 0 and 1")
    if max_iterations < 1:
        raise ValueError(f"max_iterations is {max_iterations}: give at least 1")
