from pathlib import Path
from typing import Any

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import with_defaults, write_copy
from periscopy_sim.calibration.prior import free_parameters
from periscopy_sim.calibration.result import ParameterSource
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.rendering.variant import mi
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.shipped import find_scene
from tests.scenes.calibration import ERRORS, HIDDEN, SIDE, SIZE, TRUTH, Array, Small

WHITE = np.ones((*HIDDEN, 3))
TEXTURE = """<texture type="bitmap" name="radiance">
    <string name="filename" value="{}"/>
    <boolean name="raw" value="true"/>
    <string name="filter_type" value="nearest"/>
</texture>"""
MIXTURE = np.array([[0.8, 0.3, 0.0], [0.1, 0.9, 0.1], [0.0, 0.2, 0.6]])


def calibrated(photograph: Any, **options: Any) -> ps.Calibration:
    options = {"free": ERRORS, "parameters": SIZE, **options}
    return ps.calibrate(photograph, "chair", HIDDEN, **options)


def distances(found: ps.Calibration) -> Array:
    """Return how many standard errors the values are from the truth."""
    return np.array([(p.value - TRUTH[p.name]) / p.standard_error for p in found.parameters])


def path_traced(folder: Path, picture: Array) -> Array:
    """Return a photograph by Mitsuba alone, of a monitor that shows a picture."""
    ps.use_variant()
    image = folder / "image.exr"
    mi.Bitmap(np.flipud(picture).astype(np.float32).copy()).write(str(image))
    text = with_defaults(read_document(find_scene("chair")), {}, folder).toxml()
    plain = '<rgb name="radiance" value="1"/>'
    assert plain in text
    (folder / "lit.xml").write_text(text.replace(plain, TEXTURE.format(image)))
    values = {**SIZE, **{name: f"{value:.9g}" for name, value in TRUTH.items()}}
    scene = mi.load_file(str(folder / "lit.xml"), **values)
    draws = [np.array(mi.render(scene, spp=2048, seed=seed)) for seed in range(2)]
    return np.asarray(np.mean(draws, axis=0)[..., :3], np.float64)


@pytest.mark.usefixtures("quick")
def test_a_known_picture_tells_scene_and_colours_of_plain_mitsubas_photograph(
    small: Small, tmp_path: Path
) -> None:
    """Path traced, through a camera that mixes colours, with uneven ambient light."""
    light = path_traced(tmp_path, small.pictures[0]) @ MIXTURE.T
    slope = np.linspace(0.8, 1.2, SIDE)[:, None, None]
    y = ps.add_noise(ps.composite(light, slope * np.ones_like(light), 1.0), 55, 0)
    fractions: list[float] = []
    found = calibrated(y, shown=[small.pictures[0]], progress=fractions.append)
    assert found.trusted and found.moved
    assert np.abs(distances(found)).max() < 4, found
    assert found.colour_matrix is not None
    mixture = MIXTURE / MIXTURE.sum(axis=1).mean()
    assert found.colour_errors is not None and found.colour_errors.max() < 0.1
    assert np.all(np.abs(found.colour_matrix - mixture) < 3 * found.colour_errors)
    assert len(found.path[0]) > 0  # draws from the prior
    assert fractions == sorted(fractions) and fractions[-1] == 1
    before, after = found.unexplained
    assert after < 0.6 * before and found.residual.shape == (SIDE, SIDE, 3)


@pytest.mark.thorough
@pytest.mark.usefixtures("quick")
def test_an_unknown_picture_tells_the_scene_and_two_tell_no_less(small: Small) -> None:
    """The monitor turns by what no picture but a known one tells."""
    photographs = [small.photograph(k) for k in range(2)]
    errors = []
    for shown in photographs[:1], photographs:
        found = calibrated(shown)
        assert np.abs(distances(found)).max() < 4, found
        errors.append([p.statistical_error / p.ruler_error for p in found.parameters[:2]])
    assert np.max(errors) < 0.8
    assert np.all(errors[1] < 1.1 * np.array(errors[0]))


@pytest.mark.usefixtures("quick")
def test_measured_values_that_are_kept_have_the_rulers_errors(small: Small) -> None:
    values = {**SIZE, **{name: f"{value}" for name, value in TRUTH.items()}}
    free = {"occluder_dx": ERRORS["occluder_dx"]}
    found = calibrated(small.photograph(0), parameters=values, free=free)
    assert not found.moved and found.trusted and found.overdispersion == 1
    assert found.values == pytest.approx({name: TRUTH[name] for name in free})
    for p in found.parameters:
        assert p.source is ParameterSource.RULER and not p.record()["determined"]
        assert p.statistical_error == p.standard_error == ERRORS[p.name]
    covariance = found.scene_covariance.covariance
    assert covariance[0, 0] == pytest.approx(ERRORS["occluder_dx"] ** 2)
    assert not covariance[0, 1:].any()


