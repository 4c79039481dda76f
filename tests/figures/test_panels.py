import numpy as np
import pytest

from periscopy_sim.figures import panels
from periscopy_sim.model.residual import Residual
from tests.scenes.pictures import covers, read

METADATA = {"Source": "chair.xml, seed 3", "Comment": "λ = 1"}


def test_panels_of_different_shapes_show_their_images_in_srgb(tmp_path):
    path = tmp_path / "panels.png"
    # Linear 0.2140 is 0.5 in sRGB, 1 is 1, 0.0513 is 0.25.
    wide = np.broadcast_to([0.21404, 1.0, 0.0], (4, 16, 3))
    tall = np.broadcast_to([0.0, 0.05127, 1.0], (12, 4, 3))
    panels.draw_panels(path, [("wide", wide), ("tall", tall)], caption="c", metadata=METADATA)
    text, pixels = read(path)
    assert METADATA.items() <= text.items()
    first, second = covers(pixels, [127.5, 255, 0]), covers(pixels, [0, 63.8, 255])
    heights = []
    for covered, aspect in ((first, 4), (second, 1 / 3)):
        rows, columns = np.nonzero(covered)
        height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
        assert covered.sum() > 0.95 * height * width
        assert width / height == pytest.approx(aspect, rel=0.02)
        heights.append(height)
    assert heights[0] == pytest.approx(heights[1], rel=0.05)
    assert np.nonzero(first)[1].max() < np.nonzero(second)[1].min()


def test_pictures_of_other_channels_are_grey_or_show_the_first_three(tmp_path):
    """Linear 0.2140 is 0.5 in sRGB, 0.0513 is 0.25; two channels show their mean."""
    for channels in [1, 2, 5]:
        bands = np.array([0.21404, 0.05127, 1.0, 0.9, 0.9])[:channels]
        if channels == 2:
            bands = np.array([0.21404, 0.21404])
        panels.draw_panels(tmp_path / "p.png", [("p", np.broadcast_to(bands, (8, 8, channels)))])
        _, pixels = read(tmp_path / "p.png")
        shown = [127.5] * 3 if channels < 3 else [127.5, 63.8, 255]
        assert covers(pixels, shown).sum() > 0.4 * pixels.shape[0] * pixels.shape[1]


def test_strips_are_stretched_to_a_legible_height(tmp_path):
    strip = np.random.default_rng(0).uniform(size=(1, 60, 1))
    panels.write_enlarged(tmp_path / "strip.png", panels.displayable(strip), {})
    _, pixels = read(tmp_path / "strip.png")
    assert pixels.shape == (180, 720, 3)
    assert (pixels == pixels[:1]).all() and len(np.unique(pixels[0], axis=0)) > 40
    panels.draw_certainty(
        tmp_path / "c.png", {"monitor": strip}, {"monitor": strip}, "all is right"
    )
    _, pixels = read(tmp_path / "c.png")
    assert pixels.shape[1] < 8 * pixels.shape[0]


def test_bounds_share_one_logarithmic_scale_and_their_ratio_has_its_own(tmp_path, saved):
    alone, both = {"a": np.array([[0.01, 0.1]])}, {"a": np.array([[0.02, 1.0]])}
    panels.draw_bounds(tmp_path / "bounds.png", alone, both)
    first, second, ratio = saved[0].axes[:3]
    for ax, values in ((first, [[1, 10]]), (second, [[2, 100]])):
        (picture,) = ax.images
        assert picture.get_clim() == (1, 100)
        np.testing.assert_allclose(picture.get_array(), values)
    np.testing.assert_allclose(ratio.images[0].get_array(), [[2, 10]])
    constant = {"a": np.full((3, 4), 1e-9)}
    panels.draw_bounds(tmp_path / "constant.png", constant, constant)


@pytest.mark.parametrize("values", [np.zeros((3, 4)), np.full((3, 4), np.inf), np.eye(3)])
def test_bounds_that_no_scale_shows_are_hatched_and_the_caption_says_so(values, tmp_path, saved):
    panels.draw_bounds(tmp_path / "bounds.png", {"a": values}, {"a": values}, caption="bounds")
    assert "bounds; hatched: no bound above 0" in saved[0].get_supxlabel().replace("\n", " ")
    known = values == 1
    for ax in saved[0].axes[:3]:
        np.testing.assert_array_equal(~np.isnan(ax.images[0].get_array().filled(np.nan)), known)
        assert len(ax.images) == 2  # with the hatching behind


def test_unknown_pixels_are_hatched_in_light_and_in_maps(tmp_path, saved):
    light = np.full((6, 8, 3), 0.5)
    light[:3] = np.nan
    panels.draw_panels(tmp_path / "a.png", [("known", np.full((6, 8, 3), 0.5)), ("half", light)])
    known, half = saved[0].axes
    assert len(known.images) == 1 and len(half.images) == 2
    assert len(np.unique(half.images[1].get_array())) == 2
    assert (half.images[0].get_array()[:, 0, 3] == [0, 0, 0, 1, 1, 1]).all()


@pytest.mark.parametrize("shape", [(15, 18), (30, 5)])
def test_certainty_shows_the_errors_in_percent_and_what_they_assume(saved, tmp_path, shape):
    image = np.full((*shape, 3), 4.0)
    errors = np.zeros((*shape, 3))
    errors[2, 3] = (0.1, 0.2, 0.2)
    panels.draw_certainty(
        tmp_path / "certainty.png", {"monitor": image}, {"monitor": errors}, "the scene is right"
    )
    (figure,) = saved
    _, right, bar = figure.axes
    shown = right.images[0].get_array()
    assert shown[2, 3] == pytest.approx(100 * np.sqrt(0.03) / 4) and np.count_nonzero(shown) == 1
    assert "%" in bar.get_ylabel() and "the scene is right" in figure.get_supxlabel()
    _, pixels = read(tmp_path / "certainty.png")
    assert pixels[:, :2].min() == pixels[:, -2:].min() == 255  # nothing is cut off


RNG = np.random.default_rng(0)
PHOTOGRAPH = RNG.uniform(1, 2, (20, 30, 3))


def residual(noise_alone=0.1):
    light = np.array([0.1, 0.2, 0.2]) * RNG.standard_normal((20, 30, 3))
    light[5:8, 10:20] = np.nan
    light[12, 3] = 2.0
    return Residual(light, 0.12, None, noise_alone, None, "unknown")


@pytest.mark.parametrize("noise_alone", [0.1, None])
def test_map_is_signed_over_noise_or_in_percent(noise_alone, tmp_path, saved):
    given = residual(noise_alone)
    panels.draw_residual(tmp_path / "r.png", PHOTOGRAPH, given, "a caption")
    (figure,) = saved
    picture = figure.axes[1].images[0]
    shown = np.ma.filled(picture.get_array(), np.nan)
    # The unexplained light is 0.12 of the photograph.
    level = np.sqrt(np.nanmean(given.light**2)) / 0.12
    unit = level / 100 if noise_alone is None else 0.1 * level / np.sqrt(3)
    np.testing.assert_allclose(shown, given.light.mean(axis=2) / unit, rtol=1e-12)
    low, high = picture.get_clim()
    assert low == -high and high >= (0 if noise_alone is None else 4)
    assert ("%" in figure.axes[-1].get_ylabel()) is (noise_alone is None)
    assert figure.get_supxlabel() == "a caption"
