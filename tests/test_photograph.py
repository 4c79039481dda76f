import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph, unwrapped

SHAPE = (4, 5)
LIGHT = np.random.default_rng(0).uniform(1, 2, (*SHAPE, 3))
MASK = np.arange(20).reshape(SHAPE) % 3 > 0


def test_arrays_become_one_form_and_are_copied():
    photograph = Photograph.of(LIGHT[..., 0].astype(np.float32), SHAPE)
    assert photograph.values.dtype == np.float64 and photograph.shape == SHAPE
    assert (photograph.values == LIGHT[..., :1].astype(np.float32)).all()
    photograph.values[:] = 0
    assert LIGHT.all() and np.shape(np.asarray(photograph)) == (*SHAPE, 3)


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
        ({"values": LIGHT, "monitor_off": {"off.npy": np.nan * LIGHT}}, r"off\.npy"),
    ],
)
def test_the_array_that_is_no_photograph_is_named(given, offender):
    with pytest.raises(PhotographError, match=offender):
        Photograph.of(**given)


def test_photographs_of_one_wall_share_masks_and_backgrounds():
    off, other = {"off": LIGHT}, {"off": 2 * LIGHT, "same": LIGHT}
    left = np.indices(SHAPE)[1] < 3
    given = [Photograph.of(LIGHT, mask=MASK, monitor_off=off), Photograph.of(LIGHT, mask=left)]
    values, mask, backgrounds = unwrapped(given, None, other)
    assert len(values) == 2 and (mask == MASK & left).all()
    assert backgrounds.keys() == {"off", "same"}
    others = [Photograph.of(LIGHT, monitor_off={"off": k * LIGHT}) for k in (2, 3)]
    names = {"off", "off of photograph 2", "off of photograph 3"}
    assert unwrapped([given[0], *others])[2].keys() == names
    with pytest.raises(PhotographError, match="size"):
        unwrapped(given, MASK.T)


def test_functions_of_arrays_take_what_an_array_holds():
    plain, masked = Photograph.of(LIGHT), Photograph.of(LIGHT, mask=MASK)
    np.testing.assert_array_equal(ps.add_noise(plain, 40, 1), ps.add_noise(LIGHT, 40, 1))
    np.testing.assert_array_equal(ps.composite(plain, plain, 1), ps.composite(LIGHT, LIGHT, 1))
    for use in (lambda y: ps.add_noise(y, 40, 1), lambda y: ps.composite(LIGHT, y, 1), np.mean):
        with pytest.raises(PhotographError, match="mask"):
            use(masked)
    assert not ps.defective_pixels(masked).any_kind[~MASK].any()
