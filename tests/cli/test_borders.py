"""A border that stands out is left out by the commands, which say so; a mask is taken as it is."""

import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import SceneError

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

SIZE = 40
GIVEN = ("--scene", "chair", "-D", f"resolution={SIZE}", "--hidden", "4x5")
SMALL = (*GIVEN, "--samples", "4", "--method", "preconditioned")
INSIDE = np.ones((SIZE, SIZE), bool)
INSIDE[0] = INSIDE[:, 0] = False
TOLD = (
    "y.npy: left out border lines that are far too dark or bright (1 at the top, 1 at the left); "
    "--mask takes exactly what it shows"
)


@pytest.fixture(scope="module")
def clean():
    scene = ps.load_scenario("chair", (4, 5), {"resolution": SIZE})
    hidden = np.random.default_rng(1).uniform(0.1, 1, (20, 3))
    signal = (ps.analytic_transport(scene) @ hidden).reshape(SIZE, SIZE, 3)
    return ps.add_noise(signal / signal.mean(), 60, seed=0)


@pytest.fixture
def spoilt(clean, tmp_path):
    """Write a photograph with a dark row and a bright column, and masks."""
    y = clean.copy()
    y[0] *= 0.5
    y[:, 0] *= 1.5
    np.save(tmp_path / "y.npy", y)
    np.save(tmp_path / "clean.npy", clean)
    np.save(tmp_path / "inside.npy", INSIDE)
    np.save(tmp_path / "all.npy", np.ones_like(INSIDE))
    return y


def border_lines(outcome):
    return [line for line in outcome.err.splitlines() if "border lines" in line]


@pytest.fixture
def reconstruct(periscopy, tmp_path):
    def run(photo, *options):
        outcome = periscopy("reconstruct", photo, *SMALL, *options, "--out", "out")
        assert outcome.code == 0
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary, border_lines(outcome)

    return run


@pytest.mark.usefixtures("spoilt")
def test_the_image_is_that_of_the_photograph_without_its_border(reconstruct, tmp_path):
    image, summary, lines = reconstruct("y.npy")
    assert lines == [f"periscopy: warning: {TOLD}"] and TOLD in summary["warnings"]
    assert (summary["mask"], summary["pixels_left_out"]) == (None, 2 * SIZE - 1)
    assert not (tmp_path / "out" / "mask.png").exists()
    by_hand, summary, lines = reconstruct("y.npy", "--mask", "inside.npy")
    assert lines == [] and summary["pixels_left_out"] == 2 * SIZE - 1
    np.testing.assert_array_equal(image, by_hand)
    _, summary, lines = reconstruct("clean.npy")
    assert lines == [] and summary["pixels_left_out"] == 0


@pytest.mark.usefixtures("spoilt")
def test_a_mask_is_taken_as_it_is(reconstruct):
    _, summary, lines = reconstruct("y.npy", "--mask", "all.npy")
    assert summary["pixels_left_out"] == 0 and lines == []


@pytest.mark.usefixtures("spoilt")
def test_a_method_that_need_not_take_masks_sees_the_border(periscopy, tmp_path):
    """It would see black there, which is worse."""
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Mine:\n"
        "    def __init__(self, scenario, A, B):\n"
        "        pass\n"
        "    def reconstruct(self, photograph):\n"
        "        np.save('seen.npy', photograph)\n"
        "        return np.ones((4, 5, 3))\n"
    )
    mine = (*GIVEN, "--samples", "4", "--method", "mine.py:Mine")
    outcome = periscopy("reconstruct", "y.npy", *mine, "--out", "out")
    assert outcome.code == 0
    np.testing.assert_array_equal(np.load(tmp_path / "seen.npy"), np.load(tmp_path / "y.npy"))
    assert border_lines(outcome)[0].endswith("leave them out by --mask out/mask.png")


def test_video_leaves_out_the_border_of_its_first_frame(spoilt, periscopy, tmp_path):
    np.save(tmp_path / "frames.npy", np.stack([spoilt, spoilt]))
    outcome = periscopy("video", "frames.npy", *SMALL, "--out", "out")
    assert outcome.code == 0
    assert f"frames.npy, first frame: {TOLD.removeprefix('y.npy: ')}" in border_lines(outcome)[0]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["pixels_left_out"] == 2 * SIZE - 1


@pytest.mark.usefixtures("spoilt")
@pytest.mark.parametrize(
    ("search", "options"),
    [
        ("periscopy_sim.calibration.calibrate.calibrate", ()),
        (
            "periscopy_sim.calibration.silhouette.recover.recover_silhouette",
            ("--silhouette", "plate", "--scene", "plate"),
        ),
    ],
)
def test_calibration_is_asked_for_the_photograph_without_its_border(
    search, options, periscopy, monkeypatch
):
    seen = []

    def capture(*_, mask, **__):
        seen.append(mask)
        raise SceneError("enough is seen")

    monkeypatch.setattr(search, capture)
    outcome = periscopy("calibrate", "y.npy", *GIVEN, *options, "--out", "found.xml")
    assert outcome.code == 2 and "enough is seen" in outcome.err
    assert border_lines(outcome) == [f"periscopy: warning: {TOLD}"]
    np.testing.assert_array_equal(seen[0], INSIDE)
