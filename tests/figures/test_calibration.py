"""The picture of a calibration: what stands where, and the colours that it must hold."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from periscopy_sim.figures.calibration import calibration_figure, draw_calibration

SEARCH = np.array([[0.0, 2.0], [0.9, 2.4], [0.12, 1.9], [-0.8, 5.0]])
EVIDENCE = np.array([7.0, np.inf, 3.0, 5.0])
DESCENT = np.array([[0.11, 1.8], [0.1, 1.7], [0.1, 1.7], [0.102, 1.65], [0.1, 1.6]])
OF_DESCENT = np.array([4.0, 3.0, np.inf, 5.0, 1.0])
BEST = DESCENT[[0, 1, 1, 1, 4]]


def calibration(before, after):
    """Return one of two parameters; the residuals as (rows, columns)."""
    path = [
        SimpleNamespace(values=values, evidence=evidence, photograph_shape=shape)
        for values, evidence, shape in [
            (SEARCH, EVIDENCE, (4, 4)),
            (DESCENT, OF_DESCENT, before.shape),
        ]
    ]
    return SimpleNamespace(
        parameters=[
            SimpleNamespace(name="dx", start=0.0, value=0.1, standard_error=0.01),
            SimpleNamespace(name="turn", start=2.0, value=1.6, standard_error=0.3),
        ],
        path=path,
        residual_before=np.repeat(before[..., None], 3, axis=2),
        residual=np.repeat(after[..., None], 3, axis=2),
        unexplained=(0.0289, 0.01),
        doubts=(),
    )


@pytest.fixture
def residuals():
    return 0.02 * np.random.default_rng(0).standard_normal((2, 16, 18))


@pytest.fixture
def axes(residuals):
    figure = calibration_figure(np.full((16, 18, 3), 0.5), calibration(*residuals))
    return {ax.get_title(): ax for ax in figure.axes if ax.get_title()}


def test_each_residual_stands_under_its_title_in_percent(axes, residuals):
    titles = "unexplained at the start: 2.89 %", "unexplained after calibration: 1.00 %"
    for title, residual in zip(titles, residuals, strict=True):
        (picture,) = axes[title].images
        np.testing.assert_allclose(picture.get_array(), 100 * residual)
        low, high = picture.get_clim()
        assert -low == high == pytest.approx(100 * np.percentile(np.abs(residuals[0]), 99))


def test_each_parameter_is_shown_on_its_path(axes, residuals):
    parameters = calibration(*residuals).parameters
    titles = "dx: 0.1 ± 0.01", "turn: 1.6 ± 0.3"
    for k, (title, parameter) in enumerate(zip(titles, parameters, strict=True)):
        ax = axes[title]
        *paths, best, start, end = ax.get_lines()
        for level, (line, values) in enumerate(zip(paths, (SEARCH, DESCENT), strict=True)):
            place, shown = line.get_data()
            np.testing.assert_array_equal(shown, values[:, k])
            assert level < place[0] and place[-1] < level + 1 and (np.diff(place) > 0).all()
            assert line.get_linestyle() == "None"
        np.testing.assert_array_equal(best.get_data(), (place, BEST[:, k]))
        assert start.get_ydata()[0] == parameter.start
        assert end.get_ydata()[0] == parameter.value
        (band,) = ax.patches
        error = parameter.standard_error
        low, high = parameter.value - error, parameter.value + error
        np.testing.assert_allclose([band.get_y(), band.get_y() + band.get_height()], [low, high])
        labels = [label.get_text() for label in ax.get_xticklabels()]
        assert labels == ["4 x 4", "16 x 18"]


def test_a_calibration_that_is_not_to_be_trusted_says_so(residuals):
    doubted = calibration(*residuals)
    assert calibration_figure(np.full((16, 18, 3), 0.5), doubted).subfigs[0].get_suptitle() == ""
    doubted.doubts = ("dx ended 18.0 of the ruler's errors from there",)
    above, _ = calibration_figure(np.full((16, 18, 3), 0.5), doubted).subfigs
    assert above.get_suptitle() == f"NOT TO BE TRUSTED\n{doubted.doubts[0]}"


@pytest.mark.parametrize("count", [1, 2, 4, 5, 7])
def test_paths_fill_their_rows_and_are_explained(residuals, count):
    shown = calibration(*residuals)
    shown.parameters = shown.parameters[:1] * count
    for visited in shown.path:
        visited.values = np.repeat(visited.values[:, :1], count, axis=1)
    figure = calibration_figure(np.full((16, 18, 3), 0.5), shown)
    above, beneath = figure.subfigs
    assert len(above.axes) == 4
    rows = beneath.axes[0].get_gridspec().nrows
    assert len(beneath.axes) - count < rows <= -(-count // 4)
    (legend,) = beneath.legends
    told = [text.get_text() for text in legend.get_texts()]
    assert told[-3:] == ["start", "found", "± standard error"] and len(told) == 6
    assert "the scene's units" in beneath.get_supylabel()
    assert "pixels of the photograph" in beneath.get_supxlabel()


def test_the_range_holds_the_descent_not_all_that_was_searched(residuals):
    figure = calibration_figure(np.full((16, 18, 3), 0.5), calibration(*residuals))
    (ax,) = [ax for ax in figure.axes if ax.get_title().startswith("dx")]
    np.testing.assert_allclose(ax.get_ylim(), [-0.08 * 0.11, 1.08 * 0.11])


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
