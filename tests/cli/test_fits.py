"""What the command says of scenes that do not fit, hardly show, or have no rank."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli.options import LightOptions
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.judgement import remedies_of
from periscopy_sim.model.residual import HELPS, Residual
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.shipped import find_scene
from tests.scenes.cards import HIDDEN, write_cards

pytestmark = pytest.mark.usefixtures("jit", "few_lights")


def with_remedies(session, residual, monitor_off=()):
    """Return the report of a residual by the default method, with the remedies for it."""
    report, fitted = Report(residual=residual), SimpleNamespace(name=DEFAULT, plan=None)
    photograph = ps.Photograph.of(np.ones((2, 2, 1)), monitor_off=monitor_off)
    return replace(report, remedies=remedies_of(session.scenario, report, fitted, photograph))


def test_a_remedy_is_named_only_if_it_explains_the_misfit():
    session, light = PhotoSession("plate", ["3x4"]), np.zeros((2, 2, 1))
    detail, page = {"patches": 0.0}, (np.ones((2, 2, 1)),)
    for explained, monitor_off, advice in [
        ({"numbers": 0.3, "paint": 0.2}, (), " Run calibrate."),
        ({"numbers": 0.0, "paint": 0.9}, (), " Look at residual.png."),
        ({**detail, "numbers": 0.0, "paint": 0.9}, (), " Pass --monitor-off."),
        ({**detail, "numbers": 0.3, "paint": 0.9}, (), " Pass --monitor-off. Run calibrate."),
        ({**detail, "numbers": 0.0, "paint": 0.9}, page, " Look at residual.png."),
        ({}, (), " Look at residual.png."),
    ]:
        residual = Residual(light, 0.02, 0.02, 0.001, 9.0, "does_not_fit", 1.0, explained)
        line, colour = session.judge("y", with_remedies(session, residual, monitor_off))
        assert line.startswith("The scene does not fit") and colour == "red"
        assert all(part in line for part in advice.split(". "))
        named = line.count(".png") + line.count("calibrate") + line.count("--")
        assert named == advice.count(". ") + 1


@pytest.mark.parametrize(
    ("shown", "paint", "named"), [((12, 14), 0.0, True), ((6, 7), 0.01, False)]
)
def test_smaller_patches_are_a_remedy_for_detail_alone(succeeds, tmp_path, shown, paint, named):
    """Seed 0, noise of 60 dB; a chair of 32 x 32 pixels recovered in 6 x 7 patches."""
    scene = ps.load_scenario("chair", shown, {"resolution": 32})
    image = ps.read_hidden_image(ps.find_image("mushroom"), shown).reshape(-1, 3)
    wall = (ps.transport(scene).astype(float) @ image).reshape(32, 32, 3)
    wall *= 1 + paint * np.random.default_rng(0).standard_normal((32, 32, 1))
    np.save(tmp_path / "y.npy", ps.add_noise(wall, 60, 0))
    size = "-D", "resolution=32", "--hidden", "6x7", "--uncertain", "none"
    said = succeeds("reconstruct", "y.npy", "--scene", "chair", *size, "--out", "r")
    tried = json.loads((tmp_path / "r" / "summary.json").read_text())["explained_by"]
    assert (tried.get("patches", 0) > HELPS["patches"]) == named == ("more patches" in said)
    assert ("--monitor-off" in said) == (paint > 0)


@pytest.mark.parametrize(("errors_off", "names"), [(4.0, ["occluder_dx"]), (2.0, [])])
def test_a_doubted_calibration_is_a_part_of_the_only_verdict(tmp_path, errors_off, names, capfd):
    value = 0.005 * errors_off
    known = f"not trusted; occluder_dx = {value} from 0 +- 0.001: 1"
    given = {"occluder_dx": f"{value}", CALIBRATED: known}
    write_copy(read_document(find_scene("chair")), given, tmp_path / "calibrated.xml")
    session = PhotoSession(str(tmp_path / "calibrated.xml"), ["3x4"])
    residual = Residual(np.zeros((2, 2, 1)), 0.001, 0.001, 0.001, 1.0, "fits", 0.0)
    line, colour = session.judge("y", with_remedies(session, residual))
    assert line.startswith("The scene fits") and "not trusted" in line and colour == "red"
    assert [name for name in session.scenario.document.defaults if name in line] == names
    assert session.warnings == [f"y: {line}"] and "warning" not in capfd.readouterr().err


def test_surface_whose_light_is_below_the_noise_is_warned_of(tmp_path, capfd):
    session = PhotoSession(str(write_cards(tmp_path)), HIDDEN[1::2])
    A = ps.transport(session.scenario)
    A[:, session.scenario.hidden.slices["hidden_card"]] *= 1e-3
    np.save(tmp_path / "A.npy", A)
    session.transport(session.lit(LightOptions(), tmp_path / "A.npy"), 1e-2)
    assert "hardly shows hidden_card: " in capfd.readouterr().err
    assert "hardly shows monitor" not in " ".join(session.warnings)


def test_file_of_a_matrix_that_cannot_be_fitted_is_named(periscopy, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).random((24, 24, 3)) + 1)
    np.save(tmp_path / "A.npy", np.ones((576, 20), np.float32))
    outcome = periscopy(
        "reconstruct", "y.npy", "--scene", "chair", "-D", "resolution=24", "--hidden", "4x5",
        "--transport", "A.npy", "--method", "preconditioned", "--out", "out",
    )  # fmt: skip
    assert outcome.code == 2 and "error: A.npy: " in outcome.err


def test_glossy_surface_is_named(tmp_path, capfd):
    path = write_cards(tmp_path)
    bsdf = '<bsdf type="twosided"><bsdf type="roughconductor"/></bsdf></shape>\n</scene>'
    path.write_text(path.read_text().replace("</shape>\n</scene>", bsdf))
    PhotoSession(str(path), HIDDEN[1::2]).check_scene()
    assert "hidden_card (roughconductor)" in capfd.readouterr().err


def test_rank_by_the_grain_of_rays_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).random((32, 32, 3)) + 1)
    line = refused(
        "reconstruct", "y.npy", "--scene", "doorway", "-D", "film=32", "--hidden", "5x5",
        "--method", "preconditioned", "--out", "out",
    )  # fmt: skip
    assert "noise-aware" in line and "rank" in line


def test_wrong_id_is_named(refused, tmp_path):
    path = write_cards(tmp_path)
    path.write_text(path.read_text().replace('id="plate"', 'id="bar"'))
    np.save(tmp_path / "y.npy", np.random.default_rng(0).random((24, 24, 3)) + 1)
    for words, reply in [
        (("--hidden", "bar=2x2"), "rename the shape hidden_bar"),
        (
            ("--truth", "monitor=mushroom", "--truth", "crad=letters"),
            "--truth crad=letters: write --truth monitor=",
        ),
    ]:
        line = refused(
            "reconstruct", "y.npy", "--scene", path.name, *HIDDEN, *words, "--out", "out"
        )
        assert reply in line
