import inspect
from dataclasses import dataclass

import numpy as np
import pytest

from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS, MethodEntry, Option, _class
from periscopy_sim.reconstruction.video_method import FrameByFrame

RNG = np.random.default_rng(2)
A, B = RNG.uniform(0.1, 1, (48, 6)), RNG.uniform(0.1, 1, (48, 2))
HIDDEN = RNG.uniform(0.1, 1, (6, 3))
Y = (A @ HIDDEN).reshape(8, 6, 3) * RNG.normal(1, 1e-3, (8, 6, 3))
ALONE = [name for name, entry in METHODS.items() if not entry.needs]  # the core install has all
VIDEOS = [name for name, entry in METHODS.items() if entry.video]


@dataclass(frozen=True)
class Scene:
    photograph_shape: tuple = (8, 6)
    hidden: tuple = (2, 3)
    channel_gain: tuple = (1.2, 1.0, 0.8)


def defaults_of(place, options):
    parameters = inspect.signature(_class(place)).parameters
    return {o.name: parameters[o.parameter or o.name].default for o in options}


def test_names_are_keys_and_the_default_is_one():
    assert DEFAULT in METHODS and len(METHODS) > 5
    assert all(name == entry.name for name, entry in METHODS.items())


@pytest.mark.parametrize("name", METHODS)
def test_defaults_are_those_of_the_class_and_within_their_bounds(name):
    entry = METHODS[name]
    assert issubclass(_class(entry.of), StillMethod)
    assert {o.name: o.default for o in entry.options} == defaults_of(entry.of, entry.options)
    if entry.video:
        assert issubclass(_class(entry.video.of), FrameByFrame)
        options = entry.video.options
        assert {o.name: o.default for o in options} == defaults_of(entry.video.of, options)
        assert {o.coupling for o in options} <= {"", *entry.video.couplings}
    for option in entry.options:
        assert option.least <= option.default <= option.most and option.help


@pytest.mark.parametrize("name", ALONE)
def test_least_and_most_are_taken_and_what_lies_beyond_is_not_promised(name):
    for option in METHODS[name].options:
        for value in (option.least, option.default, option.most):
            METHODS[name](Scene(), A, B, **{option.name: value})
    with pytest.raises(KeyError):
        METHODS[name](Scene(), A, B, unknown=1.0)


@pytest.mark.parametrize("name", ALONE)
def test_option_reaches_its_parameter(name):
    entry = METHODS[name]
    for option in entry.options:
        method = entry(Scene(), A, B, **{option.name: 2 * option.default})
        if option.name != "rank_tolerance":  # not kept
            assert getattr(method, option.parameter or option.name) == 2 * option.default


@pytest.mark.parametrize("name", ALONE)
def test_report_has_the_certainty_that_the_entry_promises(name):
    method = METHODS[name](Scene(), A, B)
    solution = method.solve(Y)
    report = method.report(Y, solution)
    errors = report.standard_errors
    assert (errors is not None) == bool(METHODS[name].certainty)
    assert errors is None or errors.shape == (2, 3, 3)
    assert all(image.shape == (2, 3, 3) for _, image in report.stages)
    assert {"noise", "lambda"} <= report.numbers.keys()
    assert all(note.code.isidentifier() for note in (*report.notes, *report.warnings))
    np.testing.assert_array_equal(method.reconstruct(Y), solution.image)


@pytest.mark.parametrize("name", VIDEOS)
def test_every_coupling_recovers_frames(name):
    entry = METHODS[name]
    for coupling in entry.video.couplings:
        given = {o.name: 3.0 for o in entry.video.options if o.coupling == coupling}
        video = entry.frames_by(entry(Scene(), A, B), coupling, **given)
        assert video.coupling == coupling
        assert all(getattr(video, option) == 3.0 for option in given)
        found = video.solve_next(Y)
        assert found.image.shape == (2, 3, 3)
        assert {"noise", "lambda"} <= found.numbers().keys()


def test_method_for_stills_alone_makes_no_video():
    entry = METHODS["iterative"]
    with pytest.raises(ValueError, match="recovers no videos"):
        entry.frames_by(entry(Scene(), A, B), "none")


def test_a_new_method_is_one_entry():
    option = Option("fraction", 0.4, "Part of the singular values that are kept.", 0.01, 1)
    entry = MethodEntry("mine", "mine", "baselines.truncated_svd:TruncatedSVD", (option,))
    assert len(entry(Scene(), A, B, fraction=0.5)._singular[0]) == 3


@pytest.mark.parametrize("name", METHODS)
def test_a_scene_in_the_place_of_the_matrix_is_rejected(name):
    method = _class(METHODS[name].of)
    with pytest.raises(TypeError, match=rf"to fit to a scene, {method.__name__}\.for_scene"):
        method(Scene(), A, B)
