import sys
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.errors import OutputError
from periscopy_sim.storage.rasters import srgb_decode


@pytest.fixture(autouse=True)
def no_window():
    from matplotlib import pyplot as plt

    with matplotlib.rc_context({"backend": "agg"}):
        yield
    plt.close("all")


@pytest.fixture
def image():
    return np.random.default_rng(4).uniform(0, 1, (20, 30, 3))


def test_light_is_encoded_as_srgb_with_the_brightest_half_percent_white(image):
    encoded = ps.to_srgb(image)
    white = np.sort(image.ravel())[int(0.995 * (image.size - 1))]
    dim = image < 0.99 * white
    np.testing.assert_allclose(srgb_decode(encoded[dim]), image[dim] / white, rtol=2e-3)
    assert encoded.max() == pytest.approx(1, abs=1e-12) and encoded.shape == image.shape
    np.testing.assert_allclose(srgb_decode(ps.to_srgb(image, white=2)), image / 2, rtol=1e-9)


def test_what_cannot_be_shown_is_black(image):
    image[3, 4], image[5, 6] = np.nan, -1
    encoded = ps.to_srgb(image)
    assert not encoded[[3, 5], [4, 6]].any()
    mask = np.arange(30) > 10 * np.ones((20, 1))
    shown = ps.to_srgb(ps.Photograph.of(np.ones((20, 30, 3)), mask=mask), 1)
    np.testing.assert_allclose(shown.max(axis=2), mask, atol=1e-9)
    image[3, 4] = image[5, 6] = 0
    np.testing.assert_allclose(encoded, ps.to_srgb(image), atol=0.02)


def test_grey_images_and_masks_are_shown_in_grey(image):
    grey = ps.to_srgb(image[..., 0])
    assert grey.shape == image.shape and (grey == grey[..., :1]).all()
    np.testing.assert_array_equal(ps.to_srgb(image[..., :1]), grey)
    four = np.concatenate([image, image[..., :1]], axis=2)
    np.testing.assert_array_equal(ps.to_srgb(four, 1), ps.to_srgb(image, 1))
    mask = image[..., 0] > 0.5
    np.testing.assert_allclose(ps.to_srgb(mask)[..., 1], mask, atol=1e-12)


def test_what_is_no_image_is_refused():
    for wrong in [np.zeros((2, 2, 3, 3)), np.zeros(5), np.full((2, 2), np.nan)]:
        for act in (ps.to_srgb, ps.show):
            with pytest.raises(ValueError, match="is no image"):
                act(wrong)


def test_file_holds_what_the_screen_shows(image, tmp_path):
    ps.save_png(tmp_path / "new" / "image.png", image)
    with Image.open(tmp_path / "new" / "image.png") as picture:
        pixels = np.asarray(picture.convert("RGB"))
    enlarged = np.rint(255 * ps.to_srgb(image)).repeat(13, axis=0).repeat(13, axis=1)
    np.testing.assert_array_equal(pixels, enlarged)  # 20 rows become 260
    with pytest.raises(OutputError):
        ps.save_png(tmp_path, image)


def test_notebook_displays_a_figure_once(image, monkeypatch):
    from matplotlib import pyplot as plt

    displayed = []
    monkeypatch.setattr(plt, "get_backend", lambda: "inline")
    figure = ps.show(image)
    fake = SimpleNamespace(display=SimpleNamespace(display=displayed.append))
    monkeypatch.setitem(sys.modules, "IPython", fake)
    assert plt.fignum_exists(figure.number) and not displayed
    figure._ipython_display_()  # IPython calls it, for a cell's last value or after the cell
    assert displayed == [figure] and not plt.fignum_exists(figure.number)
    assert not hasattr(figure, "_ipython_display_")


def test_images_stand_side_by_side_each_with_its_own_exposure(image):
    axes = ps.show(image, titles=["one"], the_other=5 * image).axes
    assert [ax.get_title() for ax in axes] == ["one", "the other"]
    shown = [ax.images[0].get_array() for ax in axes]
    np.testing.assert_allclose(shown[0], shown[1], atol=1e-12)
    np.testing.assert_array_equal(shown[0], ps.to_srgb(image))
    assert axes[0].images[0].get_interpolation() == "nearest"
    alike = [ax.images[0].get_array() for ax in ps.show(image, 5 * image, white=5).axes]
    assert np.mean(alike[1]) > 1.5 * np.mean(alike[0])
