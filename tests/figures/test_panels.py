import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb

from periscopy_sim.figures.panels import (
    displayable,
    draw_certainty,
    draw_maps,
    draw_panels,
    draw_sweep,
    enlarged,
    write_enlarged,
)
from periscopy_sim.figures.style import OKABE_ITO
from periscopy_sim.storage.pictures import write_png
from tests.figures.conftest import covers, read

METADATA = {"Source": "chair.xml, seed 3", "Comment": "λ = 1"}


def gradient_image(rows=6, columns=8):
    return np.linspace(0, 1, rows * columns * 3).reshape(rows, columns, 3)


def test_displayable_shows_the_brightest_half_percent_white_and_negatives_black():
    image = np.arange(-100.0, 900.0).reshape(10, -1, 1)[:, :99].repeat(3, axis=2)
    level = np.sort(image[..., 0].ravel())[int(0.995 * 989)]
    shown = displayable(image)
    assert shown.dtype == np.float64
    np.testing.assert_array_equal(shown[image < 0], 0)
    assert 0.002 < np.mean(shown == 1) < 0.008
    middle = (image > 0) & (image < 0.9 * level)
    np.testing.assert_allclose(shown[middle], image[middle] / level, rtol=2e-3)


def test_displayable_keeps_colours_by_one_factor():
    image = gradient_image() * [1.0, 0.5, 0.1]
    shown = displayable(image, white=2.0)
    np.testing.assert_allclose(shown, image / 2)
    np.testing.assert_allclose(displayable(1e-9 * image), displayable(image))


@pytest.mark.parametrize("value", [0.0, -3.0])
@pytest.mark.parametrize("white", [None, 0.0])
def test_displayable_of_an_image_without_light_is_black(value, white):
    np.testing.assert_array_equal(displayable(np.full((4, 5, 3), value), white), 0)


@pytest.mark.parametrize(("columns", "width", "factor"), [(36, 720, 20), (7, 20, 2), (9, 4, 1)])
def test_enlarged_repeats_each_patch(columns, width, factor):
    image = gradient_image(2, columns)
    large = enlarged(image, width)
    assert large.shape == (2 * factor, columns * factor, 3)
    for i in range(factor):
        for j in range(factor):
            np.testing.assert_array_equal(large[i::factor, j::factor], image)


def test_an_image_is_written_as_it_is_enlarged(tmp_path):
    image = gradient_image(3, 7)
    write_enlarged(tmp_path / "at_once.png", image, METADATA, 50)
    write_png(tmp_path / "before.png", enlarged(image, 50), METADATA)
    assert (tmp_path / "at_once.png").read_bytes() == (tmp_path / "before.png").read_bytes()


def test_panels_of_different_shapes_show_their_images_in_srgb(tmp_path):
    path = tmp_path / "panels.png"
    # Linear 0.2140 is 0.5 in sRGB, 1 is 1, 0.0513 is 0.25.
    wide = np.broadcast_to([0.21404, 1.0, 0.0], (4, 16, 3))
    tall = np.broadcast_to([0.0, 0.05127, 1.0], (12, 4, 3))
    draw_panels(path, [("wide", wide), ("tall", tall)], caption="c", metadata=METADATA)
    text, pixels = read(path)
    assert METADATA.items() <= text.items()
    first, second = covers(pixels, [127.5, 255, 0]), covers(pixels, [0, 63.8, 255])
    heights = []
    for covered, aspect in ((first, 4), (second, 1 / 3)):
        rows, columns = np.nonzero(covered)
        height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
        assert covered.sum() > 0.95 * height * width
        assert width / height == pytest.approx(aspect, rel=0.01)
        heights.append(height)
    assert heights[0] == pytest.approx(heights[1], rel=0.05)
    assert np.nonzero(first)[1].max() < np.nonzero(second)[1].min()


