import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.cli import inputs
from periscopy_sim.reconstruction.registry import METHODS

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

SCENE = ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5")
PAPER = ("--method", "preconditioned")
TINY = (*SCENE, "--samples", "4", *PAPER)
PLAIN = ("--tv-weight", "0", "--repair-threshold", "1e9")  # P y alone
RNG = np.random.default_rng(21)
HIDDEN = RNG.uniform(0.1, 1, (4, 5, 3))
COUNTS = RNG.integers(9000, 65536, (24, 24, 3)).astype(np.uint16)
SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "chair_mushroom.npz"
PICTURES = {"reconstruction.png", "residual.png", "stages.png"}
FILES = {"reconstruction.npy", "summary.json"} | PICTURES


@pytest.fixture(scope="module")
def light():
    """A photograph of HIDDEN as the scene's own matrix has it, without noise, and ambient light."""
    scenario = ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})
    A = ps.render_transport(scenario, samples=4).astype(np.float64)
    signal = A @ HIDDEN.reshape(20, 3)
    # A lamp 1 m to the left, 3 m before the wall and 1 m above the centre: one of the modelled.
    lamp = np.array([0.7435 - 1, 1.03 - 3, 0.2645 + 1])
    away = lamp - scenario.wall_points
    ambient = -away[:, 1] / np.linalg.norm(away, axis=1) ** 3
    ambient *= 5 * signal.mean() / ambient.mean()
    colour = [1.2, 1, 0.8]
    return signal.reshape(24, 24, 3), (ambient[:, None] * colour).reshape(24, 24, 3)


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    """Reconstruct from a file into `out`; return the image and the summary."""

    def run(photo, *options):
        succeeds("reconstruct", photo, *TINY, *options, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


def test_the_noise_aware_method_is_the_default(light, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", sum(light))
    succeeds("reconstruct", "y.npy", *SCENE, "--samples", "4", "--out", "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["method"] == "noise-aware"


# -- what is recovered and written ---------------------------------------------------------------


def test_hidden_image_is_recovered_beside_ambient_light(light, reconstruct, tmp_path):
    signal, ambient = light
    np.save(tmp_path / "y.npy", signal + ambient)
    image, summary = reconstruct("y.npy", *PLAIN)
    assert image.shape == (4, 5, 3) and image.dtype == np.float32
    assert np.allclose(image, HIDDEN, rtol=1e-4)
    assert max(summary["noise"]) < 1e-5 * signal.mean()  # P is of single precision


def test_folder_holds_image_picture_stages_and_summary(light, succeeds, without_doubts, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    arguments = ("reconstruct", "y.npy", *TINY, "--seed", "3", "--out", "new/out")
    start = time.perf_counter()
    out = succeeds(*arguments)
    folder = tmp_path / "new" / "out"
    assert {path.name for path in folder.iterdir()} == FILES
    assert out.startswith("wrote new/out/") and all(name in out for name in FILES)
    summary = json.loads((folder / "summary.json").read_text())
    expected = {
        "method": "preconditioned",
        "photograph": "y.npy",
        "photograph_shape": [24, 24],
        "hidden_shape": [4, 5],
        "model": "rendered",
        "transport": None,
        "samples": 4,
        "tv_weight": 1.0,
        "repair_threshold": 0.1,
        "rank_tolerance": 1e-10,
        "truth": None,
    }
    assert {name: summary[name] for name in expected} == expected
    # Of another seed, so few samples leave more than noise.
    assert without_doubts(summary["warnings"]) == []
    assert summary["background_rank"] > 3
    assert len(summary["noise"]) == len(summary["lambda"]) == 3 and summary["kappa"] > 0
    stages = {"load the scene", "transport matrix", "fit the method", "reconstruct"}
    seconds = summary["seconds"]
    assert set(seconds) == stages and seconds["transport matrix"] > 0
    assert sum(seconds.values()) < time.perf_counter() - start
    provenance = summary["provenance"]
    digest = hashlib.sha256()
    for file in (ps.find_scene("chair"), ps.find_scene("chair").parent / "meshes" / "chair.ply"):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    assert provenance["scene_sha256"] == digest.hexdigest()
    assert provenance["command"] == "periscopy " + " ".join(arguments).replace(" --out new/out", "")
    assert provenance["seed"] == 3 and provenance["parameters"] == {"resolution": "24"}
    assert {"periscopy-sim", "mitsuba", "numpy", "python", "variant"} <= set(provenance)
    for name in ("reconstruction.png", "stages.png"):
        with Image.open(folder / name) as picture:
            picture.load()
            assert picture.text["scene_sha256"] == provenance["scene_sha256"]


def test_picture_shows_the_array_upright_in_srgb(light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    image, _ = reconstruct("y.npy")
    with Image.open(tmp_path / "out" / "reconstruction.png") as picture:
        pixels = np.asarray(picture) / 255
    assert pixels.shape == (4 * 144, 5 * 144, 3)
    shown = pixels[72::144, 72::144]
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    inside = (shown > 0) & (shown < 1)
    scale = linear[inside] / image[inside]
    assert inside.mean() > 0.8 and scale.std() < 0.01 * scale.mean()


def test_folder_that_exists_keeps_its_other_files(light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    (tmp_path / "out" / "old").mkdir(parents=True)
    for name in ("notes.txt", "summary.json", "old/summary.json"):
        (tmp_path / "out" / name).write_text("old")
    _, summary = reconstruct("y.npy")
    assert summary["samples"] == 4
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"notes.txt", "old"}
    for name in ("notes.txt", "old/summary.json"):
        assert (tmp_path / "out" / name).read_text() == "old"


def test_same_command_gives_the_same_image_and_another_seed_does_not(light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    contents = []
    for seed in (0, 0, 1):
        reconstruct("y.npy", "--seed", seed)
        contents.append((tmp_path / "out" / "reconstruction.npy").read_bytes())
    assert contents[0] == contents[1] != contents[2]


def test_transport_file_serves_like_rendering(light, reconstruct, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    rendered, _ = reconstruct("y.npy")
    tiny = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
    succeeds("transport", "chair", *tiny, "--out", "A.npy")
    image, summary = reconstruct("y.npy", "--transport", "A.npy")
    assert np.array_equal(image, rendered)
    # Its samples are not known.
    assert (summary["model"], summary["transport"]) == ("file", "A.npy")
    assert summary["samples"] is None


@pytest.mark.parametrize("model", ["rendered", "analytic"])
def test_estimate_is_the_pseudoinverse_of_the_model_asked_for(model, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    options = ("--model", model, "--rank-tolerance", "1e-4", *PLAIN)
    image, summary = reconstruct("y.npy", *options)
    scenario = ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})
    render = {"rendered": ps.render_transport, "analytic": ps.analytic_transport}[model]
    A = render(scenario, samples=4).astype(np.float64)
    B = ps.point_light_backgrounds(scenario)
    U, σ, _ = np.linalg.svd(B / np.linalg.norm(B, axis=0), full_matrices=False)
    Q = U[:, σ > 1e-4 * σ[0]]
    expected = np.linalg.pinv(A - Q @ (Q.T @ A)) @ COUNTS.reshape(576, 3)
    assert np.allclose(image.reshape(20, 3), expected, rtol=1e-5, atol=1e-5 * expected.max())
    assert (summary["model"], summary["background_rank"]) == (model, Q.shape[1])


def test_weights_follow_their_options_and_the_noise(light, reconstruct, tmp_path):
    σ = 0.01 * light[0].mean()
    np.save(tmp_path / "y.npy", light[0] + np.random.default_rng(4).normal(0, σ, (24, 24, 3)))
    _, once = reconstruct("y.npy")
    _, thrice = reconstruct("y.npy", "--tv-weight", "3")
    plain, without = reconstruct("y.npy", *PLAIN)
    # Standard errors of at least 500 normal values; five are exceeded once in two million.
    assert np.allclose(np.array(once["noise"]) / σ, 1, atol=5 / np.sqrt(2 * 500))
    assert once["noise"] == thrice["noise"] == without["noise"]
    assert np.allclose(thrice["lambda"], 3 * np.array(once["lambda"])) and min(once["lambda"]) > 0
    assert without["lambda"] == [0, 0, 0]
    magnitude = np.linalg.norm(plain.astype(np.float64), axis=2)
    assert without["kappa"] == pytest.approx(1e9 * np.percentile(magnitude, 99), rel=1e-5)


@pytest.mark.parametrize("given", ["hidden.npy", "bars"])
def test_truth_adds_metrics_and_a_comparison(given, light, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", light[0] + np.random.default_rng(6).normal(0, 1e-4, (24, 24, 3)))
    np.save(tmp_path / "hidden.npy", HIDDEN)
    truth = HIDDEN
    if given == "bars":
        truth = ps.read_hidden_image(ps.find_image("bars"), (4, 5))
    out = succeeds("reconstruct", "y.npy", *TINY, "--truth", given, "--out", "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"comparison.png"}
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    image = np.maximum(np.load(tmp_path / "out" / "reconstruction.npy").astype(np.float64), 0)
    errors = []
    for channel in range(3):
        estimate, wanted = image[..., channel].ravel(), truth[..., channel].ravel()
        gain = np.linalg.lstsq(estimate[:, None], wanted, rcond=None)[0]
        errors.append(np.mean((np.clip(gain * estimate, 0, 1) - wanted) ** 2))
    assert summary["mean_squared_error"] == pytest.approx(np.mean(errors), rel=1e-4)
    assert summary["psnr"] == pytest.approx(-10 * np.log10(np.mean(errors)), abs=1e-3)
    assert summary["psnr_registered"] >= summary["psnr"] and len(summary["shift"]) == 2
    assert summary["truth"] == given
    assert f"gain-matched PSNR {summary['psnr']:.2f} dB" in out and "comparison.png" in out
    with Image.open(tmp_path / "out" / "comparison.png") as picture:
        picture.load()
        assert picture.width > picture.height


def test_shift_against_the_truth_is_found(light, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    np.save(tmp_path / "lower.npy", np.concatenate([np.zeros((1, 5, 3)), HIDDEN[:-1]]))
    arguments = ("reconstruct", "y.npy", *TINY, *PLAIN, "--truth", "lower.npy", "--out", "out")
    assert "(shift (1.0, 0.0) patches down, right)" in succeeds(*arguments)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["shift"] == [1, 0]
    assert summary["psnr_registered"] > 40 > summary["psnr"]


# -- other methods -------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [name for name in METHODS if name != "preconditioned"])
def test_other_method_writes_its_image_and_what_it_can_tell(method, light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    np.save(tmp_path / "hidden.npy", HIDDEN)
    image, summary = reconstruct("y.npy", "--method", method, "--truth", "hidden.npy")
    entry = METHODS[method]
    told = {"stages.png"} if method in ("truncated-svd", "pseudoinverse") else set()
    told |= {"certainty.png", "standard_error.npy"} if entry.certainty else set()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("reconstruction.npy", "reconstruction.png", "summary.json", "comparison.png"),
        "residual.png",
        *told,
    }
    assert summary["method"] == method
    options = {option.name: option.default for option in entry.options}
    assert {name: summary.get(name) for name in options} == options
    assert {"fit the method", "reconstruct"} <= set(summary["seconds"])
    # The others repair what they take for outliers in an image that is noise.
    assert summary["psnr"] > (25 if "differencing" in method else 10)
    default, _ = reconstruct("y.npy")
    assert not np.array_equal(image, default)


@pytest.mark.parametrize("method", [name for name in METHODS if name != "pseudoinverse"])
def test_weight_of_total_variation_reaches_every_method(method, light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", sum(light) * np.random.default_rng(3).normal(1, 0.01, (24, 24, 3)))
    option = next(o for o in METHODS[method].options if o.name == "tv_weight")
    images = [
        reconstruct("y.npy", "--method", method, "--tv-weight", factor * option.default)[0]
        for factor in (1, 30)
    ]
    changes = [np.abs(np.diff(image, axis=1)).mean() / np.abs(image).mean() for image in images]
    assert changes[1] < 0.8 * changes[0]


MINE = """
import sys
import numpy as np

class Mine:
    def __init__(self, scenario, A, B):
        self.shape = scenario.hidden_shape
        self.inverse = np.linalg.pinv(A.astype(np.float64))

    def reconstruct(self, photograph):
        return (self.inverse @ photograph.reshape(-1, 3)).reshape(*self.shape, 3)

class Wrong(Mine):
    def reconstruct(self, photograph):
        return photograph

class Raising(Mine):
    def reconstruct(self, photograph):
        raise RuntimeError("lost")

class Leaving(Mine):
    def reconstruct(self, photograph):
        sys.exit(0)

class Unfit:
    def __init__(self, scenario, A, B):
        self.shape = {}["no"]
"""
LOST, UNFIT = 'raise RuntimeError("lost")', 'self.shape = {}["no"]'


@pytest.mark.parametrize("place", ["mine.py", "mine_of_reconstruct", "deep/mine.py"])
def test_own_method_stands_in(place, light, reconstruct, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    (tmp_path / "deep").mkdir()
    for name in ("mine.py", "mine_of_reconstruct.py", "deep/mine.py"):
        (tmp_path / name).write_text(MINE)
    image, summary = reconstruct("y.npy", "--method", f"{place}:Mine")
    assert np.allclose(image, HIDDEN, rtol=1e-5)
    assert summary["method"] == f"{place}:Mine"
    assert summary["method_sha256"] == hashlib.sha256(MINE.encode()).hexdigest()


def test_own_method_that_breaks_its_promise_is_refused(refused, light, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    (tmp_path / "mine.py").write_text(MINE)
    number = {text.strip(): n for n, text in enumerate(MINE.splitlines(), 1)}
    for name, told in {
        "Wrong": "failed on y.npy: ValueError: returned shape (24, 24, 3) instead of (4, 5, 3)",
        "Raising": f"failed on y.npy: RuntimeError: lost (mine.py:{number[LOST]})",
        "Leaving": f"failed on y.npy: SystemExit: 0 (mine.py:{number['sys.exit(0)']})",
        "Unfit": f"cannot be fitted: KeyError: 'no' (mine.py:{number[UNFIT]})",
    }.items():
        method = f"mine.py:{name}"
        line = refused("reconstruct", "y.npy", *TINY, "--method", method, "--out", "out")
        assert line == f"method '{method}' {told}"


DERIVED = """
import numpy as np
from periscopy_sim import NoiseAware

class Leaving(NoiseAware):
    def stages(self, found):
        raise SystemExit(0)

class NaN(NoiseAware):
    def told(self, found):
        return {"share": float("nan")}

class Small(NoiseAware):
    def standard_errors(self, found):
        return np.ones((2, 2, 3))

class Flat(NoiseAware):
    def stages(self, found):
        return [("flat", np.ones(3))]

for kind in (Leaving, NaN, Small, Flat):
    globals()[f"fit_{kind.__name__}"] = kind.for_scene
"""


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Leaving", "SystemExit: 0 (derived.py:7)"),
        ("NaN", "ValueError: Out of range float values are not JSON compliant"),
        ("Small", "ValueError: cannot reshape array of size 12 into shape (4,5,3)"),
        ("Flat", "ValueError: returned shape (3,) instead of (4, 5, 3)"),
    ],
)
def test_derived_method_that_tells_what_it_may_not_is_refused(name, told, refused, light, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    (tmp_path / "derived.py").write_text(DERIVED)
    method = f"derived.py:fit_{name}"
    line = refused("reconstruct", "y.npy", *TINY, "--method", method, "--out", "out")
    assert line.startswith(f"method '{method}' failed on y.npy: {told}")


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "magic"), "no method 'magic'; use noise-aware, preconditioned, "),
        (("--method", "mine.py:Mine"), "there is no file mine.py"),
        (
            ("--method", "differencing", "--repair-threshold", "1"),
            "--repair-threshold belongs to --method preconditioned, truncated-svd or pseudoinverse,"
            " not to differencing; leave it out",
        ),
        (("--method", "noise-aware", "--tv-weight", "0"), "--method noise-aware takes 1e-09 to"),
        (("--method", "pseudoinverse", "--rank-tolerance", "1e-3"), "--rank-tolerance belongs to"),
        (("--method", "differencing", "--repair-threshold", "0.1"), "--repair-threshold belongs"),
        (("--model", "guessed"), "'guessed' is not one of 'rendered', 'analytic'"),
        (("--tv-weight", "-1"), "'--tv-weight'"),
        (("--tv-weight", "inf"), "'--tv-weight'"),
        (("--tv-weight", "heavy"), "'--tv-weight'"),
        (("--repair-threshold", "-1"), "'--repair-threshold'"),
        (("--repair-threshold", "inf"), "'--repair-threshold'"),
        (("--rank-tolerance", "0"), "'--rank-tolerance'"),
        (("--rank-tolerance", "1"), "'--rank-tolerance'"),
        (("--hidden", "24x24"), "full column rank"),
        (("--hidden", "24x25"), "24x25 hidden patches are more than the 24x24 pixels"),
        (("--scene", "sofa"), "'sofa' does not exist; name a file or a shipped scene: chair"),
        (("--truth", "sofa"), "'sofa' does not exist; name a file or a shipped image: bars"),
        (("--transport", "none.npy"), "none.npy: no such file"),
    ],
)
def test_impossible_option_is_refused(options, message, refused, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    assert message in refused("reconstruct", "y.npy", *TINY, *options, "--out", "out")


def test_place_that_cannot_be_written_is_refused_before_rendering(refused, monkeypatch, tmp_path):
    monkeypatch.setattr(inputs, "load", None)
    (tmp_path / "file").write_text("kept")
    for out in ("file", "file/new", "file/new/deep"):
        line = refused("reconstruct", "y.npy", *TINY, "--out", out)
        assert f"cannot write {out}: " in line


def test_folder_in_the_place_of_a_file_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    (tmp_path / "out" / "summary.json").mkdir(parents=True)
    line = refused("reconstruct", "y.npy", *TINY, "--out", "out")
    assert "summary.json: a folder of that name exists; remove it" in line


def test_photograph_of_another_scene_than_its_matrix_is_refused(refused, edited_scene, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    scene = edited_scene(('id="monitor"', 'id="screen"'))
    shutil.copy(scene, tmp_path / "mine.xml")
    line = refused("reconstruct", "y.npy", *TINY, "--scene", "mine.xml", "--out", "out")
    assert "'mine.xml' has no shape with id 'monitor'" in line


# -- the real photograph -------------------------------------------------------------------------


def best_psnr(estimate, truth):
    """Gain-matched PSNR after the best shift of at most 2 patches, in half patches."""

    def half_shifted(image, halves, axis):
        whole, half = divmod(halves, 2)
        padded = np.pad(image, [(3, 3) if axis == a else (0, 0) for a in range(3)])
        moved = np.roll(padded, whole, axis)
        moved = (moved + np.roll(moved, 1, axis)) / 2 if half else moved
        return np.take(moved, range(3, 3 + image.shape[axis]), axis)

    found = []
    for down in range(-4, 5):
        for right in range(-4, 5):
            moved = np.maximum(half_shifted(half_shifted(estimate, down, 0), right, 1), 0)
            gain = np.sum(moved * truth, axis=(0, 1)) / np.sum(moved**2, axis=(0, 1))
            found.append(np.mean((np.clip(gain * moved, 0, 1) - truth) ** 2))
    return -10 * np.log10(min(found))


@pytest.mark.skipif(not SHARED.is_file(), reason="the real photograph is not at hand")
def test_real_photograph_shows_the_mushroom_by_the_defaults(tmp_path):
    arguments = ("reconstruct", SHARED, "--scene", "chair", "--hidden", "29x36", "--truth", SHARED)
    ended = subprocess.run(
        [sys.executable, "-m", "periscopy_sim", *map(str, arguments), "--out", "out"],
        cwd=tmp_path,
        # Several threads of linear algebra wait for each other while other tests run.
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    warnings = [line for line in ended.stderr.splitlines() if "warning" in line]
    assert ended.returncode == 0 and len(warnings) == 1
    assert "the scene leaves 0.69 % of the photograph unexplained" in warnings[0]  # ruler's scene
    image = np.load(tmp_path / "out" / "reconstruction.npy").astype(np.float64)
    sent = np.load(SHARED)["hidden"] / 255
    truth = np.where(sent <= 0.04045, sent / 12.92, ((sent + 0.055) / 1.055) ** 2.4)
    psnr = best_psnr(image, truth)
    assert psnr >= 12.0
    assert psnr > best_psnr(image[:, ::-1], truth) + 0.5
    assert psnr > best_psnr(image[::-1], truth) + 0.5
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["psnr_registered"] == pytest.approx(psnr, abs=0.01)
