import json

import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.cells.mask_plane import mask_plane
from periscopy_sim.calibration.silhouette.masked_scene import write_masked_scene

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.silhouette import recover
from periscopy_sim.calibration.silhouette.result import overlap
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.calibration.silhouette.conftest import FLAG, HIDDEN, SCENE, silhouette

pytestmark = pytest.mark.usefixtures("jit")

COMMAND = (
    "calibrate",
    "y.npy",
    "--scene",
    "scene.xml",
    "--hidden",
    "6x7",
    "--out",
    "out/found.xml",
)


@pytest.fixture(scope="module")
def photograph(tmp_path_factory):
    """A photograph of the scene whose card is a flag."""
    scene = tmp_path_factory.mktemp("flagged") / "scene.xml"
    scene.write_text(SCENE)
    flagged, mesh = scene.with_name("flagged.xml"), scene.with_name("flag.ply")
    plane = mask_plane(load_scenario(scene, HIDDEN), "card")
    write_masked_scene(scene, silhouette(plane, FLAG), {}, flagged, mesh, mesh.name)
    image = 0.1 + np.random.default_rng(7).random((HIDDEN[0] * HIDDEN[1], 3)) ** 2
    scenario = load_scenario(flagged, HIDDEN)
    A = render_transport(scenario, samples=36, pixel_samples=9, seed=11)
    ambient = point_light_backgrounds(scenario)[:, [40]].reshape(40, 40, 1)
    light = composite((A @ image).reshape(40, 40, 3), np.tile(ambient, 3), sbr=1)
    return add_noise(light, 60, 3)


@pytest.fixture
def photographed(photograph, tmp_path):
    (tmp_path / "scene.xml").write_text(SCENE)
    np.save(tmp_path / "y.npy", photograph)


@pytest.mark.thorough
@pytest.mark.usefixtures("photographed")
def test_a_scene_with_the_silhouette_is_one_that_commands_take(succeeds, tmp_path, monkeypatch):
    monkeypatch.setattr(recover, "STARTS", 2)
    monkeypatch.setattr(recover, "FINALISTS", 2)
    told = succeeds(*COMMAND, "--silhouette", "card", "--cells", "8x8")
    out = tmp_path / "out"
    files = {"found.xml", "found.json", "found_card.ply", "found_silhouette.png"}
    assert {file.name for file in out.iterdir()} == files
    assert all(f"{name}" in told for name in files)
    record = json.loads((out / "found.json").read_text())
    opaque = np.array([[cell == "#" for cell in row] for row in record["opaque"]])
    assert overlap(opaque, FLAG, 1) > 0.85
    assert record["trusted"]
    assert "is a silhouette" in (out / "found.xml").read_text()
    succeeds(
        "reconstruct", "y.npy", "--scene", "out/found.xml", "--hidden", "6x7", "--out", "image"
    )
    assert (tmp_path / "image" / "reconstruction.npy").is_file()


@pytest.mark.usefixtures("photographed")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--silhouette", "wall"), "'wall' is no occluder; the occluders are '"),
        (("--silhouette", "card", "-D", "depth=1.2"), "reaches through the wall"),
        (("--silhouette", "card", "--cells", "40x40"), "ask for 13x13 at most"),
        (("--silhouette", "card", "--free", "shift"), "leave --free out"),
        (("--cells", "8x8"), "--cells are those of --silhouette"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_is_written(
    refused, tmp_path, arguments, message
):
    assert message in refused(*COMMAND, *arguments)
    assert not (tmp_path / "out").exists()
