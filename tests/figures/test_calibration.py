"""The picture of a calibration: what stands where, and the colours that it must hold."""

from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.figures.calibration import draw_calibration
from tests.figures.conftest import read

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
def draw(tmp_path, saved):
    def make(shown):
        path = tmp_path / "calibration.png"
        draw_calibration(path, np.full((16, 18, 3), 0.5), shown, {"Source": "s"})
        assert read(path)[0]["Source"] == "s"
        return saved[-1]

    return make


def test_each_residual_stands_under_its_title_in_percent(draw, residuals):
    axes = {ax.get_title(): ax for ax in draw(calibration(*residuals)).axes}
    for percent, residual in zip(("2.89 %", "1.00 %"), residuals, strict=True):
        (ax,) = (ax for title, ax in axes.items() if percent in title)
        (picture,) = ax.images
        np.testing.assert_allclose(picture.get_array(), 100 * residual)
        low, high = picture.get_clim()
        assert -low == high == pytest.approx(100 * np.percentile(np.abs(residuals[0]), 99))


def test_each_parameter_is_shown_on_its_path(draw, residuals):
    shown = calibration(*residuals)
    axes = draw(shown).subfigs[1].axes
    for k, parameter in enumerate(shown.parameters):
        ax = axes[k]
        assert ax.get_title().startswith(parameter.name)
        *paths, best, start, end = ax.get_lines()
        for level, (line, values) in enumerate(zip(paths, (SEARCH, DESCENT), strict=True)):
            place, visited = line.get_data()
            np.testing.assert_array_equal(visited, values[:, k])
            assert level < place[0] and place[-1] < level + 1 and (np.diff(place) > 0).all()
        np.testing.assert_array_equal(best.get_data(), (place, BEST[:, k]))
        assert start.get_ydata()[0] == parameter.start
        assert end.get_ydata()[0] == parameter.value
        (band,) = ax.patches
        error = parameter.standard_error
        low, high = parameter.value - error, parameter.value + error
        np.testing.assert_allclose([band.get_y(), band.get_y() + band.get_height()], [low, high])
        labels = [label.get_text() for label in ax.get_xticklabels()]
        assert labels == ["4 x 4", "16 x 18"]
    # The range holds the descent, not all that was searched.
    np.testing.assert_allclose(axes[0].get_ylim(), [-0.08 * 0.11, 1.08 * 0.11])


def test_a_calibration_that_is_not_to_be_trusted_says_so(draw, residuals):
    doubted = calibration(*residuals)
    assert draw(doubted).subfigs[0].get_suptitle() == ""
    doubted.doubts = ("dx ended 18.0 of the ruler's errors from there",)
    assert doubted.doubts[0] in draw(doubted).subfigs[0].get_suptitle()


@pytest.mark.parametrize("count", [1, 4, 7])
def test_paths_fill_their_rows(draw, residuals, count):
    shown = calibration(*residuals)
    shown.parameters = shown.parameters[:1] * count
    for visited in shown.path:
        visited.values = np.repeat(visited.values[:, :1], count, axis=1)
    above, beneath = draw(shown).subfigs
    assert len(above.axes) == 4
    rows = beneath.axes[0].get_gridspec().nrows
    assert len(beneath.axes) - count < rows <= -(-count // 4)
    assert len(beneath.legends[0].get_texts()) == 6
