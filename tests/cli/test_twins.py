"""What a command writes, and what the same lines of Python return: the same bytes and words."""

import json
from pathlib import Path

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli import messages
from periscopy_sim.storage.rasters import read_exr

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

SIZE = ("-D", "resolution=24", "--hidden", "4x5")


def chair(dx=0, **options):
    return ps.load_scenario("chair", (4, 5), {"resolution": 24, "occluder_dx": dx}, **options)


@pytest.mark.usefixtures("few_paths")
def test_photograph(succeeds):
    light = ("--ambient", "overcast", "--sbr", "1", "--snr", "50", "--target", "0.05")
    succeeds("photograph", "chair", "mushroom", *SIZE, *light, "--seed", "3", "--out", "y.exr")
    scene = chair(seed=3)
    y = scene.photograph(scene.image("mushroom"), ambient="overcast", sbr=1, snr=50, target=0.05)
    written, metadata = read_exr(Path("y.exr"))
    np.testing.assert_array_equal(written, y.values.astype(np.float32))
    assert metadata["relative_error"] == f"{y.relative_error:.3g}"


@pytest.mark.parametrize("light", [ps.Light(), ps.Light(by="rays", samples=4)])
def test_transport(light, succeeds):
    ways = ("--model", "rendered", "--samples", "4") if light.samples else ()
    succeeds("transport", "chair", *SIZE, *ways, "--out", "A.npy")
    scene = chair(light=light)
    np.testing.assert_array_equal(np.load("A.npy"), scene.A)
    record = json.loads(Path("A.json").read_text())
    assert {n: record[n] for n in scene.plan().origin} == scene.plan().origin


@pytest.mark.parametrize(
    ("dx", "method"),
    [
        (0.03, "noise-aware"),
        pytest.param(0, "noise-aware", marks=pytest.mark.thorough),
        pytest.param(0.03, "truncated-svd", marks=pytest.mark.thorough),
    ],
)
def test_reconstruct(dx, method, succeeds, photographs):
    """Of a right scene and of a wrong one, which has a verdict and remedies."""
    np.save("y.npy", photographs[0])
    values = ("--scene", "chair", *SIZE, "-D", f"occluder_dx={dx}", "--method", method)
    succeeds("reconstruct", "y.npy", *values, "--out", "out")
    scene = chair(dx)
    y = ps.read_photograph("y.npy", scene.photograph_shape)
    fitted = scene.method(method, y)
    report = scene.judge(y, solution := fitted.solve(y), fitted)
    np.testing.assert_array_equal(
        np.load("out/reconstruction.npy"), solution.image.astype(np.float32)
    )
    if method == "noise-aware":
        errors = np.load("out/standard_error.npy")
        np.testing.assert_array_equal(errors, report.standard_errors.astype(np.float32))
    summary = json.loads(Path("out/summary.json").read_text())
    assert summary["verdict"] == messages.verdict(report, with_remedies=True)
    assert report.remedies or dx == 0
