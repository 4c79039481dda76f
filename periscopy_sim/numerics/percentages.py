"""Two parts of a whole in percent, to be compared by a reader."""


def percentages(first: float, second: float, most: int = 4) -> tuple[str, str]:
    """Return two parts in percent with two digits, or as many as tell them apart, at most so many.

    Equal values have two digits.
    """
    for digits in range(2, most + 1):
        one, other = f"{100 * first:.{digits}f}", f"{100 * second:.{digits}f}"
        if one != other:
            return one, other
    return f"{100 * first:.2f}", f"{100 * second:.2f}"
