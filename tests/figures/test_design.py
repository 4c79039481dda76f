import numpy as np
import pytest

from periscopy_sim.figures.design import draw_design

POINTS = [("0", "0"), *((a, b) for a in ("1", "2", "3") for b in ("4", "5"))]


@pytest.mark.parametrize("bounds", [[0.0] * 6, [np.inf] * 6, [0.0, 0.01, 0.0, 0.02, 0.0, np.inf]])
def test_map_shows_errors_above_0_and_says_where_there_are_none(bounds, saved, tmp_path):
    given = {"point": 0, "reported_error": None, "error": None, "failure": ""}
    rows = [
        {**given, "point": number, "a": a, "b": b, "bound": bound}
        for number, ((a, b), bound) in enumerate(zip(POINTS, [0.0, *bounds], strict=True))
    ]
    draw_design(tmp_path / "design.png", rows, None, units={})
    (figure,) = saved
    shown = figure.axes[0].collections[0].get_array().filled(np.nan)
    expected = 100 * np.reshape(bounds, (3, 2)).T
    np.testing.assert_allclose(shown, np.where(np.isin(expected, (1, 2)), expected, np.nan))
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ([] if 0.01 in bounds else ["no finite error\nabove 0"])
    assert len(figure.axes) == 1 + (0.01 in bounds)  # with the colour bar
