import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from periscopy_sim.reconstruction.preconditioned import repair

SHAPES = [(1, 1, 3), (1, 6, 3), (6, 1, 3), (2, 2, 3), (3, 3, 1), (7, 9, 3), (5, 6, 4)]


def random_image(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def loop_repair(image, threshold, previous=None):
    """Algorithm 2 in plain loops; of a video, Section 3.2."""
    rows, columns, channels = image.shape
    result = image.copy()
    for i in range(rows):
        for j in range(columns):
            neighbourhood = [
                (k, m)
                for k in (i - 1, i, i + 1)
                for m in (j - 1, j, j + 1)
                if 0 <= k < rows and 0 <= m < columns
            ]
            around = [
                sum(v * v for v in image[place]) ** 0.5
                for place in neighbourhood
                if place != (i, j)
            ]
            own = sum(v * v for v in image[i, j]) ** 0.5
            if around and abs(own - sum(around) / len(around)) > threshold:
                window = [image[place] for place in neighbourhood]
                if previous is not None:
                    window = [image[place] for place in neighbourhood if place != (i, j)]
                    window += [previous[place] for place in neighbourhood]
                for c in range(channels):
                    result[i, j, c] = np.median([patch[c] for patch in window])
    return result


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("threshold", [0.0, 0.8])
def test_repair_with_and_without_a_previous_frame_equals_plain_loops(shape, threshold):
    image = random_image(*shape)
    for previous in (None, random_image(*shape, seed=1)):
        expected = loop_repair(image, threshold, previous)
        np.testing.assert_array_equal(repair(image, threshold, previous), expected)


@settings(deadline=None, max_examples=100)
@given(
    image=arrays(
        np.float64,
        st.tuples(st.integers(1, 6), st.integers(1, 6), st.just(1)),
        elements=st.integers(-20, 20).map(float),
    ),
    threshold=st.integers(0, 20),
)
def test_repair_equals_plain_loops_where_thresholds_are_met_exactly(image, threshold):
    np.testing.assert_array_equal(repair(image, threshold), loop_repair(image, threshold))


@pytest.mark.parametrize(
    ("image", "threshold", "previous", "name"),
    [
        (np.ones((3, 3)), 1.0, None, "channels"),
        (np.full((3, 3, 3), np.nan), 1.0, None, "NaN"),
        (np.ones((3, 3, 3)), -1.0, None, "threshold"),
        (np.ones((3, 3, 3)), 1.0, np.ones((3, 4, 3)), "previous"),
        (np.ones((3, 3, 3)), 1.0, np.full((3, 3, 3), np.nan), "previous"),
    ],
)
def test_bad_arguments_are_rejected(image, threshold, previous, name):
    with pytest.raises(ValueError, match=name):
        repair(image, threshold, previous)
