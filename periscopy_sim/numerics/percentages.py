"""Numbers for a reader: two parts of a whole in percent, a value with its standard error."""


def percentages(first: float, second: float, most: int = 4) -> tuple[str, str]:
    """Return two parts in percent with two digits, or as many as tell them apart, at most so many.

    Equal values have two digits.
    """
    for digits in range(2, most + 1):
        one, other = f"{100 * first:.{digits}f}", f"{100 * second:.{digits}f}"
        if one != other:
            return one, other
    return f"{100 * first:.2f}", f"{100 * second:.2f}"


def with_error(value: float, error: float, unit: str = "") -> str:
    """Return a value, its standard error, which has two digits, and their unit, if any."""
    digits = max(0, 1 - int(f"{error:e}".partition("e")[2]))
    return f"{value:.{digits}f} ± {error:.{digits}f} {unit}".rstrip()