def test_panels_keep_row_0_at_the_top_and_do_not_smooth(tmp_path):
    image = np.array([[[1, 0, 0], [1, 0, 1]], [[0, 1, 1], [0, 1, 0]]], float)
    draw_panels(tmp_path / "panels.png", [("", image)])
    pixels = read(tmp_path / "panels.png")[1]
    corners = [covers(pixels, 255 * colour) for colour in image.reshape(4, 3)]
    top_left, bottom_right = np.nonzero(corners[0]), np.nonzero(corners[3])
    for axis in (0, 1):
        assert top_left[axis].max() < bottom_right[axis].min()
    rows, columns = np.nonzero(np.any(corners, axis=0))
    area = (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    for corner in corners:
        assert corner.sum() == pytest.approx(area / 4, rel=0.05)


def test_maps_share_one_logarithmic_scale(tmp_path, saved):
    maps = {"a": np.array([[1.0, 10.0]]), "b": np.array([[10.0, 100.0]])}
    draw_maps(tmp_path / "maps.png", list(maps.items()), "unit")
    (figure,) = saved
    colours = []
    for ax, (title, values) in zip(figure.axes, maps.items(), strict=False):
        (picture,) = ax.images
        assert ax.get_title() == title and picture.get_clim() == (1, 100)
        colours.append(picture.cmap(picture.norm(values)))
    np.testing.assert_allclose(colours[0][0, 1], colours[1][0, 0])
    assert figure.axes[-1].get_ylabel() == "unit"
    draw_maps(tmp_path / "constant.png", [("a", np.full((3, 4), 1e-9))], "unit")


def sweep_results(errors, sbrs=(0.1, 1, 10), methods=("first", "second")):
    """Errors over (method, background, sbr, seed) as a sweep gives them."""
    errors = np.asarray(errors, float)
    labels = {
        "algorithm": list(methods)[: len(errors)],
        "background": [f"b{i}" for i in range(errors.shape[1])],
        "sbr": list(sbrs),
        "seed": list(range(errors.shape[3])),
    }
    return xr.Dataset({"mean_squared_error": (tuple(labels), errors)}, labels)


def test_sweep_shows_means_and_bands_of_each_method_in_its_colour(tmp_path, saved):
    errors = np.random.default_rng(3).uniform(0.01, 0.1, (2, 5, 3, 2))
    errors[1, :, 2] = np.nan  # the second failed at the last ratio
    draw_sweep(tmp_path / "a.png", sweep_results(errors), metadata=METADATA)
    draw_sweep(tmp_path / "b.png", sweep_results(errors[:, :, ::-1], (10, 1, 0.1)))
    text, pixels = read(tmp_path / "a.png")
    assert METADATA.items() <= text.items()
    (ax,) = saved[0].axes
    for k, count in enumerate((3, 2)):
        line, band = ax.lines[k], ax.collections[k].get_paths()[0].vertices
        own = errors[k].transpose(1, 0, 2).reshape(3, 10)[:count]
        assert to_rgb(line.get_color()) == to_rgb(OKABE_ITO[k])
        np.testing.assert_allclose(line.get_xdata(), [0.1, 1, 10][:count])
        np.testing.assert_allclose(line.get_ydata(), own.mean(axis=1))
        low, high = np.percentile(own[0], (10, 90))
        first = band[np.isclose(band[:, 0], 0.1), 1]
        np.testing.assert_allclose([first.min(), first.max()], [low, high])
        assert covers(pixels, 255 * np.array(to_rgb(OKABE_ITO[k]))).sum() > 500
    for one, other in zip(ax.lines, saved[1].axes[0].lines, strict=True):
        np.testing.assert_allclose(one.get_xydata(), other.get_xydata())


def test_sweep_leaves_out_a_method_that_failed(tmp_path, saved):
    errors = np.full((2, 3, 1, 1), 0.02)
    errors[0] = np.nan
    draw_sweep(tmp_path / "one.png", sweep_results(errors, (0.5,)))
    draw_sweep(tmp_path / "none.png", sweep_results(errors[:1], (0.5,)))
    assert [[str(line.get_label()) for line in each.axes[0].lines] for each in saved] == [
        ["second"], []
    ]  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b"),
        ("preconditioned", "differencing", "truncated-svd", "deep/my_method.py:MyOwnMethod", "e"),
    ],
)
def test_legend_of_a_sweep_stands_outside_the_axes_and_inside_the_picture(names, tmp_path, saved):
    errors = np.random.default_rng(3).uniform(0.01, 0.1, (len(names), 5, 3, 2))
    draw_sweep(tmp_path / "sweep.png", sweep_results(errors, methods=names))
    (figure,) = saved
    (ax,), (legend,) = figure.axes, figure.legends
    assert [text.get_text() for text in legend.get_texts()] == list(names)
    place, axes = legend.get_window_extent(), ax.get_window_extent()
    assert place.y0 >= axes.y1
    assert place.x0 >= 0 and place.x1 <= figure.bbox.x1 and place.y1 <= figure.bbox.y1
    assert axes.height > 0.6 * axes.width  # the curves keep their room


@pytest.mark.parametrize("shape", [(15, 18), (30, 5)])
def test_certainty_shows_the_errors_in_percent_and_what_they_assume(saved, tmp_path, shape):
    image = np.full((*shape, 3), 4.0)
    errors = np.zeros((*shape, 3))
    errors[2, 3] = (0.1, 0.2, 0.2)
    draw_certainty(tmp_path / "certainty.png", image, errors, "the scene is right")
    (figure,) = saved
    _, right, bar = figure.axes
    shown = right.images[0].get_array()
    assert shown[2, 3] == pytest.approx(100 * np.sqrt(0.03) / 4) and np.count_nonzero(shown) == 1
    assert "%" in bar.get_ylabel() and "the scene is right" in figure.get_supxlabel()
    _, pixels = read(tmp_path / "certainty.png")
    assert pixels[:, :2].min() == pixels[:, -2:].min() == 255  # nothing is cut off
