from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.studies.wrong_scenes import plain_scenes, subjects


def test_the_ruler_errs_as_the_scene_declares():
    subject = subjects.Subject("plate", ps.find_scene("plate"), ps.find_scene("plate"), (2, 2),
                               "bars", "overcast", {"resolution": "8"})  # fmt: skip
    errors, true = subject.errors, subject.true_values
    assert len(errors) == 13
    drawn = [subject.measured(draw) for draw in range(6)]
    off = (np.array([list(read.values()) for read in drawn]) - true) / list(errors.values())
    # 78 normal numbers: mean and spread within 4 standard errors, once in 10,000 sets of seeds.
    assert abs(off.mean()) < 4 / np.sqrt(off.size)
    assert abs(off.std() - 1) < 4 / np.sqrt(2 * off.size)
    assert list(drawn[0]) == list(errors) and subject.measured(0) == drawn[0] != drawn[1]


def test_plain_scenes_load_with_their_errors_and_draws():
    known = plain_scenes.plain_subjects()
    for name, subject in known.items():
        errors, read = subject.errors, subject.measured(0)
        assert 8 <= len(errors) <= 14 and list(read) == list(errors)
        assert all(0 < error < 3 for error in errors.values())
        assert subject.at(read).photograph_shape == subject.at().photograph_shape, name


@pytest.mark.usefixtures("jit")
def test_plain_mitsuba_agrees_with_the_closed_form(tmp_path, monkeypatch):
    monkeypatch.setattr(plain_scenes, "PASSES", 8)
    subject = replace(plain_scenes.plain_subjects()["tripod"], hidden=(3, 4), samples=1024,
                      parameters={"width": "12", "height": "10"})  # fmt: skip
    photographed = plain_scenes.photographed_plainly(subject, tmp_path)
    file = tmp_path / "tripod" / "bars.exr"
    passes = plain_scenes.plain_renderings(subject, file, photographed.truth, "0")
    scene = subject.at()
    exact = ps.transport(scene, by="areas") @ photographed.truth.reshape(-1, 3)
    rest = photographed.signal - exact.reshape(photographed.signal.shape) * scene.channel_gain
    error = np.sqrt(passes.var(axis=0, ddof=1).mean() / 8)
    assert error < 0.01 * photographed.signal.mean()
    assert np.sqrt(np.mean(rest**2)) < 1.25 * error
    assert photographed.ambient.std() < 0.5 * photographed.ambient.mean()
