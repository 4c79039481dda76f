"""Each command on a scene of two hidden surfaces."""

import json
import re

import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from periscopy_sim.storage.rasters import write_exr
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


def test_reconstruct_writes_each_surface_by_its_id(scene, succeeds, summary, tmp_path):
    options = (*HIDDEN, *TRUTH, "--model", "analytic", "--out", "out")
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
        assert numbers["psnr"][name] > 40 and f"{numbers['psnr'][name]:.2f} dB" in out
    assert of_each("standard_error", "npy") < files


def test_wrong_surfaces_are_named(scene, refused):
    for options, offender in [
        (("--hidden", "3x4", "--hidden", "3x2"), "'monitor', 'hidden_card'; .* ID=ROWSxCOLUMNS"),
        (("--hidden", "monitor=3x4"), "'monitor', 'hidden_card'.*'hidden_card', too"),
        ((*HIDDEN, "--hidden", "card=1x1"), "'monitor', 'hidden_card', no 'card'"),
        (("--hidden", "3x4", "--hidden", "hidden_card=3x2"), "'3x4'"),
        ((*HIDDEN, "--hidden", "monitor=3x4"), "name each once"),
        (("--hidden", "monitor=3x4", "--hidden", "hidden_card=3"), "'3' is not a size"),
        ((*HIDDEN, "--truth", "monitor.npy"), "--truth monitor.npy: .* --truth hidden_card=..."),
        ((*HIDDEN, "--truth", "monitor=monitor.npy"), "--truth: .* hidden_card=..."),
    ]:
        line = refused("reconstruct", "y.npy", "--scene", scene, *options, "--out", "out")
        assert re.search(offender, line), line


def test_photograph_and_transport_are_of_both(scene, succeeds, tmp_path):
    two = ps.load_scenario(tmp_path / scene, SIZES)
    A = ps.transport(two)
    for lit in IDS:  # the other is black
        images = {name: image * (name == lit) for name, image in IMAGES.items()}
        for name, image in images.items():
            np.save(tmp_path / f"{name}.npy", image)
        shown = [word for name in IDS for word in ("--image", f"{name}={name}.npy")]
        succeeds("photograph", scene, *HIDDEN, *shown, "--samples", "64", "--out", "photo.exr")
        photograph = ps.read_photograph(tmp_path / "photo.exr", (24, 24)).values
        y = A @ two.hidden.vector(images)
        assert photograph.mean() == pytest.approx(y.mean(), rel=0.1)
    succeeds("transport", scene, *HIDDEN, "--out", "A.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "A.npy"), A)
    record = json.loads((tmp_path / "A.json").read_text())
    assert record["hidden_shape"] == {name: list(size) for name, size in SIZES.items()}
    options = ("--scene", scene, *HIDDEN, "--transport", "A.npy", "--out", "out")
    succeeds("reconstruct", "y.npy", *options)


def test_video_is_of_each_surface(scene, succeeds, summary, tmp_path):
    options = ("--scene", scene, *HIDDEN, *TRUTH, "--out", "out")
    out = succeeds("video", "frames.npy", *options)
    for name in IDS:
        frames = np.load(tmp_path / "out" / f"frames_{name}.npy")
        assert frames.shape == (2, *IMAGES[name].shape)
        assert ps.psnr_gain_matched(frames[1], IMAGES[name]) > 40
        assert (tmp_path / "out" / f"frames_{name}" / "0001.png").is_file()
        psnr = summary()["median"][f"psnr_{name}"]
        assert psnr > 40 and f"{psnr:.2f} dB" in out


def test_sweep_compares_methods_on_each_surface(scene, succeeds, tmp_path):
    write_exr(tmp_path / "lamp.exr", np.ones((24, 24, 3)), {})
    options = ("--sbr", "1,3", "--ambient", "lamp.exr", "--no-flips", "--methods", "noise-aware")
    run = ("sweep", scene, *HIDDEN, *TRUTH, "--photograph", "y.npy", *options, "--out", "out")
    out = succeeds(*run)
    results = xr.open_zarr(tmp_path / "out" / "sweep.zarr", consolidated=False)
    for name, size in SIZES.items():
        assert results[f"reconstruction_{name}"].squeeze().shape == (2, *size, 3)
        assert (results[f"psnr_{name}"] > 30).all() and f"mean PSNR of {name} " in out
    succeeds(*run)  # resumed


def test_data_set_has_images_of_each_surface(scene, succeeds, tmp_path):
    sizes = "{monitor: 3x4, hidden_card: 3x2}"
    (tmp_path / "data.yaml").write_text(
        f"{{count: 4, hidden: {sizes}, samples_per_geometry: 4, samples_per_shard: 2,\n"
        f" scenes: [{{scene: {scene}}}], hidden_images: [{{kind: smooth}}],\n"
        " ambient: [{kind: none}], snr: 60, light: {kind: direct}}\n"
    )
    succeeds("dataset", "data.yaml", "--out", "data.zarr")
    data = ps.open_dataset(tmp_path / "data.zarr")
    two = ps.load_scenario(tmp_path / scene, SIZES)
    A = two.transport(1e-3)
    images = {name: data[f"hidden_{name}"].values for name in IDS}
    for k, photograph in enumerate(data["photograph"].values):
        signal = A @ two.hidden.vector({name: each[k] for name, each in images.items()})
        exact = signal.reshape(24, 24, 3) * two.channel_gain * float(data["signal_scale"][k])
        assert np.linalg.norm(photograph - exact) < 2e-3 * np.linalg.norm(exact)  # of 1e-3 noise
    assert not np.allclose(images["monitor"][0, :, :2], images["hidden_card"][0])
    assert "'hidden_card': [3, 2]" in succeeds("dataset", "info", "data.zarr")
    succeeds("dataset", "export", "data.zarr", "--samples", "0", "--out", "out")
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {f"00000000_hidden_{name}.exr" for name in IDS} < files and "sheet.png" in files


def test_an_id_that_cannot_name_a_file_is_refused(scene, refused, tmp_path):
    text = (tmp_path / scene).read_text().replace('id="hidden_card"', 'id="hidden/card"')
    (tmp_path / scene).write_text(text)
    sizes = ("--hidden", "monitor=3x4", "--hidden", "hidden/card=3x2")
    assert "'hidden/card'" in refused(
        "reconstruct", "y.npy", "--scene", scene, *sizes, "--out", "o"
    )
