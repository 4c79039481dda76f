from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import ColourMatrix, Photograph, of_one_wall, seen_in

SHAPE = (4, 5)
LIGHT = np.random.default_rng(0).uniform(1, 2, (*SHAPE, 3))
MASK = np.arange(20).reshape(SHAPE) % 3 > 0


def test_arrays_become_one_form_and_are_copied():
    photograph = Photograph.of(LIGHT[..., 0].astype(np.float32), SHAPE)
    assert photograph.values.dtype == np.float64 and photograph.shape == SHAPE
    assert (photograph.values == LIGHT[..., :1].astype(np.float32)).all()
    photograph.values[:] = 0
    assert LIGHT.all() and np.shape(np.asarray(photograph)) == (*SHAPE, 1)
    assert [Photograph.of(LIGHT[..., :c]).channels for c in (1, 2, 3)] == [1, 2, 3]


def test_labelled_dimensions_are_taken_by_name():
    labelled = xr.DataArray(LIGHT, dims=("row", "column", "channel"))
    turned = labelled.transpose("channel", "column", "row")
    np.testing.assert_array_equal(Photograph.of(turned).values, LIGHT)


def test_pixels_outside_the_mask_are_neither_checked_nor_used():
    spoilt = np.where(MASK[..., None], LIGHT, np.nan)
    photograph = Photograph.of(spoilt, mask=MASK, monitor_off={"off.npy": spoilt / 2})
    np.testing.assert_array_equal(photograph.used, LIGHT[MASK])
    np.testing.assert_array_equal(photograph.monitor_off["off.npy"], spoilt / 2)
    assert (photograph.mask == MASK).all() and "nan" not in repr(photograph)
    np.testing.assert_array_equal(Photograph.of(LIGHT).used, LIGHT.reshape(-1, 3))


@pytest.mark.parametrize(
    ("given", "offender"),
    [
        ({"values": LIGHT[:3], "shape": SHAPE}, "photograph"),
        ({"values": -LIGHT, "name": "y.exr"}, "y.exr"),
        ({"values": LIGHT, "mask": MASK.T}, "mask"),
        ({"values": np.ma.masked_less(LIGHT, 1.1), "name": "y"}, "^y: .*masked"),
        ({"values": xr.DataArray(LIGHT, dims=("y", "x", "channel"))}, r"\('y', 'x', 'channel'\)"),
        ({"values": LIGHT, "monitor_off": {"off.npy": LIGHT[:3]}}, r"off\.npy"),
        ({"values": LIGHT, "monitor_off": {"off.npy": LIGHT[..., 0]}}, r"off\.npy: .* one camera"),
        ({"values": LIGHT, "colour_matrix": ColourMatrix(np.eye(2))}, "2 rows"),
        ({"values": LIGHT, "monitor_off": {"off.npy": np.nan * LIGHT}}, r"off\.npy"),
    ],
)
def test_the_array_that_is_no_photograph_is_named(given, offender):
    with pytest.raises(PhotographError, match=offender):
        Photograph.of(**given)


@pytest.mark.parametrize(
    "given", [{"monitor_off": {"o": LIGHT[..., :1]}}, {"colour_matrix": ColourMatrix(np.eye(2))}]
)
def test_what_joins_a_photograph_later_is_checked_too(given):
    with pytest.raises(PhotographError, match="camera"):
        replace(Photograph.of(LIGHT), **given)


def test_photographs_of_one_wall_share_masks_and_backgrounds():
    off, other = {"off": LIGHT}, {"off": 2 * LIGHT, "same": LIGHT}
    left = np.indices(SHAPE)[1] < 3
    given = [Photograph.of(LIGHT, mask=MASK, monitor_off=off), Photograph.of(LIGHT, mask=left)]
    first, second = of_one_wall(given)
    assert (first.mask == MASK & left).all() and (second.mask == first.mask).all()
    assert first.monitor_off.keys() == second.monitor_off.keys() == {"off"}
    both = of_one_wall([*given, Photograph.of(LIGHT, monitor_off=other), LIGHT])
    assert [each.monitor_off.keys() for each in both] == 4 * [{"off", "off of photograph 3"}]
    others = [Photograph.of(LIGHT, monitor_off={"off": k * LIGHT}) for k in (2, 3)]
    names = {"off", "off of photograph 2", "off of photograph 3"}
    assert of_one_wall([given[0], *others])[1].monitor_off.keys() == names
    with pytest.raises(PhotographError, match="size"):
        of_one_wall([given[0], Photograph.of(LIGHT.swapaxes(0, 1), mask=MASK.T)])
    colours = [ColourMatrix(np.eye(3) + k) for k in (0, 1)]
    some, same, another = (Photograph.of(LIGHT, colour_matrix=colours[k]) for k in (0, 0, 1))
    assert of_one_wall([LIGHT, some, same])[0].colour_matrix is colours[0]
    with pytest.raises(PhotographError, match="different colour matrices"):
        of_one_wall([some, another])


def test_conditions_change_with_the_mask_the_lamps_and_the_colours():
    given = [
        {"mask": MASK}, {"mask": ~MASK}, {"monitor_off": [LIGHT]}, {"monitor_off": [2 * LIGHT]},
        {"colour_matrix": ColourMatrix(np.eye(3))}, {"colour_matrix": ColourMatrix(2 * np.eye(3))},
    ]  # fmt: skip
    digests = [Photograph.of(LIGHT, **each).conditions for each in given]
    assert len({*digests}) == 6 and None not in digests
    assert [Photograph.of(3 * LIGHT, **each).conditions for each in given] == digests
    assert Photograph.of(LIGHT).conditions is None


def test_light_is_unmixed_and_seen_in_grey():
    colours = ColourMatrix(np.array([[0.7, 0.2, 0], [0.2, 1, 0.3], [0, 0.3, 1], [0.4, 0.4, 0.4]]))
    four = Photograph.of(colours.mix(LIGHT), monitor_off=[colours.mix(2 * LIGHT)])
    known = replace(four, colour_matrix=colours)
    np.testing.assert_allclose(known.unmixed().values, LIGHT)
    (off,) = known.unmixed().monitor_off.values()
    np.testing.assert_allclose(off, 2 * LIGHT)
    assert known.unmixed().conditions != known.conditions and four.unmixed() is four
    np.testing.assert_allclose(seen_in(LIGHT, 1)[..., 0], LIGHT.mean(axis=2))
    assert seen_in(LIGHT, 3) is LIGHT
    with pytest.raises(PhotographError, match="4"):
        seen_in(LIGHT, 4)


def test_functions_of_arrays_take_what_an_array_holds():
    plain, masked = Photograph.of(LIGHT), Photograph.of(LIGHT, mask=MASK)
    np.testing.assert_array_equal(ps.add_noise(plain, 40, 1), ps.add_noise(LIGHT, 40, 1))
    np.testing.assert_array_equal(ps.composite(plain, plain, 1), ps.composite(LIGHT, LIGHT, 1))
    for use in (lambda y: ps.add_noise(y, 40, 1), lambda y: ps.composite(LIGHT, y, 1), np.mean):
        with pytest.raises(PhotographError, match="mask"):
            use(masked)
    assert not ps.defective_pixels(masked).any_kind[~MASK].any()
