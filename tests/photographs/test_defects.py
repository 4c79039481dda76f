from math import erfc, sqrt
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.photographs import develop
from periscopy_sim.photographs.develop import defective_pixels
from periscopy_sim.storage.rasters import srgb_decode

SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "chair_mushroom.npz"
ROWS, COLUMNS = 90, 110
DOWN, ACROSS = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLUMNS), indexing="ij")
WALLS = {
    "lamp": 1 / ((ACROSS - 0.3) ** 2 + (DOWN - 1.5) ** 2 + 1) ** 1.5,
    "ridge": 1 - 0.5 * ACROSS**2,
    "hill": 1 - 0.3 * (ACROSS**2 + DOWN**2),
    "spot": np.exp(-5 * (ACROSS**2 + DOWN**2)),
    "slope": 1 + 0.4 * ACROSS + 0.1 * DOWN,
    "steps": np.where(ACROSS > 0, 0.5, 1) * np.where(DOWN > 0.3, 0.2, 1) * (1 + 0.05 * DOWN),
    "flat": np.ones((ROWS, COLUMNS)),
}
COLOUR = np.array([1.0, 0.8, 0.6])


def photograph(wall="lamp", noise=0.01, seed=0):
    light = WALLS[wall] / WALLS[wall].max()
    return light[..., None] * COLOUR + np.random.default_rng(seed).normal(
        0, noise, (ROWS, COLUMNS, 3)
    )


def counts(values, *rest):
    found = defective_pixels(values, *rest)
    return [int(kind.sum()) for kind in (found.saturated, found.dead, found.hot)]


@pytest.mark.parametrize("wall", WALLS)
def test_walls_in_light_have_no_defects(wall):
    for seed, noise in enumerate((0, 1e-5, 1e-3, 0.01, 0.05)):
        assert counts(photograph(wall, noise, seed)) == [0, 0, 0], noise


@pytest.mark.parametrize("wall", WALLS)
def test_quantized_walls_have_no_defects(wall):
    for top in (30, 255, 4095, 50_000):
        for steps in (0, 0.5, 5):
            y = np.round(0.93 * top * photograph(wall, steps / top, seed=1))
            assert counts(y) == [0, 0, 0], (top, steps)
    encoded = np.round(220 * np.clip(photograph(wall, 0.003), 0, 1)) / 255
    assert counts(srgb_decode(encoded)) == [0, 0, 0]


def test_subtracted_black_levels_are_no_dead_pixels():
    for black_level in [0.3, 0.6, 1.0, 1.3]:
        for wall in ("lamp", "slope", "flat"):
            for noise in (0, 1e-3, 0.02):
                y = photograph(wall, noise) - black_level
                assert counts(y) == counts(np.maximum(y, 0)) == [0, 0, 0]


def counted(mean, read_noise=2.5, full_well=100_000):
    """What a sensor of 12 bits counts of the lamp's light, in electrons, black level subtracted."""
    light, rng = photograph(noise=0), np.random.default_rng(3)
    electrons = np.minimum(rng.poisson(mean * light / light.mean()), full_well)
    noisy = electrons + rng.normal(0, read_noise, light.shape)
    return np.minimum(np.rint(noisy * 4095 / full_well), 4095)


def test_a_sensors_photographs_have_no_defects():
    for electrons in [3, 1000]:
        assert counts(counted(electrons)) == [0, 0, 0]


def test_flat_small_and_black_and_white_images_have_no_defects():
    for values in [
        np.zeros((5, 6, 3)),
        np.ones((5, 6, 3)),
        np.full((4, 4), np.nan),
        np.ones((1, 1, 3)),
        np.arange(7.0)[None, :, None],
        np.indices((8, 8)).sum(axis=0) % 2 * 255,
        np.where(np.indices((30, 30)).sum(axis=0) > 30, 1.0, 0.0),
        np.random.default_rng(0).integers(0, 256, (90, 90, 3)).astype(np.uint8),
    ]:
        assert counts(values) == [0, 0, 0]


def test_gaussian_noise_is_called_hot_no_more_often_than_stated(monkeypatch):
    """At 3 standard deviations 365 of 270,000 are expected, give or take 19: five of them below."""
    noise = np.random.default_rng(1).normal(0, 1, (300, 300, 3))
    tail = erfc(3 / sqrt(2)) / 2
    assert counts(noise) == counts(100 + 0.1 * noise) == [0, 0, 0]
    monkeypatch.setattr(develop, "THRESHOLD", 3.0)
    single = [defective_pixels(channel).hot.sum() for channel in np.moveaxis(noise, 2, 0)]
    assert 0.4 * noise.size * tail < sum(single) < noise.size * tail + 5 * sqrt(noise.size * tail)


@pytest.mark.skipif(not SHARED.is_file(), reason="the real photograph is not at hand")
def test_real_photograph_is_sound_whatever_black_level_is_subtracted():
    y = np.load(SHARED)["photograph"]
    for part in (0, 1, 10, 30, 50, 63, 77, 90):
        assert counts(y - part * y.max() / 100) == counts(y - np.percentile(y, part)) == [0, 0, 0]
    for top in (63, 255, 4095, 65_535):
        assert counts(np.round(top / y.max() * y)) == [0, 0, 0]


PLACES = [(0, 0), (0, 40), (17, 109), (50, 3), (50, 60), (89, 109)]


def planted(value, wall="slope", noise=0.01, channel=1):
    y = photograph(wall, noise)
    for row, column in PLACES:
        y[row, column, channel] = value
    return y


def test_dead_pixels_of_one_channel_are_found():
    for channel, value in (0, 0.0), (2, -0.02):
        found = defective_pixels(planted(value, channel=channel))
        assert [tuple(place) for place in np.argwhere(found.dead)] == PLACES
        assert not found.saturated.any() and not found.hot.any()


