from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.silhouette.conftest import FLAG, silhouette


@pytest.fixture
def trusted(plane):
    return replace(silhouette(plane, FLAG), agreeing=5, starts=12)


def test_a_mask_that_leaves_noise_and_that_starts_agree_on_is_trusted(trusted):
    assert not trusted.doubts


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ({"overdispersion": 4.0}, "4 times stronger than noise"),
        (
            {"between": 6.0, "unexplained": 0.05, "unexplained_partly": 0.046},
            "partly open leave 8 % less",
        ),
        ({"agreeing": 1}, "1 of the search's 12 starts"),
    ],
)
def test_what_speaks_against_a_mask_is_told(trusted, change, doubt):
    (told,) = replace(trusted, **change).doubts
    assert doubt in told


def test_another_answer_is_told_of(trusted):
    other = replace(trusted, opaque=np.flip(FLAG, axis=1))
    (told,) = replace(trusted, others=(other,)).doubts
    assert "another silhouette" in told