@pytest.mark.thorough
@pytest.mark.usefixtures("quick")
def test_an_unknown_picture_leaves_the_monitors_place_to_the_ruler(small: Small) -> None:
    y, free = small.photograph(0), {"occluder_dz": 0.005, "monitor_dx": 0.005}
    known, unknown = (calibrated(y, free=free, shown=s) for s in (small.pictures[:1], []))
    errors = [found.parameters[1].statistical_error for found in (known, unknown)]
    assert errors[0] < 0.001 and errors[1] == 0.005


@pytest.mark.thorough
@pytest.mark.usefixtures("quick")
def test_units_masked_pixels_and_projected_light_change_nothing(small: Small) -> None:
    """The same seed gives the same result; masked pixels may hold anything."""
    y, shown = small.photograph(0), small.pictures[:1]
    mask = np.ones((SIDE, SIDE), bool)
    mask[8:12, 4:20] = False
    paint = np.random.default_rng(0).random((SIDE, SIDE, 1)) * np.ones(3)
    spoiled = np.where(mask[..., None], 1e3 * (y + 0.3 * paint), np.nan)
    whole, other = (
        ps.Photograph.of(each, mask=mask, monitor_off={"paint": paint}) for each in (y, spoiled)
    )
    plain, scaled = (calibrated(each, shown=shown) for each in (whole, other))
    for one, other in zip(plain.parameters, scaled.parameters, strict=True):
        assert other.value == pytest.approx(one.value, abs=0.05 * one.standard_error)
    assert scaled.unexplained[1] == pytest.approx(plain.unexplained[1], rel=0.3)


@pytest.mark.thorough
@pytest.mark.usefixtures("quick")
def test_uncertain_parameters_move_values_as_when_all_is_found_again(small: Small) -> None:
    """They change no value, only its error."""
    y, error = small.photograph(0), 0.004
    options: dict[str, Any] = {"shown": small.pictures[:1], "free": {"occluder_dz": 0.05}}
    alone = calibrated(y, **options)
    held = calibrated(y, **options, uncertain={"monitor_dz": error})
    (one,), (other,) = alone.parameters, held.parameters
    assert other.value == one.value
    assert {*alone.uncertain.names, "occluder_dz"} == set(free_parameters(small.scenario.document))
    assert one.standard_error > other.standard_error
    assert other.statistical_error == pytest.approx(one.statistical_error)
    (move,) = held.moves[0]
    assert other.standard_error == pytest.approx(np.hypot(one.statistical_error, move))
    ends = [
        calibrated(y, **options, parameters={**SIZE, "monitor_dz": str(side)})
        for side in (error, -error)
    ]
    change = (ends[0].parameters[0].value - ends[1].parameters[0].value) / 2
    assert abs(change) > one.statistical_error
    assert move == pytest.approx(change, rel=0.3)


@pytest.mark.usefixtures("quick")
def test_a_second_calibration_starts_from_the_measured_values(small: Small, tmp_path: Path) -> None:
    y, shown = small.photograph(0), small.pictures[:1]
    text = "trusted; occluder_dx = 0.002 from 0.001 +- 0.0005: 1"
    scene, free = tmp_path / "found.xml", {"occluder_dx": 0.005}
    values = {"occluder_dx": "0.002", CALIBRATED: text}
    write_copy(read_document(find_scene("chair")), values, scene)
    found = ps.calibrate(y, scene, HIDDEN, free, shown=shown, parameters=SIZE)
    assert [p.start for p in found.parameters] == [0.001]


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"free": {"occluder_dx": np.inf}}, "occluder_dx"),
        ({"free": ["occluder_dx"], "uncertain": {"occluder_dx": 0.1}}, "occluder_dx"),
        ({"parameters": SIZE | {"occluder_dx": "3"}}, "chair"),  # no shadow in view
        ({"parameters": SIZE | {"occluder_dy": "3"}}, "chair"),  # behind the wall
    ],
)
def test_scenes_that_cannot_be_calibrated_are_rejected(
    small: Small, options: dict[str, Any], name: str
) -> None:
    with pytest.raises(SceneError, match=name):
        calibrated(small.photograph(0), **options)


@pytest.mark.usefixtures("jit", "quick")
def test_photographs_that_show_nothing_are_rejected() -> None:
    white = np.ones((SIDE, SIDE, 3))
    for photograph, shown in (
        (np.ones((SIDE + 1, SIDE, 3)), []),
        ([white, white[:, 1:]], []),
        ([], []),
        (0 * white, []),
        (white, [WHITE, WHITE]),
        (white, [0 * WHITE]),
        (ps.Photograph.of(white, mask=np.eye(SIDE, dtype=bool)), []),
    ):
        with pytest.raises(PhotographError):
            calibrated(photograph, shown=shown)
