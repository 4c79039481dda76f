"""The picture of a calibration, by the colours that it must hold."""

from types import SimpleNamespace

import numpy as np
from matplotlib import colormaps
from PIL import Image

from periscopy_sim.figures.calibration import draw_calibration


def calibration(before, after):
    """One of two levels and one parameter; the residuals as (rows, columns)."""
    levels = [
        SimpleNamespace(
            values=np.array([[0.0], [0.1]]), evidence=np.array([1.0, 0.0]), photograph_shape=shape
        )
        for shape in ((4, 4), before.shape)
    ]
    return SimpleNamespace(
        parameters=[SimpleNamespace(name="dx", start=0.0, value=0.1, standard_error=0.01)],
        path=[levels[0], *levels],
        residual_before=np.repeat(before[..., None], 3, axis=2),
        residual=np.repeat(after[..., None], 3, axis=2),
        noise_before=np.full(3, 0.02),
        noise=np.full(3, 0.01),
    )


def test_residuals_are_shown_pixel_by_pixel_in_the_colours_of_their_sign(tmp_path):
    # 230 pixels are enlarged a little over twice, where averages would be drawn between them.
    signs = np.where(np.indices((230, 230)).sum(axis=0) % 2, 1.0, -1.0)
    path = tmp_path / "calibration.png"
    photograph = np.full((230, 230, 3), 0.5)
    draw_calibration(path, photograph, calibration(0.02 * signs, 0.01 * signs), {"Source": "s"})
    with Image.open(path) as picture:
        assert picture.text["Source"] == "s"
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    ends, halves = (
        [255 * np.array(colormaps["RdBu_r"](fraction)[:3]) for fraction in fractions]
        for fractions in ((0.0, 1.0), (0.25, 0.75))
    )
    above = pixels[: len(pixels) // 2]
    for colour in (*ends, *halves):
        # Either sign fills half of its map, and a map a quarter of this part of the picture.
        assert np.mean(np.abs(above - colour).max(axis=2) <= 3) > 0.1
