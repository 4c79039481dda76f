"""Gross stripes at a photograph's border are found; shadows that reach it are none."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.photographs.border import BadBorder, bad_border

SHARED = Path(__file__).parents[2].parent / "shared" / "data"
SIDES = ("top", "bottom", "left", "right")
SIZE = 63
HIDDEN = (12, 15)
SCENES = {
    "chair": ("chair", {}),
    "seat along the top": ("chair", {"camera_dz": -0.215}),
    "back along the left": ("chair", {"camera_dx": 0.06}),
    "plate": ("plate", {}),
    "plate along the bottom": ("plate", {"camera_dz": 0.16}),
    # Straight across the picture, nearer to the wall than the plate: a sharp edge along a side.
    "board": ("plate", {"plate_width": 3, "occluder_dy": 0.2, "occluder_dz": 0.07}),
}


@cache
def light(scene):
    """Return closed-form photographs without noise, (images, rows, columns, 3), of mean 1."""
    name, moved = SCENES[scene]
    A = area_transport(ps.load_scenario(name, HIDDEN, {**moved, "resolution": SIZE}))
    shown = [ps.read_hidden_image(ps.find_image(image), HIDDEN) for image in ("mushroom", "bars")]
    y = np.array([(A @ f.reshape(-1, 3)).reshape(SIZE, SIZE, 3) for f in shown])
    return y / y.mean(axis=(1, 2, 3), keepdims=True)


def photographs(scene):
    """Yield them under ambient light that fades across the wall and without it, with noise."""
    ambient = np.linspace(0.7, 1.3, SIZE)[:, None, None] * np.linspace(0.9, 1.1, SIZE)[:, None]
    rng = np.random.default_rng(0)
    for y in light(scene):
        for base in (y, y / 3 + 2 * ambient / 3):
            yield base + 3.5e-3 * rng.standard_normal(base.shape)


def planted(y, side, profile):
    """Return a photograph whose first lines from a side are multiplied by a profile."""
    y = y.copy()
    lines = {"top": y, "bottom": y[::-1]}.get(
        side, y.swapaxes(0, 1)[:: -1 if side[0] == "r" else 1]
    )
    lines[: len(profile)] *= np.reshape(profile, (-1, 1, 1))
    return y


@pytest.mark.parametrize("scene", SCENES)
def test_shadows_that_reach_the_border_are_no_stripes(scene):
    assert not any(map(bad_border, photographs(scene)))


@pytest.mark.parametrize("name", ["chair_mushroom", "ustc_mushroom", "ustc_rgb"])
def test_real_photographs_have_no_stripes(name):
    if not SHARED.is_dir():
        pytest.skip("the real photographs are not at hand")
    assert not bad_border(np.load(SHARED / f"{name}.npz")["photograph"])


@pytest.mark.parametrize("noise", [0, 1e-5, 0.01, 0.1])
def test_plain_light_has_no_stripes(noise):
    """Neither where it is most curved at a corner, as that of a lamp beyond it."""
    across, down = np.meshgrid(np.linspace(-1, 1, 70), np.linspace(-1, 1, 50))
    for wall in (np.ones_like(down), 1 + 0.5 * down, np.exp(-across - 2 * down), down + across):
        y = wall[..., None] + noise * np.random.default_rng(1).standard_normal((*wall.shape, 3))
        assert not bad_border(y)


def test_no_stripe_is_one_along_a_part_or_slight_or_among_others_or_in_a_small_photograph():
    y = next(photographs("chair"))
    assert not bad_border(planted(y, "top", [0.95]))
    others = planted(y, "top", [0.7])
    others[30] *= 0.7
    assert not bad_border(others)
    y[0, : SIZE * 3 // 4] *= 0.5
    assert not bad_border(y)
    small = planted(np.ones((31, 40, 3)), "top", [0.5])
    assert not bad_border(small) and not bad_border(np.zeros((SIZE, SIZE, 3)))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("profile", [[0.8], [1.3], [0.7, 0.85]])
def test_a_gross_stripe_is_found_alone_in_any_unit(side, profile):
    for scene in ("chair", "plate"):
        for y in photographs(scene):
            y = planted(2 * y.mean() + y, side, profile)
            for unit in (1e-6, 1e6):
                assert bad_border(unit * y) == BadBorder(**{side: len(profile)})


def test_stripes_at_all_sides_are_found_and_masked():
    y = next(photographs("plate"))
    for side in SIDES:
        y = planted(y, side, [0.5])
    found = bad_border(y)
    assert found == BadBorder(1, 1, 1, 1)
    assert np.array_equal(found.inside((10, 12)), np.pad(np.ones((8, 10), bool), 1))
