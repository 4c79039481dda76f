"""What the command says of scenes that do not fit, hardly show, or have no rank."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import SceneError
from periscopy_sim.model.residual import Residual
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.rendering.transport.shadow_rays import require_light
from tests.scenes.cards import HIDDEN, SIZES, write_cards

pytestmark = pytest.mark.usefixtures("jit", "few_lights")


@pytest.mark.parametrize(
    ("excess", "declared", "advice"),
    [
        (1.0, True, "differs by pixels"),
        (9.0, True, "Run calibrate."),
        (9.0, False, "Declare the errors"),
    ],
)
def test_advice_suits_the_residual_and_what_the_scene_declares(tmp_path, excess, declared, advice):
    scene = ("plate", ["3x4"]) if declared else (str(write_cards(tmp_path)), HIDDEN[1::2])
    session = PhotoSession(*scene)
    session.record |= {"transport_error": None, "model": "analytic"}
    residual = Residual(np.zeros((2, 2, 1)), 0.02, 0.02, 0.001, excess, "does_not_fit", 1.0)
    line = session.judge("y", Report(residual=residual))
    assert line.startswith("The scene does not fit") and advice in line


def test_light_of_rounding_is_none(tmp_path):
    scenario = ps.load_scenario(write_cards(tmp_path), SIZES)
    A = np.full(scenario.transport_shape, 1e-3, np.float32)
    A[:, scenario.hidden.slices["hidden_card"]] = 1e-20
    with pytest.raises(SceneError, match="no light of 'hidden_card' reaches the wall"):
        require_light(A, scenario)


def test_surface_whose_light_is_below_the_noise_is_warned_of(tmp_path, capfd):
    session = PhotoSession(str(write_cards(tmp_path)), HIDDEN[1::2])
    A = ps.transport(session.scenario)
    A[:, session.scenario.hidden.slices["hidden_card"]] *= 1e-3
    np.save(tmp_path / "A.npy", A)
    session.transport(Light(), 1e-2, matrix=tmp_path / "A.npy")
    assert "hardly shows hidden_card: " in capfd.readouterr().err
    assert "hardly shows monitor" not in " ".join(session.warnings)


def test_glossy_surface_is_named(tmp_path, capfd):
    path = write_cards(tmp_path)
    bsdf = '<bsdf type="twosided"><bsdf type="roughconductor"/></bsdf></shape>\n</scene>'
    path.write_text(path.read_text().replace("</shape>\n</scene>", bsdf))
    PhotoSession(str(path), HIDDEN[1::2]).check_lights()
    assert "hidden_card (roughconductor)" in capfd.readouterr().err


def test_rank_by_the_grain_of_rays_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).random((32, 32, 3)) + 1)
    line = refused(
        "reconstruct", "y.npy", "--scene", "doorway", "-D", "film=32", "--hidden", "5x5",
        "--method", "preconditioned", "--out", "out",
    )  # fmt: skip
    assert "noise-aware" in line and "rank" in line


@pytest.mark.parametrize(
    ("words", "reply"),
    [
        (("--hidden", "bar=2x2"), "rename the shape hidden_bar"),
        (("--truth", "monitor=mushroom", "--truth", "crad=letters"), "--truth crad=...: name each"),
    ],
)
def test_wrong_id_is_named(refused, tmp_path, words, reply):
    path = write_cards(tmp_path)
    path.write_text(path.read_text().replace('id="plate"', 'id="bar"'))
    np.save(tmp_path / "y.npy", np.random.default_rng(0).random((24, 24, 3)) + 1)
    line = refused("reconstruct", "y.npy", "--scene", path.name, *HIDDEN, *words, "--out", "out")
    assert reply in line
