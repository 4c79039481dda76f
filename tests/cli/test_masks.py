"""What is left out by --mask, and what a command says of defective pixels."""

import json

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.cli.fitting.transport_matrix import AskedTransport
from periscopy_sim.storage.formats.exr import write_exr

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
MASK = np.random.default_rng(3).random((24, 24)) > 0.2
MASK[4:9, 10:18] = False
LEFT_OUT = int((~MASK).sum())
GARBAGE = np.resize([1e9, -1e30, np.nan, np.inf, 0.0], (24, 24, 3))


@pytest.fixture
def given(photographs, tmp_path):
    """Write a mask and three photographs: clean, spoilt under it, and with dead pixels instead."""
    Image.fromarray(MASK).save(tmp_path / "mask.png")
    y = photographs[0]
    np.save(tmp_path / "clean.npy", y)
    np.save(tmp_path / "spoilt.npy", np.where(MASK[..., None], y, GARBAGE))
    defective = y.copy()
    defective[11, 3], defective[17, 20, 1] = 0, 0
    defective[20, 5] *= 100
    np.save(tmp_path / "defective.npy", defective)
    return y


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    def run(photo, *options):
        succeeds("reconstruct", photo, "--scene", "chair", *TINY, *options, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


PAPER = ("--method", "preconditioned")
METHODS = ("preconditioned", "differencing", "truncated-svd", "iterative")


@pytest.mark.thorough
@pytest.mark.usefixtures("given")
@pytest.mark.parametrize("method", METHODS)
def test_garbage_under_the_mask_gives_the_image_of_the_clean_photograph(method, reconstruct):
    options = ("--method", method, "--mask", "mask.png")
    image, summary = reconstruct("spoilt.npy", *options)
    assert (summary["mask"], summary["pixels_left_out"]) == ("mask.png", LEFT_OUT)
    clean, _ = reconstruct("clean.npy", *options)
    np.testing.assert_array_equal(image, clean)
    whole, summary = reconstruct("clean.npy", "--method", method)
    assert (summary["mask"], summary["pixels_left_out"]) == (None, 0)
    assert np.abs(image - whole).max() > 1e-4


def test_image_is_that_of_the_rows_used(given, reconstruct, scenario, transport):
    image, summary = reconstruct("spoilt.npy", "--mask", "mask.png", *PAPER)
    used = MASK.ravel()
    B = ps.point_light_backgrounds(scenario)
    by_hand = ps.Periscope(transport[used], B[used], hidden_shape=(4, 5), explicit=False)
    solution = by_hand.solve(given.reshape(576, 3)[used])
    np.testing.assert_allclose(image, solution.image, rtol=1e-4, atol=1e-4)
    # The command's P and R are of single precision, and noise² is ‖y⊥‖² less ‖R f‖², here up to 30
    # times what is left: four roundings of 6e-8 become 30 × 4 × 6e-8 / 2 = 4e-6 of the noise.
    np.testing.assert_allclose(summary["noise"], solution.noise, rtol=1e-5)


def test_mask_of_another_size_is_refused_before_rendering(refused, tmp_path, monkeypatch):
    monkeypatch.setattr(AskedTransport, "matrix", None)
    np.save(tmp_path / "y.npy", np.ones((24, 24, 3)))
    np.save(tmp_path / "mask.npy", np.ones((24, 23), bool))
    np.save(tmp_path / "none.npy", np.zeros((24, 24)))
    for command in (
        ("reconstruct", "y.npy", "--scene"),
        ("video", "y.npy", "--scene"),
        ("analyze",),
    ):
        line = refused(*command, "chair", *TINY, "--mask", "mask.npy", "--out", "out")
        assert "mask.npy: 24 x 23 pixels" in line and "24 x 24" in line
        line = refused(*command, "chair", *TINY, "--mask", "none.npy", "--out", "out")
        assert "none.npy: leaves out every pixel" in line
        line = refused(*command, "chair", *TINY, "--mask", "missing.png", "--out", "out")
        assert "missing.png: no such file" in line


@pytest.mark.usefixtures("given")
@pytest.mark.parametrize("method", METHODS)
def test_too_few_pixels_are_refused(method, refused, tmp_path):
    np.save(tmp_path / "few.npy", np.arange(576).reshape(24, 24) < 19)
    command = ("reconstruct", "clean.npy", "--scene", "chair", *TINY, "--method", method)
    line = refused(*command, "--mask", "few.npy", "--out", "out")
    assert "few.npy: the mask leaves 19 pixels for 20 patches: leave out less" in line


MINE = """
import numpy as np

class Mine:
    def __init__(self, scenario, A, B):
        self.A, self.shape = A, (*scenario.hidden_shape, 3)

    def reconstruct(self, photograph):
        return (self.A.T @ photograph.reshape(len(self.A), 3)).reshape(self.shape)
"""


@pytest.mark.thorough
@pytest.mark.usefixtures("drawings")
@pytest.mark.filterwarnings("ignore:.* takes no keyword mask")
def test_method_that_takes_no_mask_and_every_picture_see_black(
    given, succeeds, transport, tmp_path
):
    (tmp_path / "mine.py").write_text(MINE)
    np.save(tmp_path / "truth.npy", np.random.default_rng(1).uniform(0.1, 1, (4, 5, 3)))
    pixels = {}
    for photo in ("clean", "spoilt"):
        for method in ("mine.py:Mine", "truncated-svd"):
            options = ("--mask", "mask.png", "--truth", "truth.npy", "--method", method)
            arguments = ("--scene", "chair", *TINY, *options, "--out", f"{photo}-{method[0]}")
            succeeds("reconstruct", f"{photo}.npy", *arguments)
        for picture in ("m/comparison.png", "t/comparison.png", "t/stages.png"):
            with Image.open(tmp_path / f"{photo}-{picture}") as drawn:
                pixels[photo, picture] = np.asarray(drawn)
    for (_, picture), drawn in pixels.items():
        np.testing.assert_array_equal(drawn, pixels["clean", picture])
    black = np.where(MASK[..., None], given, 0).reshape(576, 3)
    image = np.load(tmp_path / "spoilt-m" / "reconstruction.npy")
    np.testing.assert_allclose(image.reshape(20, 3), transport.T @ black, rtol=1e-5)


# -- defective pixels ----------------------------------------------------------------------------


@pytest.mark.usefixtures("given")
def test_defective_pixels_are_told_in_one_line_and_a_mask_is_suggested(
    periscopy, reconstruct, tmp_path
):
    arguments = ("--scene", "chair", *TINY, "--out", "out")
    outcome = periscopy("reconstruct", "defective.npy", *arguments)
    line = (
        "defective.npy: 0 saturated, 2 dead and 1 hot pixels, the first in row 11, column 3; leave "
        "them out by --mask out/mask.png"
    )
    assert (outcome.code, outcome.err) == (0, f"periscopy: warning: {line}\n")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["warnings"] == [line]
    mask = ps.read_mask(tmp_path / "out" / "mask.png", (24, 24))
    assert np.argwhere(~mask).tolist() == [[11, 3], [17, 20], [20, 5]]
    # That mask silences the warning, and gives the image of the photograph without those pixels.
    image, summary = reconstruct("defective.npy", "--mask", "out/mask.png")
    assert (summary["warnings"], summary["pixels_left_out"]) == ([], 3)
    clean, _ = reconstruct("clean.npy", "--mask", "out/mask.png")
    np.testing.assert_array_equal(image, clean)


@pytest.mark.usefixtures("given")
def test_suggested_mask_keeps_what_was_left_out(periscopy, tmp_path):
    arguments = ("--scene", "chair", *TINY, "--mask", "mask.png", "--out", "out")
    outcome = periscopy("reconstruct", "defective.npy", *arguments)
    assert outcome.code == 0 and outcome.err.count("\n") == 1
    expected = MASK.copy()
    expected[[11, 17, 20], [3, 20, 5]] = False
    mask = ps.read_mask(tmp_path / "out" / "mask.png", (24, 24))
    np.testing.assert_array_equal(mask, expected)


def test_video_leaves_out_what_the_mask_does(
    few_photographs, periscopy, video, results, scenario, transport, tmp_path
):
    Image.fromarray(MASK).save(tmp_path / "mask.png")
    np.save(tmp_path / "clean.npy", few_photographs)
    np.save(tmp_path / "spoilt.npy", np.where(MASK[..., None], few_photographs, GARBAGE))
    clean, _, _ = video("clean.npy", "--method", "preconditioned", "--mask", "mask.png")
    images, summary, table = video("spoilt.npy", "--method", "preconditioned", "--mask", "mask.png")
    np.testing.assert_array_equal(images, clean)
    assert (summary["mask"], summary["pixels_left_out"]) == ("mask.png", LEFT_OUT)
    used, B = MASK.ravel(), ps.point_light_backgrounds(scenario)
    by_hand = ps.Video(ps.Periscope(transport[used], B[used], hidden_shape=(4, 5)))
    expected = by_hand.frames(few_photographs.reshape(3, 576, 3)[:, used])
    np.testing.assert_allclose(images, expected, rtol=1e-3, atol=1e-3)
    assert np.isfinite([float(row["noise"]) for row in table]).all()
    dead = few_photographs.copy()
    dead[:, 11, 3] = 0
    np.save(tmp_path / "dead.npy", dead)
    arguments = ("--scene", "chair", *TINY, "--out", "dead")
    outcome = periscopy("video", "dead.npy", *arguments)
    assert outcome.code == 0 and outcome.err == (
        "periscopy: warning: dead.npy, first frame: 0 saturated, 1 dead and 0 hot pixels, the "
        "first in row 11, column 3; leave them out by --mask dead/mask.png\n"
    )
    _, summary, _ = results(tmp_path / "dead")
    assert len(summary["warnings"]) == 1
    assert (~ps.read_mask(tmp_path / "dead" / "mask.png", (24, 24))).sum() == 1


def test_analysis_is_that_of_the_rows_used(succeeds, scenario, tmp_path):
    Image.fromarray(MASK).save(tmp_path / "mask.png")
    succeeds("analyze", "chair", *TINY, "--mask", "mask.png", "--out", "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    transport = ps.render_transport(scenario, samples=4, strata="gauss")
    A = transport[MASK.ravel()].astype(np.float64)
    assert summary["condition_A"] == pytest.approx(np.linalg.cond(A), rel=1e-6)
    assert (summary["mask"], summary["pixels_left_out"]) == ("mask.png", LEFT_OUT)
    without = np.load(tmp_path / "out" / "bounds_without_background.npy").ravel()
    assert np.allclose(without, np.linalg.norm(np.linalg.pinv(A), axis=1), rtol=1e-6)
    last = summary["rank_table"][0]["noise_gain"]
    assert last > 0.99 * np.sum(without**2)


# -- sweeps --------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_sweep_leaves_out_what_the_mask_does(succeeds, refused, sweep_input, sweep_command):
    mask = np.random.default_rng(4).random((21, 21)) > 0.2
    np.save(sweep_input / "mask.npy", mask)
    np.save(sweep_input / "other.npy", mask[::-1])
    y = np.load(sweep_input / "y.npy")
    np.save(sweep_input / "spoilt.npy", np.where(mask[..., None], y, np.nan))
    options = {"methods": "preconditioned,differencing,iterative", "sbr": "0.5"}
    command = sweep_command(mask="mask.npy", **options)
    succeeds(*command)
    clean = (sweep_input / "out" / "sweep.csv").read_bytes()
    assert b"nan" not in clean and b"failed" not in clean
    assert (
        "mask_sha256"
        in json.loads((sweep_input / "out/sweep.zarr/zarr.json").read_text())["attributes"]
    )
    succeeds(*command, "--photograph", "spoilt.npy", "--out", "spoilt")
    assert (sweep_input / "spoilt" / "sweep.csv").read_bytes() == clean
    succeeds(*sweep_command(**options, out="whole"))
    assert (sweep_input / "whole" / "sweep.csv").read_bytes() != clean
    # Another mask, or none, is another sweep.
    assert "out holds another sweep (mask " in refused(*command, "--mask", "other.npy")
    assert "here unset)" in refused(*sweep_command(**options))


def test_background_is_flipped_whole(succeeds, refused, sweep_input, sweep_command):
    mask = np.ones((21, 21), bool)
    mask[:4] = False
    light = np.full((21, 21, 3), 2.0)
    np.save(sweep_input / "mask.npy", mask)
    write_exr(sweep_input / "even.exr", light, {})
    options = {"mask": "mask.npy", "methods": "truncated-svd", "sbr": "1"}
    succeeds(*sweep_command(**options, ambient="even.exr"))
    held = json.loads((sweep_input / "out/sweep.zarr/zarr.json").read_text())["attributes"]
    assert len(held["background_sha256"]) == 4
    assert len(set(held["background_sha256"].values())) == 1
    # What the mask leaves out is seen where the background is flipped, and only there.
    write_exr(sweep_input / "dark.exr", np.where(mask[..., None], light, np.nan), {})
    command = sweep_command(**options, ambient="dark.exr", out="other")
    line = refused(*command)
    assert "dark.exr: holds NaN or infinite values where the mask leaves the wall out" in line
    assert line.endswith("replace them, or give --no-flips")
    succeeds(*command, "--no-flips")
    # A mask that is its own mirror image leaves the same out of all flips.
    mask[-4:] = False
    np.save(sweep_input / "even.npy", mask)
    succeeds(*command, "--mask", "even.npy", "--out", "mirrored")


def test_own_method_is_told_the_mask(succeeds, sweep_input, sweep_command):
    (sweep_input / "mine.py").write_text(
        "import numpy as np\n"
        "class Mine:\n"
        "    def __init__(self, scenario, A, B, mask=None):\n"
        "        self.shape, self.left_out = (*scenario.hidden_shape, 3), (~mask).sum()\n"
        "    def reconstruct(self, photograph):\n"
        "        raise KeyError(f'{self.left_out} pixels left out')\n"
    )
    mask = np.ones((21, 21), bool)
    mask[3:5, 2:9] = False
    np.save(sweep_input / "mask.npy", mask)
    out = succeeds(*sweep_command(mask="mask.npy", methods="mine.py:Mine", sbr="1"))
    assert "14 pixels left out" in out


def test_sweep_warns_of_defective_pixels(periscopy, sweep_input, sweep_command):
    y = np.random.default_rng(2).normal(1.5, 0.02, (21, 21, 3))
    y[7, 8] = 0
    np.save(sweep_input / "y.npy", y)
    outcome = periscopy(*sweep_command(sbr="1", methods="truncated-svd"))
    assert outcome.code == 0 and outcome.err == (
        "periscopy: warning: y.npy: 0 saturated, 1 dead and 0 hot pixels, the first in row 7, "
        "column 8; leave them out by --mask FILE\n"
    )
