"""Hidden surfaces: images and vectors, and the differences between patches."""

import numpy as np
import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.hidden import Hidden
from tests.scenes.surfaces import screen_and_column


@pytest.mark.parametrize("shape", [(4, 5), (1, 6), (3, 1), (1, 1)])
def test_flat_differences_are_numpys(shape: tuple[int, int]) -> None:
    differences = Hidden.of(shape).differences
    image = np.random.default_rng(0).normal(size=(*shape, 3))
    steps = [np.diff(image, axis=k, append=np.take(image, [-1], k)) for k in (0, 1)]
    f = image.reshape(-1, 3)
    np.testing.assert_allclose(differences(f), np.reshape(steps, (2, -1, 3)), atol=1e-14)
    np.testing.assert_allclose(differences.matrix @ f, np.reshape(steps, (-1, 3)), atol=1e-14)
    norms = np.sqrt(np.sum(np.square(steps), axis=(0, 3))).ravel()
    np.testing.assert_allclose(differences.norms(f), norms, atol=1e-14)
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)))
    dark = [np.diff(padded[:, 1:-1], axis=0), np.diff(padded[1:-1], axis=1)]
    energy = sum(float(np.sum(step**2)) for step in dark)
    assert np.sum((differences.in_the_dark @ f) ** 2) == pytest.approx(energy, rel=1e-12)
    wide = Hidden.of(padded.shape[:2]).differences.norms(padded.reshape(-1, 3)).sum()
    assert differences.variation_in_the_dark(f) == pytest.approx(wide, rel=1e-12)
    largest = np.linalg.norm(differences.matrix.toarray(), 2) ** 2
    assert largest * (1 - 1e-9) <= differences.norm_bound <= 8


def test_differences_in_time_join_each_patch_to_the_next_frame() -> None:
    hidden, weight = screen_and_column(), 0.7
    video = np.random.default_rng(4).normal(size=(3, hidden.patches))
    differences = hidden.differences.over_time(3, weight)
    found = differences(video.ravel()).reshape(3, 3, -1)
    for frame in range(3):
        np.testing.assert_allclose(found[:2, frame], hidden.differences(video[frame]), atol=1e-14)
    ahead = weight * np.diff(video, axis=0, append=video[-1:])
    np.testing.assert_allclose(found[2], ahead, atol=1e-14)
    matrix = differences.matrix.toarray()
    np.testing.assert_allclose(matrix @ video.ravel(), found.ravel(), atol=1e-14)
    assert np.linalg.norm(matrix, 2) ** 2 <= differences.norm_bound


def test_slopes_are_exact_for_polynomials_and_see_darkness_beyond_the_borders() -> None:
    hidden = Hidden.of({"screen": (7, 8), "card": (5, 1)})
    y, x = np.mgrid[:7, :8] / 4
    f = hidden.join({"screen": x**4 - y**3 * x, "card": np.ones((5, 1))})
    down, across = (hidden.split(each) for each in hidden.differences.slopes(f))
    np.testing.assert_allclose(4 * down["screen"][2:-2], (-3 * y**2 * x)[2:-2], atol=1e-12)
    np.testing.assert_allclose(
        4 * across["screen"][:, 2:-2], (4 * x**3 - y**3)[:, 2:-2], atol=1e-12
    )
    # A bar that moves down loses light at its top and gains it beyond its bottom.
    np.testing.assert_allclose(12 * down["card"].ravel(), [7, -1, 0, 1, -7], atol=1e-12)
    assert not across["card"].any()


def test_differences_of_surfaces_do_not_meet() -> None:
    hidden = screen_and_column()
    f = np.random.default_rng(1).normal(size=hidden.patches)
    both = hidden.differences(f)
    for name, part in hidden.split(np.moveaxis(both, 0, -1)).items():
        alone = Hidden({name: hidden[name]})
        expected = alone.differences(hidden.split(f)[name].ravel())
        np.testing.assert_allclose(np.moveaxis(part, -1, 0).reshape(2, -1), expected, atol=1e-14)


def test_images_and_vectors() -> None:
    hidden = Hidden.of({"screen": (3, 4), "card": (2, 1)})
    assert Hidden.of((3, 4)).shape == (3, 4)
    with pytest.raises(ValueError, match="surfaces"):
        _ = hidden.shape
    f = np.random.default_rng(2).normal(size=(hidden.patches, 3))
    images = hidden.image(f)
    shapes = {name: each.shape for name, each in images.items()}
    assert shapes == {"screen": (3, 4, 3), "card": (2, 1, 3)}
    np.testing.assert_array_equal(hidden.vector(images), f)
    one = Hidden.of((3, 4))
    np.testing.assert_array_equal(one.vector(one.image(f[:12])), f[:12])
    codes = {name: np.full(each.shape, 128, np.uint8) for name, each in images.items()}
    for wrong in ({"screen": images["screen"]}, {**images, "card": images["screen"]}):
        with pytest.raises(PeriscopyError, match="card"):
            hidden.join(wrong)
    with pytest.raises(PeriscopyError, match="uint8"):
        hidden.images(codes)
    with pytest.raises(PeriscopyError):
        Hidden({})
