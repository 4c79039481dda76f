"""What the commands make of --background: photographs of the wall with the monitor off."""

import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.fitting.transport_matrix import AskedTransport

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
OFF = ("--background", "off.npy")


@pytest.fixture
def given(photographs, tmp_path):
    """Write photographs beside a lamp, and two of the lamp alone."""
    rng = np.random.default_rng(8)
    lamp = photographs.mean() * rng.uniform(0.5, 1.5, (24, 24, 3))
    noise = 0.002 * photographs.mean() * rng.normal(size=(2, 24, 24, 3))
    off, other = 3 * lamp + noise
    lit = photographs[:3] + lamp
    np.save(tmp_path / "y.npy", lit[0])
    np.save(tmp_path / "frames.npy", lit)
    np.save(tmp_path / "off.npy", off)
    np.save(tmp_path / "other.npy", other)
    return lit, off, other


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    def run(*options):
        succeeds("reconstruct", "y.npy", "--scene", "chair", *TINY, *options, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


def test_image_is_that_of_the_python_method(given, reconstruct, scenario, transport, clip):
    lit, off, other = given
    image, summary = reconstruct(*OFF, "--background", "other.npy")
    assert summary["backgrounds"] == ["off.npy", "other.npy"]
    B = ps.point_light_backgrounds(scenario)
    method = ps.NoiseAware.for_scene(scenario, transport, B, backgrounds=[off, other])
    np.testing.assert_allclose(image, method.reconstruct(lit[0]), rtol=1e-3, atol=1e-4)
    without, summary = reconstruct()
    assert summary["backgrounds"] == []
    assert ps.psnr(image, clip[0]) > ps.psnr(without, clip[0]) + 3


@pytest.mark.parametrize("method", ["preconditioned", "noise-aware"])
@pytest.mark.usefixtures("given")
def test_frames_are_those_of_the_python_method(method, succeeds, results, tiny, clip, tmp_path):
    errors = []
    for options in (OFF, ()):
        succeeds("video", "frames.npy", *tiny, "--method", method, *options, "--out", "out")
        frames, summary, _ = results(tmp_path / "out")
        assert summary["backgrounds"] == list(options[1:])
        errors.append([ps.mean_squared_error(*pair) for pair in zip(frames, clip, strict=False)])
    assert np.median(errors[0]) < 0.5 * np.median(errors[1])


@pytest.mark.usefixtures("given")
def test_analysis_projects_the_photograph_out(succeeds, tmp_path):
    records = []
    for options in (OFF, ()):
        succeeds("analyze", "chair", *TINY, *options, "--out", "analysis")
        records.append(json.loads((tmp_path / "analysis" / "summary.json").read_text()))
    assert records[0]["background_rank"] == records[1]["background_rank"] + 3
    assert records[0]["bound_ratio"] < records[1]["bound_ratio"] <= 1 + 1e-6
    assert records[0]["backgrounds"] == ["off.npy"]


@pytest.mark.thorough
@pytest.mark.usefixtures("sweep_input")
def test_sweep_gives_every_method_the_photograph(succeeds, refused, sweep_command, tmp_path):
    rng = np.random.default_rng(2)
    np.save(tmp_path / "off.npy", rng.uniform(1, 2, (21, 21, 3)))
    succeeds(*sweep_command(methods="preconditioned,mine.py:Mine", flips=None, no_flips=True))
    without = (tmp_path / "out" / "sweep.csv").read_text()
    options = {"methods": "preconditioned,mine.py:Mine", "background": "off.npy"}
    line = refused(*sweep_command(**options, flips=None, no_flips=True))
    assert "monitor_off" in line
    succeeds(*sweep_command(**options, flips=None, no_flips=True, out="other"))
    assert (tmp_path / "other" / "sweep.csv").read_text() != without


@pytest.mark.parametrize("command", [("reconstruct", "y.npy"), ("video", "frames.npy")])
@pytest.mark.usefixtures("given")
def test_what_is_no_background_photograph_is_refused_by_name(
    command, refused, tmp_path, monkeypatch
):
    monkeypatch.setattr(AskedTransport, "matrix", None)
    bad = {
        "small": np.ones((24, 23, 3)),
        "nan": np.where(np.arange(24) == 7, np.nan, 1.0)[:, None, None] * np.ones((24, 24, 3)),
        "black": np.zeros((24, 24, 3)),
    }
    for name, values in bad.items():
        np.save(tmp_path / f"{name}.npy", values)
    scene = ("--scene", "chair", *TINY, "--out", "out")
    for name, message in {
        "small": "24 x 23 pixels",
        "nan": "values are NaN",
        "black": "every value is zero",
        "missing": "no such file",
    }.items():
        line = refused(*command, *scene, *OFF, "--background", f"{name}.npy")
        assert f"{name}.npy: " in line and message in line
    line = refused(*command, *scene, *OFF, *OFF)
    assert line == "--background off.npy is given twice"


@pytest.mark.usefixtures("given")
def test_constant_photograph_and_the_photograph_itself_are_refused_by_name(refused, tmp_path):
    np.save(tmp_path / "flat.npy", np.full((24, 24, 3), 0.5))
    np.save(tmp_path / "copy.npy", 2 * np.load(tmp_path / "y.npy"))
    scene = ("--scene", "chair", *TINY, "--out", "out")
    line = refused("reconstruct", "y.npy", *scene, "--background", "flat.npy")
    assert "flat.npy: is the same everywhere" in line
    for command in (("reconstruct", "y.npy"), ("video", "frames.npy")):
        line = refused(*command, *scene, "--background", "copy.npy")
        assert "copy.npy: is the photograph itself; give one of the same wall" in line


@pytest.mark.parametrize(
    "command",
    [
        ("analyze", "chair"),
        ("reconstruct", "y.npy", "--scene", "chair", "--method", "differencing"),
        ("reconstruct", "y.npy", "--scene", "chair", "--method", "truncated-svd"),
    ],
    ids=lambda command: command[-1],
)
@pytest.mark.usefixtures("given")
def test_monitor_left_on_is_refused_whatever_the_method(command, refused, scenario, tmp_path):
    # By the matrix that each command renders: the noise of four random rays is no monitor's.
    strata = "gauss" if command[0] == "analyze" else "jittered"
    transport = ps.render_transport(scenario, samples=4, strata=strata)
    lit = (transport.astype(np.float64) @ np.eye(20)[:, 7]).reshape(24, 24, 1)
    np.save(tmp_path / "lit.npy", lit / lit.mean() + np.load(tmp_path / "off.npy") * 1e-3)
    line = refused(*command, *TINY, "--background", "lit.npy", "--out", "out")
    first, _, after = line.partition("; ")
    assert first == "lit.npy: still shows the monitor, which was on, or is the photograph itself"
    assert after.startswith("switch the monitor off") and "chair.xml" in after


@pytest.mark.usefixtures("given")
def test_photograph_with_the_monitor_off_is_doubted(periscopy, scenario, tmp_path):
    wall = 1 + 0.01 * np.random.default_rng(2).standard_normal((24, 24, 1))
    lamp = ps.point_light_backgrounds(scenario)[:, :1].reshape(24, 24, 1)
    noise = 1e-3 * np.random.default_rng(3).standard_normal((24, 24, 3))
    np.save(tmp_path / "dark.npy", wall * lamp / lamp.mean() + noise)
    outcome = periscopy("reconstruct", "dark.npy", "--scene", "chair", *TINY, "--out", "out")
    assert outcome.code == 0
    assert "dark.npy: the photograph hardly shows a hidden image: " in outcome.err
    told = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert any("hidden image: " in warning for warning in told)
