from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.messages import report_sentences
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.pictures import Overtaken, SizedLaboratory, coarse
from periscopy_sim.photograph import Photograph
from periscopy_sim.scenario import load_scenario
from periscopy_sim.storage.pictures import averaged_photograph
from tests.scenes.room import Room


def test_pictures_are_of_the_scene_as_it_is_set(level, choice):
    pictures = level().fit(choice).pictures()
    assert pictures.photograph.shape == (24, 24)
    assert pictures.image.shape == pictures.report.standard_errors.shape == (6, 8, 3)
    assert pictures.psnr == ps.psnr_gain_matched(pictures.image, pictures.truth) > 20
    moved = replace(choice, values={**choice.values, "occluder_dx": 0.03})
    there = level().fit(moved).pictures()
    before, after = (each.scenario.scene.occluders[0].vertices for each in (pictures, there))
    shift = after - before
    np.testing.assert_allclose(shift, np.broadcast_to([0.03, 0, 0], shift.shape), atol=1e-6)
    assert np.abs(there.photograph.values - pictures.photograph.values).max() > 0.05


def test_rays_are_as_many_as_the_noise_asks_for_and_too_few_are_warned_of(
    choice, monkeypatch, tmp_path
):
    from periscopy_sim.rendering import transport

    parts = Room(tmp_path)
    sphere = parts.write(parts.blocker())  # has no closed form
    room = load_scenario(sphere, (3, 4), photograph=(12, 12))
    laboratory = SizedLaboratory(room, is_coarse=False)
    pictures = laboratory.fit(replace(choice, values={})).pictures()
    assert not pictures.report.warnings
    monkeypatch.setattr(transport, "BUDGET", 0)
    report = laboratory.fit(replace(choice, values={}, snr=80.0)).pictures().report
    (warning,) = report.warnings
    assert warning.code == "transport_error"
    assert warning.values["error"] > warning.values["noise"] == pytest.approx(0.01)
    assert report_sentences(report)


def test_averages_to_come_need_a_finer_matrix_than_a_noisy_first_one(choice):
    noise = 0.3 * np.random.default_rng(0).normal(size=(24, 24, 3))
    first, light = Photograph(1 + noise), ps.Light("rays")
    scene = load_scenario("plate", (6, 8), photograph=(24, 24), light=light)
    assert scene.plan(scene.noise(first)) != scene.plan()
    unknown = replace(choice, image="")
    fitted = SizedLaboratory(scene, lambda: first, is_coarse=False).fit(unknown)
    assert fitted.method.plan == scene.plan()


COUNTED = """
from pathlib import Path
import periscopy_sim as ps

def counted(scenario, A, B):
    with Path(__file__).with_name("fits").open("a") as file:
        file.write("x")
    return ps.NoiseAware.for_scene(scenario, A, B)
"""


def test_what_was_computed_is_kept(level, choice, tmp_path):
    (tmp_path / "own.py").write_text(COUNTED)
    laboratory, choice = level(), replace(choice, method=f"{tmp_path}/own.py:counted")
    first = laboratory.fit(choice).pictures()
    noisier = laboratory.fit(replace(choice, snr=20.0)).pictures()
    assert noisier.scenario is first.scenario and noisier.psnr < first.psnr
    again = laboratory.fit(choice).pictures()
    np.testing.assert_array_equal(again.image, first.image)
    assert (tmp_path / "fits").read_text() == "x"


def test_scene_that_explains_a_photograph_leaves_less_of_it(level, choice):
    """By which a person aligns a scene; what was hidden is not known."""
    values = {**choice.values, "occluder_dx": 0.01}
    taken = level().fit(replace(choice, values=values)).pictures().photograph
    unknown = replace(choice, image="")
    laboratory = level(photograph=taken)
    left = {}
    for dx in (-0.01, 0.0, 0.01):
        there = replace(unknown, values={**choice.values, "occluder_dx": dx})
        pictures = laboratory.fit(there).pictures()
        assert pictures.truth is None and pictures.psnr is None
        left[dx] = pictures.report.residual.unexplained
    assert left[0.01] < 0.5 * min(left[0.0], left[-0.01])


def test_verdict_on_frames_says_what_would_help(level, choice):
    taken = level().fit(replace(choice, values={**choice.values, "occluder_dx": 0.03})).photograph
    verdict = level(photograph=lambda: taken).fit(replace(choice, image="")).judge(taken)
    assert verdict.is_doubted and verdict.remedies


def test_masked_pixels_of_a_photograph_are_averaged_out():
    values = np.ones((8, 8, 3))
    used = np.ones((8, 8), bool)
    values[:4, :4], used[:4, :4] = np.nan, False
    values[4, 4], used[4, 4] = 1e9, False
    coarse = averaged_photograph(Photograph(values, used), (4, 4))
    assert coarse.mask.tolist() == [[False, False, True, True]] * 2 + [[True] * 4] * 2
    np.testing.assert_allclose(coarse.used, 1)


def test_overtaken_work_ends_at_once(level, choice):
    asked = []

    def unless_overtaken(*_):
        asked.append(True)
        if len(asked) > 1:
            raise Overtaken

    with pytest.raises(Overtaken):
        level().fit(choice, unless_overtaken)
    assert len(asked) == 2


def test_what_cannot_be_shown_is_reported(level, choice):
    behind = replace(choice, values={**choice.values, "monitor_dy": 3.0})
    with pytest.raises(PeriscopyError, match="monitor"):
        level().fit(behind).pictures()
    with pytest.raises(PeriscopyError, match="monitor is off"):
        level().fit(replace(choice, image="")).pictures()
    with pytest.raises(PeriscopyError, match="no method"):
        level().fit(replace(choice, method="magic")).pictures()
    small = SizedLaboratory(load_scenario("plate", (8, 8), photograph=(8, 8)), is_coarse=True)
    with pytest.raises(PeriscopyError, match="rank"):
        small.fit(replace(choice, method="preconditioned")).pictures()  # ambient light too


def test_coarse_sizes_keep_more_pixels_than_patches():
    for size in [(126, 126), (50, 200), (40, 40)]:
        scene = load_scenario("plate", (29, 36), photograph=size)
        small = coarse(scene, used=0.3)
        shape, hidden = small.photograph_shape, small.hidden_shape
        assert max(shape) <= 32 and max(hidden) <= 12
        assert np.prod(hidden) <= 0.3 * np.prod(shape)
        assert small.memo is scene.memo  # one limit for both
