import numpy as np
import pytest
from periscopy_sim.calibration.explanation.resolution_level import Rays, Resolution, ResolutionLevel
from periscopy_sim.calibration.parameters import BOX, SPREAD, STEP, scales_and_spreads

from periscopy_sim.calibration import parameters
from periscopy_sim.calibration.calibrated_scene import with_defaults
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


def anything_goes(scenario):
    assert scenario.photograph_shape


def level(names, path=CHAIR, photograph=None, mask=None):
    photograph = np.ones((126, 126, 3)) if photograph is None else photograph
    resolution = Resolution(18, 6, 1, Rays(4, 4), Rays(4, 4))
    return ResolutionLevel(
        path, {}, names, Prior.none(len(names)), photograph, [], mask, (29, 36), resolution, 0,
        anything_goes,
    )  # fmt: skip


class Lamp:
    """A level whose one light grows by `change` of how far its parameter is moved."""

    names = ("dimmer",)
    path = "lamp.xml"

    def __init__(self, change, below=np.inf, above=np.inf, ruler=np.inf):
        self.change, self.below, self.above = change, below, above
        self.prior = Prior(np.array([2.0, 2.0]), np.array([ruler, ruler]))

    def matrix(self, values):
        moved = values[0] - 2.0
        if not -self.below <= moved <= self.above:
            raise SceneError("not physical")
        return np.full((4, 3), 7 * (1 + self.change(abs(moved))))


def linear(moved):
    return moved


@pytest.mark.parametrize("above", [np.inf, 0.0])
def test_scales_and_spreads_are_the_first_doublings_that_change_enough(above):
    (step,), (spread,) = scales_and_spreads(Lamp(linear, above=above), np.array([2.0]))
    assert STEP <= step < 2 * STEP and SPREAD <= spread < 2 * SPREAD
    assert np.log2(step / 1e-6) % 1 == pytest.approx(0, abs=1e-9)
    assert spread / step == 8


def test_each_parameter_is_moved_alone():
    class TwoLamps(Lamp):
        names = ("one", "other")

        def matrix(self, values):
            return super().matrix(2 + np.abs(values - 2) @ [[1], [0.25]])

    steps, spreads = scales_and_spreads(TwoLamps(linear), np.array([2.0, 2.0]))
    assert steps[1] == 4 * steps[0] and spreads[1] == 4 * spreads[0]


@pytest.mark.parametrize(
    ("lamp", "low", "high"),
    [
        (Lamp(linear, 0.3, 0.3), 0.15, 0.3),  # to the border
        (Lamp(lambda moved: 0.2 * np.tanh(10 * moved)), 0.1, 0.4),  # it grows no more
        (Lamp(lambda moved: 0.3 * abs(np.sin(moved))), 0.8, 2.2),  # it comes round again
    ],
)
def test_spreads_end_where_a_change_does(lamp, low, high):
    (step,), (spread,) = scales_and_spreads(lamp, np.array([2.0]))
    assert STEP <= lamp.change(step) < 2 * STEP
    assert low < spread <= high


@pytest.mark.parametrize(
    ("lamp", "message"),
    [
        (Lamp(linear, 0, 0), "'dimmer' cannot be moved from 2"),
        (Lamp(lambda moved: 0 * moved), "cannot see 'dimmer', however it is moved from 2;"),
        (Lamp(linear, 0.03, 0.03), r"cannot see 'dimmer': moved by up to 0\.01\d+, .* by 1\.\d %"),
    ],
)
def test_why_a_parameter_cannot_be_found_is_told(lamp, message):
    with pytest.raises(SceneError, match=message):
        scales_and_spreads(lamp, np.array([2.0]))


@pytest.mark.parametrize("ruler", [0.01, 0.03])
def test_nothing_is_searched_where_no_ruler_errs_so_far(ruler):
    (scale,), (spread,) = scales_and_spreads(Lamp(linear, ruler=ruler), np.array([2.0]))
    assert spread == BOX * ruler
    assert STEP <= scale < 2 * STEP  # within the box, or beyond it as follows from its border


def test_what_the_photograph_cannot_see_is_left_to_the_ruler():
    unseen, border = Lamp(lambda moved: 0 * moved, ruler=0.1), Lamp(linear, 0, 0, ruler=0.1)
    for lamp in (unseen, border):
        (scale,), (spread,) = scales_and_spreads(lamp, np.array([2.0]))
        assert (scale, spread) == (np.inf, pytest.approx(0.3))


@pytest.mark.usefixtures("jit")
def test_ambient_light_is_not_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(parameters, "DOUBLINGS", 3)
    scene = tmp_path / "scene.xml"
    text = with_defaults(CHAIR, {}, tmp_path).replace(
        '<integrator type="path"/>',
        '<default name="gain" value="1"/><integrator type="path"/>'
        '<emitter type="constant"><float name="radiance" value="$gain"/></emitter>',
    )
    scene.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match="cannot see 'gain'"):
        scales_and_spreads(level(("gain",), path=scene), np.array([1.0]))


@pytest.mark.usefixtures("jit")
def test_a_whole_number_cannot_be_moved():
    with pytest.raises(SceneError, match="'resolution' cannot be moved from 126"):
        scales_and_spreads(level(("resolution",)), np.array([126.0]))


@pytest.mark.usefixtures("jit")
def test_a_masked_pixel_and_what_it_holds_have_no_part():
    photograph = np.random.default_rng(0).random((126, 126, 3))
    mask = np.ones((126, 126), bool)
    mask[40:60, 50:90] = False
    spoiled = np.where(mask[..., None], photograph, np.nan)
    evidences = [
        level(("occluder_dx",), photograph=y, mask=mask).evidence(np.array([0.0]))
        for y in (photograph, spoiled)
    ]
    assert evidences[0] == evidences[1]
    assert np.isfinite(evidences[0])


@pytest.mark.usefixtures("jit")
def test_scattered_bad_pixels_cost_no_coarse_ones():
    photograph = np.random.default_rng(0).random((126, 126, 3))
    mask = np.ones((126, 126), bool)
    mask[::6, ::6] = False
    assert level(("occluder_dx",), photograph=photograph, mask=mask).used.all()


@pytest.mark.usefixtures("jit")
def test_a_black_channel_is_no_trouble():
    photograph = np.random.default_rng(0).random((126, 126, 3))
    photograph[..., 2] = 0
    here = level(("occluder_dx",), photograph=photograph)
    found = here.explain(np.array([0.0]))
    assert np.isfinite(here.picture(found.residuals)).all()
    assert np.isfinite(found.noise / here.scale).all()
