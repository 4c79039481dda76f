"""Commands by a camera of its own, and `reconstruct` on several views of one scene."""

import json
import re

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.storage.pictures import write_png
from tests.scenes.two_walls import CAMERAS, SHAPES, write_two_walls

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

EXPOSURES = {"left": 1.0, "right": 0.4}
VIEWS = ("--camera", "left", "--camera", "right")


@pytest.fixture
def scene(tmp_path):
    """Two walls; beside the scene `truth.npy`, and of each camera a photograph, A and a mask."""
    path = write_two_walls(tmp_path)
    down, across = np.mgrid[0.1:0.6:3j, 0.1:0.9:4j]
    image = np.stack([down, across, 0.7 - down], axis=-1)
    np.save(tmp_path / "truth.npy", image)
    rng = np.random.default_rng(6)
    for name, exposure in EXPOSURES.items():
        seen = ps.load_scenario(path, (3, 4), camera=name)
        A = ps.transport(seen)
        y = exposure * (A @ image.reshape(-1, 3)).reshape(*seen.photograph_shape, 3)
        np.save(tmp_path / f"{name}.npy", y + 3e-4 * y.mean() * rng.standard_normal(y.shape))
        np.save(tmp_path / f"{name}_A.npy", A)
        mask = np.full((*seen.photograph_shape, 3), 255, np.uint8)
        mask[:3] = 0
        write_png(tmp_path / f"{name}_mask.png", mask, {})
    return path.name


def options_of(scene):
    return ("--scene", scene, "--hidden", "3x4", "--out", "out")


@pytest.fixture
def summary(tmp_path):
    """Read the summary in `out`."""
    return lambda: json.loads((tmp_path / "out" / "summary.json").read_text())


def test_reconstruct_recovers_one_image_of_two_views(scene, succeeds, summary, tmp_path):
    out = succeeds(
        "reconstruct", "left.npy", "right.npy", *options_of(scene), *VIEWS,
        "--truth", "truth.npy", "--mask", "right=right_mask.png",
    )  # fmt: skip
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"reconstruction.npy", "standard_error.npy", "stages.png", "comparison.png"} < files
    assert {"residual_left.png", "residual_right.png"} < files and "residual.png" not in files
    numbers = summary()
    assert numbers["photograph_shape"] == {name: [*shape] for name, shape in SHAPES.items()}
    assert numbers["exposures"]["right"] == pytest.approx(0.4, rel=0.01)
    assert numbers["psnr"] > 40
    views = numbers["views"]
    for name in CAMERAS:
        assert views[name]["photograph"] == f"{name}.npy" and views[name]["diagnosis"] == "fits"
        assert re.search(f"^{name}: {re.escape(views[name]['verdict'])}$", out, re.MULTILINE)
    assert (views["left"]["mask"], views["right"]["mask"]) == (None, "right_mask.png")
    assert views["right"]["pixels_left_out"] == 3 * SHAPES["right"][1]
    assert re.search("the exposure of right is 0.[34][0-9]* ± .* times that of left", out)
    image = np.load(tmp_path / "out" / "reconstruction.npy")
    assert image.shape == (3, 4, 3)
    # A run on one view leaves nothing of the former's.
    succeeds("reconstruct", "right.npy", *options_of(scene), "--camera", "right")
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert "residual.png" in files and "residual_left.png" not in files
    one = np.load(tmp_path / "out" / "reconstruction.npy")
    assert one.mean() == pytest.approx(0.4 * image.mean(), rel=0.02)


def test_matrices_are_read_and_each_view_is_judged_by_the_image_in_its_own_exposure(
    scene, succeeds, summary, monkeypatch
):
    judge, images = ps.Scenario.judge, {}

    def judged(self, photograph, solution, *rest):
        images[self.view.camera] = solution.image
        return judge(self, photograph, solution, *rest)

    monkeypatch.setattr(ps.Scenario, "judge", judged)
    matrices = [word for name in CAMERAS for word in ("--transport", f"{name}={name}_A.npy")]
    files = ("left.npy", "right.npy")
    outcome = succeeds("reconstruct", *files, *options_of(scene), *VIEWS, *matrices)
    assert "left: The scene fits" in outcome
    assert [summary()["views"][name]["transport"] for name in CAMERAS] == [
        f"{name}_A.npy" for name in CAMERAS
    ]
    np.testing.assert_allclose(images["right"], 0.4 * images["left"], rtol=0.01)


def test_commands_take_a_camera(scene, succeeds, tmp_path):
    camera = ("--hidden", "3x4", "--camera", "right")
    succeeds("transport", scene, *camera, "--out", "A.npy")
    np.testing.assert_allclose(
        np.load(tmp_path / "A.npy"), np.load(tmp_path / "right_A.npy"), rtol=1e-6
    )
    arguments = ("--samples", "64", "--out", "photo.exr")
    succeeds("photograph", scene, "truth.npy", *camera, *arguments)
    photograph = ps.read_photograph(tmp_path / "photo.exr", SHAPES["right"]).values
    y = np.load(tmp_path / "right.npy") / 0.4
    assert photograph.mean() > y.mean()  # light also bounces off the other wall
    assert np.corrcoef(photograph[..., 1].ravel(), y[..., 1].ravel())[0, 1] > 0.9


def test_wrong_views_are_named(scene, refused, tmp_path):
    (tmp_path / "own.py").write_text("def Own(scenario, A, B): ...\n")
    for arguments, offender in [
        ("left.npy", r"no sensor .* 'camera' \('left', 'right'\)"),
        ("left.npy --camera middle", r"'middle' \('left', 'right'\)"),
        ("left.npy right.npy --camera left", "photographs: 2, cameras: left; .* --camera"),
        ("left.npy right.npy --camera left --camera left", "cameras: left, left"),
        ("left.npy right.npy --camera left --camera a/../../x", "'a/[./]*x': give it an id"),
        ("left.npy --camera left --camera right", "photographs: 1, cameras: left, right"),
        ("left.npy right.npy {} --mask left_mask.png", "--mask left=... --mask right=..."),
        ("left.npy right.npy {} --monitor-off middle=left.npy", "--monitor-off middle=left.npy"),
        ("right.npy left.npy {}", "right.npy: 20 x 26 pixels"),
        (
            "left.npy right.npy {} --method preconditioned",
            "preconditioned: it takes one view; several take noise-aware",
        ),
        ("left.npy right.npy {} --method own.py:Own", "own.py:Own: it takes one view"),
    ]:
        words = arguments.format(" ".join(VIEWS)).split()
        line = refused("reconstruct", *words, *options_of(scene))
        assert re.search(offender, line), line


def test_other_commands_take_one_camera(scene, refused):
    line = refused("transport", scene, "--hidden", "3x4", *VIEWS, "--out", "A.npy")
    assert re.search("--camera right: this command takes one view", line)
