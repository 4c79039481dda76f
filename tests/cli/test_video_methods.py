"""`periscopy video --method`."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

NOISE_AWARE = ("--method", "noise-aware")


@pytest.fixture
def still(transport, scenario):
    return ps.NoiseAware.for_scene(scenario, transport, ps.point_light_backgrounds(scenario))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), {"coupling": "l1"}),
        (("--l1-weight", "3"), {"coupling": "l1", "l1_weight": 3.0}),
        (("--coupling", "none"), {"coupling": "none"}),
    ],
)
@pytest.mark.parametrize("batch", [2, 64])
def test_frames_are_those_of_the_noise_aware_video(
    options, settings, batch, photographs, still, video, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    frames, summary, table = video("y.npy", *NOISE_AWARE, *options, "--batch", batch)
    method = NoiseAwareVideo(still, **settings)
    expected = [method.solve_next(y) for y in photographs]
    images = np.array([found.image for found in expected])
    assert np.allclose(frames, images, rtol=1e-4, atol=1e-5 * images.max())
    assert [int(row["iterations"]) for row in table] == [found.iterations for found in expected]
    noise = [np.sqrt(np.mean(found.noise**2)) for found in expected]
    assert np.allclose([float(row["noise"]) for row in table], noise, rtol=1e-4)
    assert np.allclose([float(row["lambda"]) for row in table], [f.weight for f in expected])
    told = {"method": "noise-aware", "l1_weight": method.l1_weight, **settings}
    if settings["coupling"] == "none":
        del told["l1_weight"]
    assert {name: summary.get(name) for name in told} == told


def test_folder_tells_of_the_noise_aware_method_what_is_its_own(photographs, video, tmp_path):
    np.save(tmp_path / "y.npy", photographs)
    _, summary, table = video("y.npy", *NOISE_AWARE, "--truth", "bars")
    names = ["frame", "name", "seconds", "noise", "lambda", "iterations"]
    assert list(table[0]) == [*names, "mean_squared_error", "psnr"]
    assert set(summary["median"]) == set(table[0]) - {"frame", "name"}
    assert not {"repair_threshold", "background_rank", "explicit"} & summary.keys()
    settings = {"tv_weight": 0.02, "rank_tolerance": 1e-10, "l1_weight": 0.8}
    assert {name: summary[name] for name in settings} == settings
    assert min(summary["frames_per_second"].values()) > 0


def test_method_by_its_name_is_the_default_one(few_photographs, video, tmp_path):
    np.save(tmp_path / "y.npy", few_photographs)
    default, summary, _ = video("y.npy")
    named, other, _ = video("y.npy", *NOISE_AWARE)
    assert np.array_equal(default, named)
    assert summary["method"] == other["method"] == "noise-aware"
    paper, summary, _ = video("y.npy", "--method", "preconditioned")
    assert summary["method"] == "preconditioned"
    assert not np.allclose(paper, default, rtol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "magic"), "no method 'magic' for videos; use noise-aware or preconditioned"),
        (("--method", "iterative"), "no method 'iterative' for videos; use noise-aware or"),
        (
            (*NOISE_AWARE, "--coupling", "total-variation"),
            "--coupling total-variation belongs to --method preconditioned; noise-aware takes l1 "
            "or none",
        ),
        ((*NOISE_AWARE, "--temporal-weight", "1"), "--temporal-weight belongs to --coupling t"),
        (
            (*NOISE_AWARE, "--coupling", "none", "--l1-weight", "1"),
            "--l1-weight belongs to --coupling l1, not to none; leave it out",
        ),
        (
            (*NOISE_AWARE, "--repair-threshold", "0.1"),
            "--repair-threshold belongs to --method preconditioned, not to noise-aware; leave it",
        ),
        ((*NOISE_AWARE, "--tv-weight", "0"), "--tv-weight 0: --method noise-aware takes 1e-09 to"),
    ],
)
def test_option_of_the_other_method_is_refused(options, message, refused, tiny, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).uniform(1, 2, (2, 24, 24, 3)))
    assert message in refused("video", "y.npy", *tiny, *options, "--out", "out")


def test_photograph_that_is_not_finite_is_refused_by_its_frame(
    photographs, refused, tiny, tmp_path
):
    spoilt = photographs.copy()
    spoilt[4, 3, 2] = np.nan
    np.save(tmp_path / "y.npy", spoilt)
    assert "frame 4" in refused("video", "y.npy", *tiny, *NOISE_AWARE, "--out", "out")