def test_hot_pixels_are_found_and_where():
    for noise in [0, 1e-3, 0.01, 0.03]:
        y = photograph("slope", noise)
        for k, (row, column) in enumerate(PLACES):
            y[row, column, k % 3] *= 3 + 0.1 * k
        found = defective_pixels(y)
        assert [tuple(place) for place in np.argwhere(found.hot)] == PLACES
        assert not found.saturated.any() and not found.dead.any()


def test_a_dead_line_is_found_and_a_black_area_is_not():
    y = photograph("slope")
    y[:, 30] = 0
    y[40:50, 60:70] = 0
    found = defective_pixels(y)
    assert found.dead[:, 30].all() and found.dead.sum() == ROWS
    assert not found.hot.any()


def test_bright_lines_and_corners_are_no_hot_pixels():
    y = photograph()
    y[20:40, 20:40] *= 5
    y[60, 10:80] *= 5
    found = defective_pixels(y)
    assert found.hot.sum() <= 2  # the ends of the line alone


def covered(shape, centre, size, angle, oversampling=8):
    """Share of each pixel within a turned rectangle."""
    k = oversampling
    y, x = (np.mgrid[: k * shape[0], : k * shape[1]] + 0.5) / k
    x, y = x - centre[0], y - centre[1]
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    inside = (abs(u) < size[0] / 2) & (abs(v) < size[1] / 2)
    return inside.reshape(shape[0], k, shape[1], k).mean(axis=(1, 3))


@pytest.mark.parametrize(("width", "brightness"), [(0.7, 4), (1.2, 0.1), (9, 1.3), (9, 4)])
def test_edges_of_a_poster_and_its_stripes_are_no_hot_pixels(width, brightness):
    rng = np.random.default_rng(0)
    for angle in np.linspace(0, np.pi, 13):
        poster = covered((48, 56), rng.uniform(20, 30, 2), (width, 15), angle)
        image = (1 + (brightness - 1) * poster)[..., np.newaxis] * [1, 0.8, 0.6]
        image += rng.normal(0, 0.003, image.shape)
        assert not defective_pixels(image).any_kind.any(), angle


@pytest.mark.parametrize(("bits", "part"), [(8, 0.05), (16, 0.01), (None, 0.3)])
def test_clipped_light_is_saturated(bits, part):
    y = photograph(noise=0.01)
    full = np.quantile(y[..., 0], 1 - part)
    y = y / full if bits is None else np.round((2**bits - 1) / full * y)
    top = 1.0 if bits is None else 2**bits - 1
    found = defective_pixels(np.minimum(y, top))
    np.testing.assert_array_equal(found.saturated, (y >= top).any(axis=2))
    assert found.saturated.mean() > 0.5 * part


def test_unit_and_black_level_of_the_photograph_do_not_matter():
    for gain in [1e-6, 1e9]:
        y = np.minimum(planted(0.0), 0.7)
        y[30, 30] = [0.1, 3, 0.1]
        y[:, :, 1] = np.minimum(y[:, :, 1], 0.4)
        assert counts(gain * y) == counts(y)
        assert counts(y)[0] > 100 and counts(y)[1] == len(PLACES)


def test_a_saturated_socket_amid_a_dim_wall_is_found():
    y = np.round(180 * photograph(noise=0))
    y[3:7, 4:8] = 255
    found = defective_pixels(y)
    assert found.saturated[3:7, 4:8].all() and found.saturated.sum() == 16


def test_a_saturated_pixel_is_not_counted_as_hot_too():
    y = planted(9.0)
    assert counts(y) == [len(PLACES), 0, 0]
    y[PLACES[2]] = 9.001
    assert counts(y) == [0, 0, len(PLACES)]


def test_a_sensors_full_well_is_found():
    for read_noise in [0.5, 2.5, 20.0]:
        y = counted(7500, read_noise, full_well=10_000)
        found, most = defective_pixels(y), (y == y.max()).sum(axis=(0, 1)).max()
        assert most > 300 and found.saturated.sum() > 0.4 * most
        assert not found.dead.any() and not found.hot.any()


def test_what_is_masked_or_not_finite_is_left_aside():
    y, mask = planted(0.0), np.ones((ROWS, COLUMNS), bool)
    y[60:70, 60:80] = 1e6
    y[5, 5:9] = np.nan
    mask[60:70, 60:80] = False
    mask[tuple(np.transpose(PLACES))] = False
    assert counts(y, mask) == [0, 0, 0]
    mask[PLACES[3]] = True
    assert counts(y, mask) == [0, 1, 0]
    y[~mask] = np.inf
    assert counts(y, mask) == [0, 1, 0]


def test_two_hot_pixels_side_by_side_are_found():
    image = photograph("slope", 0.01)
    image[10, 10:12] = 3
    assert np.argwhere(defective_pixels(image).hot).tolist() == [[10, 10], [10, 11]]


def test_scattered_masks_make_no_pixel_hot():
    for used in [0.7, 0.5, 0.3]:
        for seed in range(10):
            mask = np.random.default_rng(seed).random((ROWS, COLUMNS)) < used
            assert counts(photograph("steps", 0.01, seed), mask) == [0, 0, 0]


def test_some_of_the_pixels_show_the_noise_of_all(monkeypatch):
    """In photographs of many megapixels the noise comes from every so many pixels."""
    hot, dead = photograph("slope", 0.03), planted(0.0)
    hot[tuple(np.transpose(PLACES))] *= 3
    whole = [counts(y) for y in (hot, dead)]
    monkeypatch.setattr(develop, "NOISE_PIXELS", 1000)
    assert [counts(y) for y in (hot, dead)] == whole == [[0, 0, 6], [0, 6, 0]]
