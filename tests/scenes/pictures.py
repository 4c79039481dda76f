"""What a saved picture shows."""

import numpy as np
from PIL import Image


def read(path):
    """Text chunks and 8-bit colours of a PNG, (height, width, 3)."""
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return dict(picture.text), np.asarray(picture.convert("RGB")).astype(int)


def covers(pixels, colour):
    """Where a picture has a colour, give or take one level of rounding."""
    return np.abs(pixels - np.round(colour)).max(axis=2) <= 1


def box(covered):
    """First and last row and column of a filled rectangle."""
    rows, columns = np.nonzero(covered)
    found = (rows.min(), rows.max(), columns.min(), columns.max())
    assert covered.sum() == (found[1] - found[0] + 1) * (found[3] - found[2] + 1)
    return found
