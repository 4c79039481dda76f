import numpy as np
import pytest

from periscopy_sim.calibration.calibrated_scene import with_defaults
from periscopy_sim.calibration.parameters import SPREAD, start_values, steps_and_spreads
from periscopy_sim.calibration.resolution_level import Resolution, ResolutionLevel
from periscopy_sim.errors import SceneError
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


def anything_goes(scenario):
    assert scenario.photograph_shape


def level(names, path=CHAIR, photograph=None, mask=None):
    photograph = np.ones((126, 126, 3)) if photograph is None else photograph
    resolution = Resolution(18, 6, 4, 4)
    return ResolutionLevel(
        path, {}, names, photograph, mask, (29, 36), resolution, 0, anything_goes
    )


def test_parameters_start_at_their_defaults_or_as_given():
    free = ["occluder_dx", "vertical_exponent"]
    np.testing.assert_array_equal(start_values(CHAIR, free, {"occluder_dx": "-0.05"}), [-0.05, 18])


@pytest.mark.parametrize(
    ("free", "given", "message"),
    [
        ([], {}, "no parameter is free"),
        (["occluder_dx", "sofa_dx"], {}, r"'sofa_dx' is not declared .*occluder_dx \(0\)"),
        (["occluder_dx", "occluder_dx"], {}, "free twice"),
        (["occluder_dx"], {"occluder_dx": "left"}, "-D occluder_dx=left"),
        (["occluder_dx"], {"occluder_dx": "nan"}, "-D occluder_dx=nan"),
    ],
)
def test_what_cannot_be_free_is_refused(free, given, message):
    with pytest.raises(SceneError, match=message):
        start_values(CHAIR, free, given)


def test_a_text_is_no_parameter(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text('<scene version="3.0.0"><default name="mesh" value="chair.ply"/></scene>')
    with pytest.raises(SceneError, match=r"'mesh' is no number .* declares none"):
        start_values(path, ["mesh"], {})


@pytest.mark.usefixtures("jit")
def test_half_widths_change_the_light_transport_by_as_much_as_stated():
    names = ("occluder_dx", "vertical_exponent")
    start = np.array([0.0, 18.0])
    here = level(names)
    steps, spreads = steps_and_spreads(here, start)
    A = here.matrix(start)
    for k in range(2):
        for offset, low, high in ((spreads[k], 1, 3), (spreads[k] / 2, 0, 1)):
            moved = here.matrix(start + offset * np.eye(2)[k])
            change = np.linalg.norm(moved - A) / np.linalg.norm(A)
            assert low * SPREAD <= change < high * SPREAD
    assert (steps < spreads / 2).all()


@pytest.mark.usefixtures("jit")
def test_what_the_photograph_cannot_see_is_told(tmp_path):
    scene = tmp_path / "scene.xml"
    text = with_defaults(CHAIR, {}, tmp_path).replace(
        '<integrator type="path"/>',
        '<default name="gain" value="1"/><integrator type="path"/>'
        '<emitter type="constant"><float name="radiance" value="$gain"/></emitter>',
    )
    scene.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match="cannot see 'gain'"):
        steps_and_spreads(level(("gain",), path=scene), np.array([1.0]))


@pytest.mark.usefixtures("jit")
def test_a_whole_number_cannot_be_moved():
    with pytest.raises(SceneError, match="'resolution' cannot be moved from 126"):
        steps_and_spreads(level(("resolution",)), np.array([126.0]))


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


@pytest.mark.usefixtures("jit")
def test_a_turn_is_not_searched_beyond_where_it_comes_round_again():
    _, (spread,) = steps_and_spreads(level(("occluder_turn",)), np.array([0.0]))
    assert 5 < spread < 100
