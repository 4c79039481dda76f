import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib.figure import Figure
from PIL import Image

from periscopy_sim.figures.panels import (
    displayable,
    draw_certainty,
    draw_maps,
    draw_panels,
    draw_sweep,
    enlarged,
    write_enlarged,
)
from periscopy_sim.storage.pictures import write_png

METADATA = {"Source": "chair.xml, seed 3", "Comment": "λ = 1"}


def read(path):
    """Text chunks and 8-bit colours of a PNG, (height, width, 3)."""
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return dict(picture.text), np.asarray(picture.convert("RGB")).astype(int)


def covers(pixels, colour):
    """Where a picture has a colour, give or take one level of rounding."""
    return np.abs(pixels - np.round(colour)).max(axis=2) <= 1


def viridis(fraction):
    return 255 * np.array(colormaps["viridis"](fraction)[:3])


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


def test_panels_are_a_readable_png_with_its_metadata(tmp_path):
    path = tmp_path / "panels.png"
    panels = [("truth", gradient_image()), ("estimate", gradient_image(3, 20))]
    draw_panels(path, panels, caption="a caption", metadata=METADATA)
    text, pixels = read(path)
    assert METADATA.items() <= text.items()
    assert pixels.shape[1] > pixels.shape[0] > 400


def test_panels_of_different_shapes_show_their_images_in_srgb(tmp_path):
    path = tmp_path / "panels.png"
    # Linear 0.2140 is 0.5 in sRGB, 1 is 1, 0.0513 is 0.25.
    wide = np.broadcast_to([0.21404, 1.0, 0.0], (4, 16, 3))
    tall = np.broadcast_to([0.0, 0.05127, 1.0], (12, 4, 3))
    draw_panels(path, [("wide", wide), ("tall", tall)])
    pixels = read(path)[1]
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


