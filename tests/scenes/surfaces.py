"""Hidden surfaces that tests share: a screen, and a column whose patches widen."""

import numpy as np

from periscopy_sim.hidden import Hidden, Surface


def curved(rows: int, columns: int) -> Surface:
    """Return a quarter of a cylinder of radius 1 whose patches widen from left to right."""
    angle = np.linspace(0, 1, columns) ** 2 * np.pi / 2
    y, x = np.divmod(np.arange(rows * columns), columns)
    centers = np.stack([np.sin(angle[x]), -y, np.cos(angle[x])], axis=1)
    flat = Surface.flat((rows, columns))
    return Surface(flat.shape, centers, flat.normals, flat.across, flat.up)


def screen_and_column() -> Hidden:
    """Return 3 x 4 equal patches, and 2 x 5 of a column."""
    return Hidden({"screen": Surface.flat((3, 4)), "column": curved(2, 5)})


def alone(hidden: Hidden) -> list[Hidden]:
    """Return each surface of a hidden by itself."""
    return [Hidden({name: surface}) for name, surface in hidden.items()]
