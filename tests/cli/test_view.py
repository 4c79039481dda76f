import json
import socket
from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.laboratory import write_view
from periscopy_sim.cli.session import Session, WallSession
from periscopy_sim.live.looks import find_movables
from periscopy_sim.live.pictures import Choice, SizedLaboratory
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import load_scenario
from periscopy_sim.storage.rasters import read_exr

pytestmark = pytest.mark.usefixtures("jit")
SIZE = ("--hidden", "3x4")
SESSION = Session("plate", ["3x4"])


def test_what_cannot_be_viewed_is_refused_in_a_line(refused, tmp_path):
    pytest.importorskip("websockets")
    np.save(tmp_path / "small.npy", np.ones((20, 30, 3)))
    for options, offender in {
        ("plate", "--ambient", "mars"): "'mars'",
        ("plate", "--image", "none"): "'none'",
        ("plate", "small.npy"): "20 x 30",
        ("plate", "small.npy", "--ambient", "overcast"): "--ambient",
    }.items():
        assert offender in refused("view", *SIZE, *options)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert f"127.0.0.1:{port}" in refused("view", "plate", *SIZE, "--port", port)
    assert not (tmp_path / "view").exists()


def pictures_of(photograph=None, **values):
    scenario = load_scenario("plate", (3, 4), {"resolution": "24"})
    level = SizedLaboratory(scenario, photograph, is_coarse=False)
    return level.fit(Choice(values, "" if photograph else "mushroom")).pictures()


@pytest.mark.parametrize(
    "method", ["noise-aware", pytest.param("preconditioned", marks=pytest.mark.thorough)]
)
def test_the_page_fits_a_photograph_as_reconstruct_does(method, succeeds, tmp_path):
    """A of the same rays, and the scene's declared errors in the standard errors."""
    session = WallSession("plate", ["6x8"], ["resolution=24"])
    image = ps.read_hidden_image(ps.find_image("mushroom"), (6, 8)).reshape(-1, 3)
    light = (ps.transport(session.scenario) @ image).reshape(24, 24, 3)
    noise = np.random.default_rng(0).normal(0, 1e-3, light.shape)
    np.save(tmp_path / "wall.npy", light / light.mean() + noise)
    succeeds(
        "reconstruct", "wall.npy", "--scene", "plate", "--hidden", "6x8", "-D", "resolution=24",
        "--method", method, "--out", "out",
    )  # fmt: skip
    wall = session.wall(tmp_path / "wall.npy")
    level = SizedLaboratory(session.scenario, wall, is_coarse=False)
    values = {each.name: each.value for each in find_movables(session.scenario)[0]}
    pictures = level.fit(Choice(values, "", method=method)).pictures()
    of_command = np.load(tmp_path / "out" / "reconstruction.npy")
    largest = of_command.max()
    np.testing.assert_allclose(pictures.image, of_command, atol=1e-4 * largest)
    if method == "noise-aware":
        errors = np.load(tmp_path / "out" / "standard_error.npy")
        np.testing.assert_allclose(pictures.report.standard_errors, errors, rtol=1e-3)
        assert "occluder_dx" in pictures.report.numbers["standard_errors_count"]


def test_scene_is_written_as_it_is_set_in_place_of_former_pictures(tmp_path):
    pictures = pictures_of(occluder_dx=0.0123)
    files = {"scene.xml", "photograph.exr", "reconstruction.npy", "reconstruction.png", "view.json"}
    for report, more in (
        (pictures.report, {"standard_error.npy", "certainty.png"}),
        (Report(), ()),
    ):
        each = replace(pictures, report=report)
        write_view(tmp_path / "view", SESSION, each, None)
        assert {file.name for file in (tmp_path / "view").iterdir()} == files | set(more)
    defaults = read_document(tmp_path / "view" / "scene.xml").defaults
    assert defaults["occluder_dx"] == "0.0123" and defaults["resolution"] == "24"
    y, metadata = read_exr(tmp_path / "view" / "photograph.exr")
    np.testing.assert_allclose(y, pictures.photograph, rtol=1e-6)
    assert "scene_sha256" in metadata
    record = json.loads((tmp_path / "view" / "view.json").read_text())
    assert record["values"] == {"occluder_dx": 0.0123} and record["psnr"] == pictures.psnr


def test_a_given_photograph_is_written_as_what_is_left_of_it(tmp_path):
    taken = pictures_of(occluder_dx=0.01).photograph
    write_view(tmp_path / "view", SESSION, pictures_of(taken), "wall.exr")
    assert (tmp_path / "view" / "residual.png").is_file()
    assert not (tmp_path / "view" / "photograph.exr").exists()
    record = json.loads((tmp_path / "view" / "view.json").read_text())
    assert record["unexplained"] > 0 and record["photograph"] == "wall.exr"
