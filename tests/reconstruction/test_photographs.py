"""Every method uses all of a `Photograph`: the mask, the monitor-off photographs, NaN under it."""

import pickle

import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import ColourMatrix, Photograph
from periscopy_sim.reconstruction.registry import METHODS

PHOTOGRAPH, HIDDEN = (12, 10), (2, 3)
RNG = np.random.default_rng(4)
A = RNG.uniform(0.1, 1, (120, 6)).astype(np.float32)
B = np.hstack([np.ones((120, 1)), RNG.uniform(0.1, 1, (120, 2))])
MASK, OTHER = RNG.random((2, *PHOTOGRAPH)) > 0.2
LAMP = RNG.uniform(0.5, 1, (*PHOTOGRAPH, 3))
Y = (A @ RNG.uniform(0.1, 1, (6, 3))).reshape(*PHOTOGRAPH, 3) + 0.7 * LAMP
Y *= RNG.normal(1, 1e-3, Y.shape)
Y[~MASK], LAMP[~MASK] = np.nan, np.nan
ALONE = [name for name, entry in METHODS.items() if not entry.needs]
VIDEOS = [name for name, entry in METHODS.items() if entry.video]
OFF = {"off": LAMP}


class Scene:
    photograph_shape, hidden, channel_gain = PHOTOGRAPH, HIDDEN, (1.2, 1.0, 0.8)


@pytest.mark.parametrize("off", [None, OFF])
@pytest.mark.parametrize("name", ALONE)
def test_a_photograph_is_used_as_by_a_method_fitted_to_it(name, off):
    photograph = Photograph.of(Y, mask=MASK, monitor_off=off)
    method, expected = METHODS[name](Scene(), A, B), METHODS[name](Scene(), A, B)
    expected = expected.fitted_to(photograph)
    np.testing.assert_array_equal(method.reconstruct(photograph), expected.reconstruct(Y))
    solution, image = method.solve(photograph), expected.solve(Y)
    reports = method.report(photograph, solution), expected.report(Y, image)
    residuals = method.residual(photograph, solution), expected.residual(Y, image)
    assert np.isnan(residuals[0].light[~MASK]).all()
    for ours, theirs in ((each.residual for each in reports), residuals):
        np.testing.assert_array_equal(ours.light, theirs.light)
    assert method.fitted_to(photograph) is method.fitted_to(photograph)
    assert expected.fitted_to(photograph) is expected


@pytest.mark.parametrize("name", ALONE)
def test_a_method_is_the_same_after_photographs_of_other_conditions_and_in_a_copy(name):
    method, filled = METHODS[name](Scene(), A, B), np.nan_to_num(Y, nan=1.0)
    colours = ColourMatrix(np.eye(3) + 0.2)
    given = [
        Photograph.of(filled),
        Photograph.of(filled, mask=MASK),
        Photograph.of(filled, mask=OTHER, monitor_off={"a": np.nan_to_num(LAMP, nan=1.0)}),
        Photograph.of(filled, colour_matrix=colours),
    ]
    expected = [METHODS[name](Scene(), A, B).reconstruct(each) for each in given]
    copy = pickle.loads(pickle.dumps(method.fitted_to(given[1])))
    for each, image in [*zip(given, expected, strict=True)][::-1]:
        np.testing.assert_array_equal(method.reconstruct(each), image)
    for each, image in [*zip(given, expected, strict=True)][1:]:
        np.testing.assert_array_equal(copy.reconstruct(each), image)
    assert len({image.tobytes() for image in expected}) == 4


@pytest.mark.parametrize("name", VIDEOS)
def test_frames_are_recovered_by_the_method_of_their_mask(name):
    entry = METHODS[name]
    frames = [Photograph.of(k * Y, mask=MASK, monitor_off=OFF) for k in (1, 0.9, 1.1)]
    still = entry(Scene(), A, B)
    video, expected = (entry.frames_by(each, "l1") for each in (still, still.fitted_to(frames[0])))
    wanted = expected.frames(np.stack([frame.values for frame in frames]))
    np.testing.assert_array_equal(video.frames(frames), wanted)
    video.restart()
    np.testing.assert_array_equal([video.next_frame(frame) for frame in frames], wanted)
    changed = [frames[0], Photograph.of(np.nan_to_num(Y, nan=1.0), mask=OTHER)]
    assert np.isfinite(video.frames(changed)).all()


def test_what_cannot_use_a_mask_says_so():
    photograph = Photograph.of(Y, mask=MASK)
    with pytest.raises(PhotographError, match="mask"):
        np.asarray(photograph)
    with pytest.raises(PhotographError, match="mask"):
        np.stack([photograph, photograph])
    with pytest.raises(PhotographError, match="bool"):
        Photograph.of(np.ones((2, 2)), mask=np.ones((2, 2), int))