def test_caption_is_drawn(tmp_path):
    for caption in ("", "a caption of some length"):
        draw_panels(tmp_path / "panels.png", [("t", gradient_image())], caption=caption)
        pixels = read(tmp_path / "panels.png")[1]
        bottom = pixels[-pixels.shape[0] // 12 :]
        assert bool(np.any(bottom < 128)) == bool(caption)


def test_maps_share_one_logarithmic_scale(tmp_path):
    path = tmp_path / "maps.png"
    draw_maps(path, [("a", np.array([[1.0, 10.0]])), ("b", np.array([[10.0, 100.0]]))], "unit")
    pixels = read(path)[1]
    area = pixels.shape[0] * pixels.shape[1]
    left, right = (np.s_[:, : pixels.shape[1] * 4 // 9], np.s_[:, pixels.shape[1] * 4 // 9 :])
    for side, fractions, absent in ((left, (0.0, 0.5), 1.0), (right, (0.5, 1.0), 0.0)):
        for fraction in fractions:
            assert covers(pixels[side], viridis(fraction)).sum() > 0.03 * area
        assert covers(pixels[side], viridis(absent)).sum() < 0.01 * area


@pytest.mark.thorough
@pytest.mark.parametrize("value", [1e-9, 1.0, 250.0])
def test_constant_maps_are_drawn_in_one_colour(tmp_path, value):
    path = tmp_path / "maps.png"
    draw_maps(path, [("a", np.full((3, 4), value)), ("b", np.full((5, 2), value))], "unit")
    pixels = read(path)[1]
    coloured = pixels[np.ptp(pixels, axis=2) > 30]
    _, counts = np.unique(coloured, axis=0, return_counts=True)
    assert counts.max() > 0.7 * counts.sum()


BLUE, ORANGE = np.array([0, 0x72, 0xB2]), np.array([0xD5, 0x5E, 0])


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


def rows_of(pixels, colour, part):
    """Mean row at which a colour is seen, in one of three parts of the picture's width."""
    width = pixels.shape[1]
    seen = covers(pixels, colour)
    seen[:, : width // 6] = seen[: pixels.shape[0] // 10] = False  # labels, legend
    rows, columns = np.nonzero(seen)
    third = np.digitize(columns, np.quantile(columns, [0.33, 0.67]))
    return rows[third == part].mean()


def test_sweep_shows_each_method_in_its_colour_the_greater_error_higher(tmp_path):
    errors = np.full((2, 4, 3, 1), 0.01)
    errors[1] = np.array([0.2, 0.1, 0.05])[:, None]
    draw_sweep(tmp_path / "sweep.png", sweep_results(errors), metadata=METADATA)
    text, pixels = read(tmp_path / "sweep.png")
    assert METADATA.items() <= text.items()
    assert pixels.shape[1] == 1050  # 3.5 inches at 300 dots
    blue, orange = (
        [rows_of(pixels, colour, part) for part in range(3)] for colour in (BLUE, ORANGE)
    )
    assert np.ptp(blue) < 5 and max(orange) < min(blue) and orange[0] < orange[1] < orange[2]


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b"),
        ("preconditioned", "differencing", "differencing-published", "truncated-svd"),
        ("preconditioned", "differencing", "truncated-svd", "deep/my_method.py:MyOwnMethod", "e"),
    ],
)
def test_legend_of_a_sweep_stands_outside_the_axes_and_inside_the_picture(
    names, tmp_path, monkeypatch
):
    drawn = []
    save = Figure.savefig

    def remember(figure, *arguments, **options):
        drawn.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", remember)
    errors = np.random.default_rng(3).uniform(0.01, 0.1, (len(names), 5, 3, 2))
    draw_sweep(tmp_path / "sweep.png", sweep_results(errors, methods=names))
    (figure,) = drawn
    (ax,) = figure.axes
    inside = [legend for legend in [ax.get_legend()] if legend]
    (legend,) = figure.legends + inside
    assert [text.get_text() for text in legend.get_texts()] == list(names)
    assert "bands: 10th to 90th percentile" in figure.get_supxlabel()
    place, axes = legend.get_window_extent(), ax.get_window_extent()
    assert place.y0 >= axes.y1
    assert place.x0 >= 0 and place.x1 <= figure.bbox.x1 and place.y1 <= figure.bbox.y1
    assert axes.height > 0.6 * axes.width  # the curves keep their room


def test_sweep_does_not_depend_on_the_order_of_its_ratios(tmp_path):
    errors = np.random.default_rng(3).uniform(0.01, 0.1, (2, 5, 3, 2))
    draw_sweep(tmp_path / "a.png", sweep_results(errors))
    draw_sweep(tmp_path / "b.png", sweep_results(errors[:, :, ::-1], (10, 1, 0.1)))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_band_of_a_sweep_spans_its_backgrounds(tmp_path):
    heights = []
    for spread in (1.0, 3.0):
        errors = 0.05 * np.geomspace(1 / spread, spread, 21)[None, :, None, None]
        draw_sweep(tmp_path / "sweep.png", sweep_results(np.tile(errors, (1, 1, 3, 1))))
        pixels = read(tmp_path / "sweep.png")[1]
        tinted = (pixels[..., 2] - pixels[..., 0] > 20) & (pixels[..., 0] > 150)
        heights.append(tinted.sum())
    assert heights[1] > 20 * max(heights[0], 500)


@pytest.mark.parametrize(
    ("failed", "left"),
    [
        (np.s_[0], [False, True]),
        (np.s_[:], [False, False]),
        (np.s_[:, 0, 1], [True, True]),
        (np.s_[1, :, 0], [True, True]),
    ],
)
def test_sweep_leaves_out_what_failed(failed, left, tmp_path):
    errors = np.random.default_rng(3).uniform(0.01, 0.1, (2, 5, 3, 2))
    errors[failed] = np.nan
    draw_sweep(tmp_path / "sweep.png", sweep_results(errors))
    pixels = read(tmp_path / "sweep.png")[1]
    drawn = [bool(covers(pixels, colour).sum() > 500) for colour in (BLUE, ORANGE)]
    assert drawn == left


def test_sweep_over_one_ratio_is_drawn(tmp_path):
    draw_sweep(tmp_path / "sweep.png", sweep_results(np.full((1, 3, 1, 1), 0.02), (0.5,)))
    assert covers(read(tmp_path / "sweep.png")[1], BLUE).sum() > 50


@pytest.mark.parametrize("shape", [(15, 18), (30, 5)])
def test_certainty_shows_the_errors_in_percent_and_what_they_assume(monkeypatch, tmp_path, shape):
    drawn = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda f, *a, **k: (drawn.append(f), save(f, *a, **k)))
    image = np.full((*shape, 3), 4.0)
    errors = np.zeros((*shape, 3))
    errors[2, 3] = (0.1, 0.2, 0.2)
    draw_certainty(tmp_path / "certainty.png", image, errors, "the scene is right")
    (figure,) = drawn
    left, right, bar = figure.axes
    assert (left.get_title(), right.get_title()) == ("reconstruction", "standard error")
    shown = right.images[0].get_array()
    assert shown[2, 3] == pytest.approx(100 * np.sqrt(0.03) / 4) and np.count_nonzero(shown) == 1
    assert bar.get_ylabel() == "% of white"
    caption = " ".join(figure.get_supxlabel().split())
    assert "how far each patch may be off" in caption
    assert "assumes that the scene is right." in caption
    _, pixels = read(tmp_path / "certainty.png")
    assert pixels[:, :2].min() == pixels[:, -2:].min() == 255  # nothing is cut off
