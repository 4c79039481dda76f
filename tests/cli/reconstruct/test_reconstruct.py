"""What is recovered from a photograph, and what the folder holds."""

import hashlib
import json
import time

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

PLAIN = ("--tv-weight", "0", "--repair-threshold", "1e9")  # P y alone
COUNTS = np.random.default_rng(21).integers(9000, 65536, (24, 24, 3)).astype(np.uint16)
PICTURES = {"reconstruction.png", "residual.png", "stages.png"}
FILES = {"reconstruction.npy", "summary.json"} | PICTURES


def test_the_noise_aware_method_is_the_default(light, tiny, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", sum(light))
    succeeds("reconstruct", "y.npy", *tiny, "--out", "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["method"] == "noise-aware"


def test_hidden_image_is_recovered_beside_ambient_light(light, reconstruct, hidden, tmp_path):
    signal, ambient = light
    np.save(tmp_path / "y.npy", signal + ambient)
    image, summary = reconstruct("y.npy", *PLAIN)
    assert image.shape == (4, 5, 3) and image.dtype == np.float32
    assert np.allclose(image, hidden, rtol=1e-4)
    # P y is of single precision, and the energy that it explains is taken from the whole: rounding,
    # of some units in the last place of the light that B leaves, passes for noise. Of the whole
    # signal, 20 times that light, half a unit is a bound.
    rounding = np.sqrt(np.finfo(np.float32).eps / 2 * np.mean(signal**2))
    assert max(summary["noise"]) < rounding


@pytest.mark.usefixtures("drawings")
def test_folder_holds_image_picture_stages_and_summary(
    light, succeeds, without_doubts, setting, tmp_path
):
    np.save(tmp_path / "y.npy", light[0])
    arguments = ("reconstruct", "y.npy", *setting, "--seed", "3", "--out", "new/out")
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
    fitting = {"transport matrix", "prototype backgrounds", "fit the method"}
    stages = {"load the scene", *fitting, "reconstruct"}
    seconds = summary["seconds"]
    assert set(seconds) == stages and seconds["transport matrix"] > 0
    assert sum(seconds.values()) < time.perf_counter() - start
    provenance = summary["provenance"]
    chair = hashlib.sha256(ps.find_scene("chair").read_bytes()).digest()
    assert provenance["scene_sha256"] == hashlib.sha256(chair).hexdigest()
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
    rendered = model == "rendered"
    A = ps.render_transport(scenario, samples=4) if rendered else ps.analytic_transport(scenario)
    A = A.astype(np.float64)
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


@pytest.mark.usefixtures("drawings")
@pytest.mark.parametrize("given", ["hidden.npy", "bars"])
def test_truth_adds_metrics_and_a_comparison(given, light, succeeds, setting, hidden, tmp_path):
    np.save(tmp_path / "y.npy", light[0] + np.random.default_rng(6).normal(0, 1e-4, (24, 24, 3)))
    np.save(tmp_path / "hidden.npy", hidden)
    truth = hidden
    if given == "bars":
        truth = ps.read_hidden_image(ps.find_image("bars"), (4, 5))
    out = succeeds("reconstruct", "y.npy", *setting, "--truth", given, "--out", "out")
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


def test_shift_against_the_truth_is_found(light, succeeds, setting, hidden, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    np.save(tmp_path / "lower.npy", np.concatenate([np.zeros((1, 5, 3)), hidden[:-1]]))
    arguments = ("reconstruct", "y.npy", *setting, *PLAIN, "--truth", "lower.npy", "--out", "out")
    assert "(shift (1.0, 0.0) patches down, right)" in succeeds(*arguments)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["shift"] == [1, 0] and summary["shift_at_limit"] is False
    assert summary["psnr_registered"] > 40 > summary["psnr"]


def test_shift_as_far_as_any_that_is_tried_is_told(light, succeeds, setting, hidden, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    np.save(tmp_path / "right.npy", np.pad(hidden, ((0, 0), (3, 0), (0, 0)))[:, :5])
    arguments = ("reconstruct", "y.npy", *setting, *PLAIN, "--truth", "right.npy", "--out", "out")
    assert "2.0) patches down, right: none farther is tried, so the image" in succeeds(*arguments)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["shift"][1] == 2 and summary["shift_at_limit"] is True
