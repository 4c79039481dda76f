from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.calibration.prior import MEANS, VARIANCES, row_priors
from tests.scenes.calibration import calibration

XYZ = np.array([[0.4125, 0.3576, 0.1804], [0.2127, 0.7152, 0.0722], [0.0193, 0.1192, 0.9502]])
"""Of the primaries of sRGB."""


@pytest.mark.parametrize(
    "published",  # in dcraw's table: ten thousandths, from XYZ to the camera's channels
    [
        [[6722, -635, -963], [-4287, 12460, 2028], [-908, 2162, 5668]],  # Canon EOS 5D Mark III
        [[8139, -2171, -663], [-8747, 16541, 2295], [-1925, 2008, 8093]],  # Nikon D3
        [[5271, -712, -347], [-6153, 13653, 2763], [-1601, 2366, 7242]],  # Sony ILCE-7M2
        np.linalg.inv(XYZ),  # a photograph whose colours are the monitor's
    ],
)
def test_cameras_are_within_two_and_a_half_deviations_of_the_prior(published: list) -> None:
    mixture = np.array(published) @ XYZ
    mixture /= mixture.sum(axis=1, keepdims=True)
    for row, mean, variance in zip(mixture, MEANS, VARIANCES, strict=True):
        assert (row - mean) @ np.linalg.pinv(variance, 1e-6) @ (row - mean) < 2.5**2


def test_colours_are_assumed_where_errors_are_the_priors() -> None:
    widths = np.sqrt(np.diagonal(VARIANCES, axis1=1, axis2=2))
    gains = np.array([[0.4], [2.0], [0.6]])
    for errors, assumed in ((widths, True), (0.5 * widths, False)):
        found = replace(
            calibration(), colour_matrix=gains * np.eye(3), colour_errors=gains * errors
        )
        assert found.assumes_colours == assumed
    one = replace(calibration(), colour_matrix=np.ones((3, 1)), colour_errors=np.ones((3, 1)))
    assert not one.assumes_colours
    assert not calibration().assumes_colours


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_other_channels_have_no_prior(channels: int) -> None:
    assert list(row_priors(channels, 3)) == [None] * channels
