import numpy as np
import pytest

from periscopy_sim.measurement import composite
from periscopy_sim.storage.rasters import read_exr

pytestmark = pytest.mark.usefixtures("jit")

PHOTO = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "16")
RNG = np.random.default_rng(11)
HIDDEN = RNG.random((4, 5, 3))
AMBIENT = np.linspace(1, 3, 24)[:, None, None] * RNG.uniform(0.9, 1.1, (24, 24, 3))


@pytest.fixture
def shoot(succeeds, tmp_path):
    """Take a photograph of HIDDEN and return its pixels."""
    np.save(tmp_path / "hidden.npy", HIDDEN)
    np.save(tmp_path / "ambient.npy", AMBIENT)

    def take(*options, image="hidden.npy"):
        succeeds("photograph", "chair", image, *PHOTO, *options, "--out", "y.exr")
        pixels, _ = read_exr(tmp_path / "y.exr")
        assert pixels.shape == (24, 24, 3) and np.isfinite(pixels).all()
        return pixels.astype(np.float64)

    return take


def test_photograph_is_written_with_its_settings(succeeds, tmp_path):
    arguments = ("photograph", "chair", "mushroom", *PHOTO, "--snr", "50", "--seed", "5")
    assert "new/y.exr" in succeeds(*arguments, "--out", "new/y.exr")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["y.exr"]
    pixels, metadata = read_exr(tmp_path / "new" / "y.exr")
    assert pixels.shape == (24, 24, 3) and pixels.dtype == np.float32
    assert metadata["image"] == "mushroom" and metadata["hidden"] == "4x5"
    assert (metadata["samples"], metadata["snr"], metadata["seed"]) == ("16", "50.0", "5")
    assert len(metadata["scene_sha256"]) == 64 and "sbr" not in metadata
    assert metadata["command"].startswith("periscopy photograph chair mushroom -D resolution=24")


def test_ambient_light_is_added_at_the_ratio_asked_for(shoot):
    signal, y = shoot(), shoot("--ambient", "ambient.npy", "--sbr", "0.2")
    np.testing.assert_allclose(y, composite(signal, AMBIENT, 0.2), rtol=1e-5)


def test_a_camera_mixes_the_scenes_light_not_its_own_photograph(shoot, refused, tmp_path):
    M = np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]])
    np.save(tmp_path / "m.npy", M)
    plain, signal = shoot(), shoot("--colour-matrix", "m.npy")
    np.testing.assert_allclose(signal, plain @ M.T, rtol=1e-5)
    y = shoot("--colour-matrix", "m.npy", "--ambient", "ambient.npy", "--sbr", "0.2")
    np.testing.assert_allclose(y, composite(signal, AMBIENT, 0.2), rtol=1e-5)
    np.save(tmp_path / "m.npy", np.eye(4, 3))
    options = "--colour-matrix", "m.npy", "--out", "four.exr"
    assert "m.npy: give three rows" in refused("photograph", "chair", "bars", *PHOTO, *options)


def test_impossible_light_is_refused(refused, tmp_path):
    np.save(tmp_path / "ambient.npy", AMBIENT)
    np.save(tmp_path / "dark.npy", -AMBIENT)
    np.save(tmp_path / "small.npy", AMBIENT[::2, ::2])
    for options, offender in [
        (("--ambient", "ambient.npy"), "--sbr"),
        (("--ambient", "overcas", "--sbr", "1"), "overcast'"),
        (("--ambient", "dark.npy", "--sbr", "1"), "dark.npy"),
        (("--ambient", "small.npy", "--sbr", "1"), "12 x 12"),
    ]:
        assert offender in refused(
            "photograph", "chair", "bars", *PHOTO, *options, "--out", "y.exr"
        )


SKY = ("ambient", "overcast", "--scene", "chair", "-D", "resolution=12", "--target", "0.01")


@pytest.mark.usefixtures("few_paths")
def test_light_is_rendered_once_and_kept_with_its_error(succeeds, monkeypatch, tmp_path):
    shown = succeeds(*SKY, "--seed", "5", "--out", "new/out")
    file = tmp_path / "new" / "out" / "overcast.exr"
    assert list(file.parent.iterdir()) == [file] and str(file.relative_to(tmp_path)) in shown
    picture, held = read_exr(file)
    assert picture.shape == (12, 12, 3) and picture.min() > 0
    assert picture.std() < 0.2 * picture.mean()  # a grey sky
    assert 0 < (held["relative_error"] ** 2 + held["brightness_error"] ** 2) ** 0.5 <= 0.01
    assert (held["ambient"], held["seed"], held["target"]) == ("overcast", "5", "0.01")
    assert held["scene"].endswith("chair.xml") and "12" in held["parameters"]
    assert {"variant", "mitsuba", "scene_sha256", "ambient_sha256"} <= held.keys()
    render = "periscopy_sim.rendering.ambient.render_background"
    monkeypatch.setattr(render, lambda *_, **__: pytest.fail("rendered again"))
    before = file.read_bytes()
    assert succeeds(*SKY, "--seed", "5", "--out", "new/out") == shown
    assert file.read_bytes() == before
