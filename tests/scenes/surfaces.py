"""Hidden surfaces that tests share: a screen and a column."""

from periscopy_sim.hidden import Hidden


def screen_and_column() -> Hidden:
    """Return 3 x 4 patches, and 2 x 5 of a column."""
    return Hidden.of({"screen": (3, 4), "column": (2, 5)})


def alone(hidden: Hidden) -> list[Hidden]:
    """Return each surface of a hidden by itself."""
    return [Hidden({name: surface}) for name, surface in hidden.items()]
