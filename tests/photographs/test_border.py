"""Stripes planted at a photograph's border are found, and shadows that reach it are left alone."""

from dataclasses import astuple
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.photographs.border import BadBorder, bad_border

SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "chair_mushroom.npz"
SIDES = ("top", "bottom", "left", "right")
SIZE = 63
HIDDEN = (12, 15)
IMAGES = ("mushroom", "letters", "bars", "checker")
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
    values = {**moved, "resolution": SIZE}
    A = area_transport(ps.load_scenario(name, HIDDEN, values))
    shown = [ps.read_hidden_image(ps.find_image(image), HIDDEN) for image in IMAGES]
    y = np.array([(A @ f.reshape(-1, 3)).reshape(SIZE, SIZE, 3) for f in shown])
    return y / y.mean(axis=(1, 2, 3), keepdims=True)


def photographs(scene, seed=0):
    """Yield them under ambient light that fades across the wall and without it, with noise."""
    ambient = np.linspace(0.7, 1.3, SIZE)[:, None, None] * np.linspace(0.9, 1.1, SIZE)[:, None]
    rng = np.random.default_rng(seed)
    for y in light(scene):
        for base in (y, y / 3 + 2 * ambient / 3):
            for noise in (1e-3, 3.5e-3):
                yield base + noise * rng.standard_normal(base.shape)


def planted(y, side, profile):
    """Return a photograph whose first lines from a side are multiplied by a profile."""
    y = y.copy()
    lines = {"top": y, "bottom": y[::-1], "left": y.swapaxes(0, 1), "right": y[:, ::-1]}[side]
    if side == "right":
        lines = lines.swapaxes(0, 1)
    lines[: len(profile)] *= np.reshape(profile, (-1, 1, 1))
    return y


# -- what is sound -------------------------------------------------------------------------------


@pytest.mark.thorough
def test_shadows_that_reach_the_border_are_hardly_ever_stripes():
    """Scenes where edges lie along a side are half of these; the board's is as long as it."""
    found = {
        scene: [bad_border(y) for seed in range(2) for y in photographs(scene, seed)]
        for scene in SCENES
    }
    false = {scene: sum(map(bool, each)) for scene, each in found.items()}
    assert sum(map(len, found.values())) == 192
    assert sum(false.values()) <= 2, false


@pytest.mark.parametrize("noise", [0, 1e-5, 0.01, 0.1])
def test_plain_light_has_no_stripes(noise):
    """Neither where it is most curved at a corner, as that of a lamp beyond it."""
    across, down = np.meshgrid(np.linspace(-1, 1, 70), np.linspace(-1, 1, 50))
    for wall in (np.ones_like(down), 1 + 0.5 * down, np.exp(-across - 2 * down), down + across):
        for seed in range(5):
            rng = np.random.default_rng(seed)
            y = wall[..., None] + noise * rng.standard_normal((*wall.shape, 3))
            assert not bad_border(y)


def test_something_along_a_part_of_a_side_is_no_stripe():
    y = next(iter(photographs("chair")))
    y[0, : SIZE * 3 // 4] *= 0.9
    assert not bad_border(y)


def test_lines_as_strong_farther_inside_make_none_of_those_at_the_border():
    """A photograph with lines everywhere, as of a sensor's rows, is no better within."""
    y = planted(next(iter(photographs("chair"))), "top", [0.98])
    assert bad_border(y) == BadBorder(top=1)
    y[30] *= 0.98
    assert not bad_border(y)


@pytest.mark.parametrize("shape", [(31, 40), (40, 31), (1, 1), (5, 60)])
def test_small_photographs_are_not_looked_at(shape):
    y = np.ones((*shape, 3))
    y[0] = 0.5
    assert not bad_border(y)


def test_where_nothing_is_used_nothing_is_found():
    y = np.ones((SIZE, SIZE, 3))
    assert not bad_border(y, np.zeros((SIZE, SIZE), bool))
    assert not bad_border(np.full_like(y, np.nan))


def test_a_part_that_is_masked_all_along_tells_of_no_stripe_across_it():
    y = planted(next(iter(photographs("chair"))), "top", [0.9])
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, :9] = False
    assert bad_border(y, mask).top == 0
    mask = np.zeros((SIZE, SIZE), bool)
    mask[::5, ::20] = True
    assert not bad_border(y, mask)


# -- what is planted -----------------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_line_of_two_percent_is_found_alone(side, factor):
    for scene in ("chair", "plate"):
        for y in photographs(scene):
            assert bad_border(planted(y, side, [factor])) == BadBorder(**{side: 1})


@pytest.mark.parametrize("side", SIDES)
def test_a_ramp_over_two_lines_is_found(side):
    for y in photographs("plate"):
        assert bad_border(planted(y, side, [0.97, 0.985])) == BadBorder(**{side: 2})


def test_all_sides_at_once_are_found():
    y = next(iter(photographs("plate")))
    for side in SIDES:
        y = planted(y, side, [0.97])
    assert bad_border(y) == BadBorder(1, 1, 1, 1)


def test_what_one_colour_shows_is_found_and_its_unit_does_not_matter():
    y = next(iter(photographs("chair")))
    y[0, :, 2] *= 0.95
    for unit in (1e-6, 1.0, 1e6):
        assert bad_border(unit * y) == BadBorder(top=1)


def test_what_is_found_is_not_found_again():
    for scene in ("chair", "plate"):
        for y in photographs(scene):
            y = planted(planted(y, "top", [0.96, 0.98]), "left", [1.03])
            found = bad_border(y)
            inside = found.inside((SIZE, SIZE))
            assert found and not bad_border(y, inside)
            assert not bad_border(np.where(inside[..., None], y, np.nan))


def test_lines_that_are_not_used_count_with_those_behind_them():
    y = planted(next(iter(photographs("chair"))), "bottom", [0, 0.97])
    mask = BadBorder(bottom=1).inside((SIZE, SIZE))
    assert bad_border(y, mask) == BadBorder(bottom=2)


# -- how it is told ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("border", "words"),
    [
        (BadBorder(), "none"),
        (BadBorder(right=1), "1 column at the right"),
        (BadBorder(3, 1), "3 rows at the top and 1 row at the bottom"),
        (BadBorder(1, 0, 2), "1 row at the top and 2 columns at the left"),
        (BadBorder(1, 3, 2), "1 row at the top, 3 rows at the bottom and 2 columns at the left"),
    ],
)
def test_it_is_told_in_words(border, words):
    assert str(border) == words
    assert bool(border) == any(astuple(border))


def test_its_mask_leaves_out_these_lines():
    mask = BadBorder(2, 1, 0, 3).inside((10, 12))
    assert mask.sum() == 7 * 9 and mask[2:9, :9].all()


@pytest.mark.parametrize("values", [np.ones((40, 40)), np.ones((2, 40, 40, 3))])
def test_other_shapes_are_refused(values):
    with pytest.raises(ValueError, match=r"give \(rows, columns, channels\)"):
        bad_border(values)
    with pytest.raises(ValueError, match=r"mask has shape \(3, 40\): give \(40, 40\)"):
        bad_border(np.ones((40, 40, 3)), np.ones((3, 40), bool))


@pytest.mark.skipif(not SHARED.is_file(), reason="the real photograph is not at hand")
def test_the_real_photograph_is_bad_at_its_border():
    """Its first row is 1 to 3 % darker than the line through the next two, all along the wall."""
    found = bad_border(np.load(SHARED)["photograph"])
    assert found.top >= 2 and found.bottom >= 1 and found.left >= 1
    assert max(astuple(found)) <= 4
