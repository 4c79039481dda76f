import re

import numpy as np
import pytest

from periscopy_sim.cli import session
from periscopy_sim.measurement import Sensor
from periscopy_sim.storage.formats.exr import read_exr

pytestmark = pytest.mark.usefixtures("jit")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "16")
RNG = np.random.default_rng(11)
HIDDEN = RNG.random((4, 5, 3))
AMBIENT = np.linspace(1, 3, 24)[:, None, None] * RNG.uniform(0.9, 1.1, (24, 24, 3))


GRAINY = "the path tracing's own noise"


@pytest.fixture
def without_doubts(without_doubts):
    """Leave out, too, that photographs of so few samples are grainy."""
    return lambda warnings: [each for each in without_doubts(warnings) if GRAINY not in each]


@pytest.fixture
def shoot(succeeds, tmp_path):
    """Take a photograph of HIDDEN and return its pixels."""
    np.save(tmp_path / "hidden.npy", HIDDEN)
    np.save(tmp_path / "ambient.npy", AMBIENT)

    def take(*options, image="hidden.npy"):
        succeeds("photograph", "chair", image, *TINY, *options, "--out", "y.exr")
        pixels, _ = read_exr(tmp_path / "y.exr")
        assert pixels.shape == (24, 24, 3) and np.isfinite(pixels).all()
        return pixels.astype(np.float64)

    return take


def test_photograph_is_written_with_its_settings(succeeds, tmp_path):
    arguments = ("photograph", "chair", "mushroom", *TINY, "--snr", "50", "--seed", "5")
    assert succeeds(*arguments, "--out", "new/y.exr") == "wrote new/y.exr 24x24\n"
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["y.exr"]
    pixels, metadata = read_exr(tmp_path / "new" / "y.exr")
    assert pixels.shape == (24, 24, 3) and pixels.dtype == np.float32
    assert metadata["image"] == "mushroom" and metadata["hidden"] == "4x5"
    assert (metadata["samples"], metadata["snr"], metadata["seed"]) == ("16", "50.0", "5")
    assert len(metadata["scene_sha256"]) == 64 and "sbr" not in metadata
    assert metadata["command"].startswith("periscopy photograph chair mushroom -D resolution=24")


def test_ambient_light_is_added_at_the_ratio_asked_for(shoot):
    sbr = 0.2
    signal, y = shoot(), shoot("--ambient", "ambient.npy", "--sbr", sbr)
    parts = np.stack([signal.ravel(), AMBIENT.ravel()], axis=1)
    weights, _, rank, _ = np.linalg.lstsq(parts, y.ravel(), rcond=None)
    assert rank == 2 and np.allclose(parts @ weights, y.ravel(), rtol=1e-5)
    light, background = weights * parts.mean(axis=0)
    assert light / background == pytest.approx(sbr, rel=1e-4)
    assert y.mean() == pytest.approx(1, rel=1e-5)


def test_shipped_ambient_light_is_path_traced_by_its_name(shoot, refused, monkeypatch):
    from periscopy_sim.rendering.ambient import background

    render = background.render_background

    def quick(*scene, **options):
        return render(*scene, **{**options, "target": 0.2})

    monkeypatch.setattr(background, "render_background", quick)
    signal, y = shoot(), shoot("--ambient", "overcast", "--sbr", "0.5")
    rest = y - signal * (1 / 3 / signal.mean())
    assert rest.mean() == pytest.approx(2 / 3, rel=1e-3) and rest.min() > 0
    line = refused("photograph", "chair", "hidden.npy", *TINY, "--ambient", "overcas", "--sbr", "1",
                   "--out", "z.exr")  # fmt: skip
    assert "no such file or shipped condition; did you mean 'overcast'?" in line


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [("--snr", "40"), ("--electrons", "8000")])
def test_path_tracing_noisier_than_what_is_added_is_told(noise, shoot, periscopy):
    """Its size is that of the difference of two seeds; more samples than it names end it."""
    ambient = ("--ambient", "ambient.npy", "--sbr", "0.25")
    first, second = (shoot(*ambient, "--seed", seed) for seed in (1, 2))
    grain = np.std(first - second) / np.sqrt(2) / np.sqrt(np.mean(first**2))
    command = "photograph", "chair", "hidden.npy", *TINY, *ambient, *noise, "--out", "y.exr"
    outcome = periscopy(*command, "--seed", "1")
    (line,) = outcome.err.splitlines()
    told, samples = re.search(rf"{GRAINY} is ([0-9.]+) %.* --samples ([0-9]+)", line).groups()
    # From 1452 differences, of tails heavier than a normal variable's, which it leaves out.
    assert float(told) / 100 == pytest.approx(grain, rel=0.15)
    assert 0.7 < int(samples) / (16 * (grain / 0.01) ** 2) < 4
    assert not periscopy(*command, "--samples", 4 * int(samples)).err


EXPOSE = ("--electrons", "2000", "--frames", "4")


def test_sensor_exposes_the_photograph_and_is_recorded(succeeds, shoot, tmp_path):
    clean = shoot()
    said = succeeds("photograph", "chair", "hidden.npy", *TINY, *EXPOSE, "--out", "y.exr")
    pixels, metadata = read_exr(tmp_path / "y.exr")
    variance = (2000 + 2.5**2 + 0.5) / 4 / 2000**2  # the rounding's 0.5 is nearly nothing
    assert said == (
        "wrote y.exr 24x24\nsaturated 0 of 1728 values; "
        f"SNR {-10 * np.log10(variance):.1f} dB at mean light\n"
    )
    expected = Sensor(electrons=2000, frames=4).expose(clean, 0).values
    # The photograph was written in single precision: a rare photon falls otherwise.
    assert np.median(np.abs(pixels - expected)) < 1e-5 * clean.mean()
    assert metadata["electrons"] == "2000.0" and metadata["frames"] == "4"
    assert (metadata["read_noise"], metadata["full_well"]) == ("2.5", "10000.0")
    assert (metadata["bit_depth"], metadata["saturated"]) == ("12", "0")
    assert "snr" not in metadata


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--electrons", "100", "--snr", "60"), "--snr and --electrons both set the noise"),
        (("--frames", "2", "--snr", "60"), "expose it by --electrons MEAN"),
        (("--electrons", "20000"), "sensor: a mean of 20000 electrons a frame"),
    ],
)
def test_impossible_sensor_is_refused_before_rendering(options, message, refused, monkeypatch):
    monkeypatch.setattr(session, "load", None)
    assert message in refused("photograph", "chair", "bars", *TINY, *options, "--out", "y.exr")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--ambient", "ambient.npy"), "--ambient and --sbr go together"),
        (("--ambient", "dark.npy", "--sbr", "1"), "dark.npy: no value is positive"),
        (("--ambient", "small.npy", "--sbr", "1"), "12 x 12 pixels (rows x columns), but the"),
    ],
)
def test_impossible_light_is_refused(options, message, refused, tmp_path):
    np.save(tmp_path / "ambient.npy", AMBIENT)
    np.save(tmp_path / "dark.npy", -AMBIENT)
    np.save(tmp_path / "small.npy", AMBIENT[::2, ::2])
    assert message in refused("photograph", "chair", "bars", *TINY, *options, "--out", "y.exr")
