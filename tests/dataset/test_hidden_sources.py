import numpy as np
import pytest
from PIL import Image
from pydantic import TypeAdapter

from periscopy_sim.dataset.hidden_sources import HiddenSource, _polygon, pictures_in
from periscopy_sim.errors import ConfigurationError

KINDS = ["shapes", "moving", "text", "digits", "gratings", "smooth"]
SHAPES = [(29, 36), (36, 29), (1, 1), (1, 7), (5, 1), (2, 90)]


def source(**entries):
    return TypeAdapter(HiddenSource).validate_python(entries)


def clip(kind, seed=0, shape=(29, 36), frames=1, **entries):
    drawn = source(kind=kind, **entries).draw(np.random.default_rng(seed), shape, frames)
    return np.broadcast_to(drawn, (frames, *shape, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_clips_are_light_within_0_and_1_with_some_in_every_frame(kind):
    for seed, shape in enumerate(3 * SHAPES):
        drawn = clip(kind, seed, shape, frames=3)
        assert drawn.shape == (3, *shape, 3)
        assert np.isfinite(drawn).all() and drawn.min() >= 0 and drawn.max() <= 1 + 1e-12
        assert (drawn.sum(axis=(1, 2, 3)) > 0).all()
        assert kind == "moving" or (drawn == drawn[0]).all()


def test_clip_follows_from_the_seed_alone():
    for kind in KINDS:
        np.testing.assert_array_equal(clip(kind, 3), clip(kind, 3))
        assert len({clip(kind, seed).tobytes() for seed in range(4)}) == 4


def test_a_disk_has_the_area_and_the_place_that_it_should():
    angle = 2 * np.pi * np.arange(400) / 400
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    covered = _polygon(0.3 * circle + (0.7, 0.45), (40, 60))[..., 0]
    y, x = (np.arange(40) + 0.5) / 40, (np.arange(60) + 0.5) / 40
    assert covered.sum() / 40**2 == pytest.approx(np.pi * 0.3**2, rel=0.02)
    assert (covered * x).sum() / covered.sum() == pytest.approx(0.7, abs=0.003)
    assert (covered * y[:, None]).sum() / covered.sum() == pytest.approx(0.45, abs=0.003)
    assert set(np.unique(covered)) - {0, 1}  # edges are averaged, not cut


def test_moving_shapes_move_by_their_speed_and_stay_in_the_image():
    still = clip("moving", 2, frames=5, speed=0)
    assert (still == still[0]).all()
    drawn = clip("moving", 2, frames=60, number=1, size=0.1, speed=0.03)
    weight = np.abs(drawn - np.median(drawn, axis=(1, 2), keepdims=True)).sum(axis=3)
    assert (weight.sum(axis=(1, 2)) > 0).all()  # also after many steps
    y, x = np.indices(weight.shape[1:]) / 29
    centre = np.stack([(weight * axis).sum(axis=(1, 2)) for axis in (x, y)], axis=1)
    centre /= weight.sum(axis=(1, 2))[:, None]
    steps = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    # At walls it turns round, and its edge leaves the image.
    assert np.median(steps) == pytest.approx(0.03, rel=0.05)


def test_text_fits():
    long = clip("text", 5, characters="W", length=30, height=0.9)[0]
    edge = np.concatenate([long[0], long[-1], long[:, 0], long[:, -1]])
    assert np.ptp(edge, axis=0).max() < np.ptp(long, axis=(0, 1)).max()


def test_gratings_have_the_periods_asked_for():
    for seed in range(8):
        image = clip("gratings", seed, (64, 64), periods=8, square=0)[0].sum(axis=2)
        spectrum = np.abs(np.fft.fft2(image - image.mean()))
        row, column = np.unravel_index(spectrum.argmax(), spectrum.shape)
        frequency = np.hypot(*(np.fft.fftfreq(64)[[row, column]] * 64))
        assert frequency == pytest.approx(8, abs=0.8)


def test_smooth_fields_are_smoother_for_larger_exponents_and_grey_without_saturation():
    def roughness(exponent):
        images = [clip("smooth", seed, exponent=exponent)[0] for seed in range(10)]
        return np.mean([np.abs(np.diff(image, axis=0)).mean() / image.std() for image in images])

    assert roughness(1.0) > 1.5 * roughness(3.0)
    grey = clip("smooth", 0, saturation=0)
    assert np.ptp(grey, axis=3).max() == pytest.approx(0, abs=1e-12)
    assert np.ptp(clip("smooth", 0, saturation=1), axis=3).max() > 0.2


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path)


def test_pictures_of_a_folder_are_all_drawn_and_flipped_if_asked(tmp_path):
    left = np.zeros((6, 8, 3), np.uint8)
    left[:, :4] = 255
    save(tmp_path / "a.png", left)
    save(tmp_path / "deep/b.PNG", np.full((6, 8, 3), 255, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    settings = {"shape": (3, 4), "folder": str(tmp_path)}
    pictures = [clip("folder", k, flip=True, **settings)[0, :, :, 0] for k in range(60)]
    kinds = {tuple(picture[0].tolist()) for picture in pictures}
    assert kinds == {(1, 1, 0, 0), (0, 0, 1, 1), (1, 1, 1, 1)}
    plain = [clip("folder", k, **settings)[0, 0, 0, 0] for k in range(20)]
    assert set(plain) == {1}


def test_folders_without_pictures_and_black_pictures_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="holds no pictures"):
        pictures_in(str(tmp_path))
    save(tmp_path / "black/x.png", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ConfigurationError, match="is black"):
        clip("folder", folder=str(tmp_path / "black"))
    (tmp_path / "bands").mkdir()
    np.save(tmp_path / "bands/x.npy", np.ones((4, 4, 5)))
    with pytest.raises(ConfigurationError, match="has 5 channels; give three, or one"):
        clip("folder", folder=str(tmp_path / "bands"))
