"""Each command on a scene of two hidden surfaces."""

import json
import re

import numpy as np
import pytest

import periscopy_sim as ps
from tests.scenes.cards import HIDDEN, SIZES, write_cards

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

IDS = tuple(SIZES)
IMAGES = {
    name: np.stack([down, across, 0.7 - down], axis=-1)  # ramps
    for name, (rows, columns) in SIZES.items()
    for down, across in [np.mgrid[0.1 : 0.6 : rows * 1j, 0.1 : 0.9 : columns * 1j]]
}
TRUTH = tuple(word for name in IDS for word in ("--truth", f"{name}={name}.npy"))


@pytest.fixture
def scene(tmp_path):
    """A scene of two surfaces; beside it their images, and the photograph `y.npy` of these."""
    path = write_cards(tmp_path)
    two = ps.load_scenario(path, SIZES)
    y = (ps.transport(two) @ two.hidden.vector(IMAGES)).reshape(24, 24, 3)
    y = y + np.random.default_rng(9).normal(0, 1e-4 * y.mean(), y.shape)
    for name, values in {**IMAGES, "y": y, "frames": np.stack([y, y])}.items():
        np.save(tmp_path / f"{name}.npy", values)
    return path.name


@pytest.fixture
def summary(tmp_path):
    """Read the summary in `out`."""
    return lambda: json.loads((tmp_path / "out" / "summary.json").read_text())


def of_each(stem, *endings):
    return {f"{stem}_{name}.{ending}" for name in IDS for ending in endings}


@pytest.mark.usefixtures("drawings")
@pytest.mark.parametrize(
    ("method", "least"),
    [
        ("noise-aware", 40),
        ("iterative", 40),
        ("differencing", 40),
        ("preconditioned --tv-weight 0 --repair-threshold 1e9", 40),
        ("truncated-svd --tv-weight 0 --repair-threshold 1e9", 13),
    ],
)
def test_reconstruct_writes_each_surface_by_its_id(
    method, least, scene, succeeds, summary, tmp_path
):
    options = (*HIDDEN, *TRUTH, "--method", *method.split(), "--model", "analytic", "--out", "out")
    out = succeeds("reconstruct", "y.npy", "--scene", scene, *options)
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert of_each("reconstruction", "npy", "png") < files and "reconstruction.npy" not in files
    numbers = summary()
    assert numbers["hidden_shape"] == {name: list(size) for name, size in SIZES.items()}
    assert numbers["truth"] == {name: f"{name}.npy" for name in IDS}
    for name in IDS:
        image = np.load(tmp_path / "out" / f"reconstruction_{name}.npy")
        assert image.shape == IMAGES[name].shape
        assert ps.psnr_gain_matched(image, IMAGES[name]) == pytest.approx(
            numbers["psnr"][name], abs=1e-4
        )
        assert numbers["psnr"][name] > least and f"{name} against the truth: PSNR" in out
    if method == "noise-aware":
        assert of_each("standard_error", "npy") < files


def test_files_of_another_scene_do_not_stay(scene, succeeds, tmp_path):
    np.save(tmp_path / "one.npy", np.load(tmp_path / "y.npy"))
    plate = ("--scene", "plate", "-D", "resolution=24", "--hidden", "3x4", "--uncertain", "none")
    for options in (("--scene", scene, *HIDDEN), plate):
        succeeds("reconstruct", "y.npy", *options, "--out", "out")
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert "reconstruction.npy" in files
    assert not files & of_each("reconstruction", "npy", "png")


@pytest.mark.parametrize(
    ("options", "offender"),
    [
        (("--hidden", "3x4", "--hidden", "3x2"), "'monitor', 'hidden_card'; .* ID=ROWSxCOLUMNS"),
        (("--hidden", "monitor=3x4"), "'monitor', 'hidden_card'.*'hidden_card', too"),
        ((*HIDDEN, "--hidden", "card=1x1"), "'monitor', 'hidden_card', no 'card'"),
        (("--hidden", "3x4", "--hidden", "hidden_card=3x2"), "'3x4='"),
        ((*HIDDEN, "--hidden", "monitor=3x4"), "name each once"),
        (("--hidden", "monitor=3x4", "--hidden", "hidden_card=3"), "'3' is not a size"),
        ((*HIDDEN, "--truth", "monitor.npy"), "monitor.npy"),
        ((*HIDDEN, "--truth", "monitor=monitor.npy"), "--truth monitor=.* --truth hidden_card="),
        ((*HIDDEN, "--method", "unrolled"), "one hidden surface"),
    ],
)
def test_wrong_surfaces_are_named(options, offender, scene, refused):
    line = refused("reconstruct", "y.npy", "--scene", scene, *options, "--out", "out")
    assert re.search(offender, line), line


def test_photograph_and_transport_are_of_both(scene, succeeds, tmp_path):
    shown = [word for name in IDS for word in ("--image", f"{name}={name}.npy")]
    succeeds("photograph", scene, *HIDDEN, *shown, "--samples", "64", "--out", "photo.exr")
    photograph = ps.read_photograph(tmp_path / "photo.exr", (24, 24)).values
    y = np.load(tmp_path / "y.npy")
    assert photograph.mean() == pytest.approx(y.mean(), rel=0.1)
    succeeds("transport", scene, *HIDDEN, "--out", "A.npy")
    record = json.loads((tmp_path / "A.json").read_text())
    assert record["hidden_shape"] == {name: list(size) for name, size in SIZES.items()}
    options = ("--scene", scene, *HIDDEN, "--transport", "A.npy", "--out", "out")
    succeeds("reconstruct", "y.npy", *options)
