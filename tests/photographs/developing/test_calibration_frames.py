import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.calibration_frames import (
    black_level_doubt,
    check_another_frame,
    dark_frame_doubt,
)
from periscopy_sim.photographs.developing.develop import develop
from periscopy_sim.photographs.developing.sensor_image import sensor_image

RNG = np.random.default_rng(5)
SIZE = (80, 96)
V, U = np.meshgrid(*(np.linspace(-1, 1, size) for size in SIZE), indexing="ij")
VIEW = (3000 + 800 * np.sin(3 * U + V) - 500 * V**2)[..., None] * [1.0, 0.9, 0.7]


def frame(values, noise=8.0, seed=0):
    draw = np.random.default_rng(seed).normal(0, noise, (*SIZE, 3))
    return sensor_image(np.round(values + draw), "frame")


BLACK = np.full((*SIZE, 3), 512.0)
PHOTO = frame(VIEW + 512, seed=1)


@pytest.mark.parametrize("given", ["dark", "flat"])
def test_photograph_is_no_frame_of_its_own(given):
    with pytest.raises(PhotographError, match=r"^the .*: is the photograph itself; give another"):
        develop([frame(VIEW, seed=2), PHOTO], **{given: PHOTO.values.copy()})
    check_another_frame(frame(VIEW + 512, seed=3), PHOTO, "another of the same view")


def test_black_level_above_the_light_is_told_with_its_share():
    light = develop([PHOTO], black=2512)
    below = np.mean((PHOTO.values < 2512).any(axis=2))
    assert 0.3 < below < 0.9
    assert black_level_doubt(light, None, "--black 2512") == (
        f"{100 * below:.0f} % of the pixels are below the black level; check --black 2512"
    )
    bright = (PHOTO.values >= 2512).all(axis=2)
    assert black_level_doubt(light, bright, "--black 2512") == ""
    assert black_level_doubt(develop([PHOTO], black=512), None, "--black 512") == ""


def test_black_level_above_all_light_is_refused():
    dark = develop([PHOTO], black=float(PHOTO.values.max()) + 1)
    with pytest.raises(PhotographError, match="all pixels are below the black level"):
        black_level_doubt(dark, None, "--black 99999")


def test_dark_frame_of_a_lens_that_was_not_covered_is_told():
    for share in (1.0, 0.3, 0.05):
        assert "lens covered" in dark_frame_doubt(frame(BLACK + share * VIEW, seed=4), PHOTO)


def test_dark_frame_of_another_view_is_told():
    other = 0.4 * VIEW[::-1, ::-1]
    assert dark_frame_doubt(frame(BLACK + other), PHOTO).startswith("is not dark all over")


def test_honest_dark_frames_are_not_doubted():
    glow = 40 * np.exp(-3 * ((U - 1) ** 2 + (V - 1) ** 2))[..., None]
    rows = 10 * np.random.default_rng(1).standard_normal((SIZE[0], 1, 1))
    hot = np.where(np.random.default_rng(2).random((*SIZE, 1)) < 0.01, 3000, 0)
    for seed in range(20):
        for own in (0, glow, rows, hot):
            assert dark_frame_doubt(frame(BLACK + own, seed=seed), PHOTO) == ""
    small = sensor_image(np.ones((8, 8, 3)), "small")
    assert dark_frame_doubt(small, PHOTO) == ""
