import re

import numpy as np
import pytest
from PIL import Image
from pydantic import TypeAdapter, ValidationError
from ruamel.yaml import YAML
from scipy import stats

from periscopy_sim.dataset import configuration
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.storage.yaml_document import Strict

KINDS = ["shapes", "moving", "text", "digits", "gratings", "smooth"]
SHAPES = [(29, 36), (36, 29), (1, 1), (1, 7), (5, 1), (2, 90)]


def source(**entries):
    return TypeAdapter(configuration.HiddenSource).validate_python(entries)


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
    covered = configuration._polygon(0.3 * circle + (0.7, 0.45), (40, 60))[..., 0]
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
        configuration.pictures_in(str(tmp_path))
    save(tmp_path / "black/x.png", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ConfigurationError, match="is black"):
        clip("folder", folder=str(tmp_path / "black"))
    (tmp_path / "bands").mkdir()
    np.save(tmp_path / "bands/x.npy", np.ones((4, 4, 5)))
    with pytest.raises(ConfigurationError, match="has 5 channels; give three, or one"):
        clip("folder", folder=str(tmp_path / "bands"))


LEAST = """
count: 10
hidden: 3x4
scenes: [{scene: chair}]
hidden_images: [{kind: shapes}]
ambient: [{kind: none}]
"""


def written(tmp_path, text):
    file = tmp_path / "config.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def test_defaults_that_the_example_shows_are_those_of_the_code():
    entries = YAML(typ="safe").load(configuration.EXAMPLE.read_text("utf-8"))
    least = configuration.Configuration.model_validate(YAML(typ="safe").load(LEAST))
    shown = configuration.Configuration.model_validate(entries)
    for name in ("seed", "samples_per_shard", "clip_length", "splits", "light", "sbr", "snr",
                 "exposure", "saturation", "photograph_type", "keep_background"):  # fmt: skip
        assert getattr(shown, name) == getattr(least, name), name
    assert re.search(
        r"samples_per_geometry: 250 .*\(default 1000\)", configuration.EXAMPLE.read_text("utf-8")
    )
    assert least.samples_per_geometry == 1000
    for sources in ("hidden_images", "ambient"):
        for given, source in zip(entries[sources], getattr(shown, sources), strict=True):
            plain = type(source).model_validate({"kind": source.kind})
            for name in set(given) - {"kind", "weight"}:
                default = getattr(plain, name)
                if default is not None:  # else it depends on the kind, and draw() has it
                    assert getattr(source, name) == default, (source.kind, name)


def test_what_the_example_leaves_in_comments_is_valid_too():
    text = configuration.EXAMPLE.read_text("utf-8")
    lines = [re.sub(r"^( +)# ( *[-a-z])", r"\1\2", line) for line in text.splitlines()]
    found = YAML(typ="safe").load("\n".join(lines))
    kinds = [entry["kind"] for entry in found["hidden_images"] + found["ambient"]]
    assert {"folder", "conditions", "pictures"} <= set(kinds)
    configuration.Configuration.model_validate(found)


MISTAKES = [
    ("weather: fine", r"config.yaml: line 7, weather: is not known; there are seed, "),
    ("light: {kind: direct, smaples: 4}", r"line 7, light.smaples: .*'samples'\?$"),
    ("light: {kind: rays}", r"line 7, light: kind 'rays' is unknown; there are 'direct'"),
    ("keep_background: maybe", r"line 7, keep_background: write true or false$"),
    ("photograph_type: float64", r"line 7, photograph_type: write 'float32' or 'float16'$"),
    ("clip_length: 0", r"line 7, clip_length: give at least 1$"),
    ("colour_matrix: []", r"line 7, colour_matrix: give at least 3 of them$"),
    ("sbr: {uniform: [1, 0]}", r"line 7, sbr: an interval runs backwards"),
    ("seed: 1.5", r"line 7, seed: write a whole number$"),
    ("snr: '60'", "line 7, snr.*number"),
    ("clip_length: 7", r"samples_per_shard \(50\) must be a multiple of clip_length \(7\)"),
    ("splits: {train: 0.5}", r"line 7, splits: .* must sum to 1"),
    ("light: {}", r"line 7, light: .*'kind'"),
    ("saturation: .inf", r"line 7, saturation: .*finite"),
]


def test_mistakes_are_told_with_their_line(tmp_path):
    for change, message in MISTAKES:
        with pytest.raises(ConfigurationError, match=message) as caught:
            configuration.load_configuration(written(tmp_path, LEAST + change + "\n"))
        assert "\n" not in str(caught.value) and "Input" not in str(caught.value)


def draws(drawn, count=4000):
    rng = np.random.default_rng(0)
    return np.array([drawn.draw(rng) for _ in range(count)])


def distribution_of(given):
    return configuration.Distribution.model_validate(given)


# Kolmogorov-Smirnov at 1e-4, one seed: each fails for a right distribution once in 10,000 seeds.
@pytest.mark.parametrize(
    ("given", "transform", "distribution"),
    [
        ({"uniform": [2, 5]}, None, stats.uniform(2, 3)),
        ({"log_uniform": [0.1, 10]}, np.log10, stats.uniform(-1, 2)),
        ({"normal": [1, 2]}, None, stats.norm(1, 2)),
    ],
)
def test_draws_follow_the_distribution(given, transform, distribution):
    values = draws(distribution_of(given))
    low, high = distribution_of(given).bounds
    assert low <= values.min() and values.max() <= high
    values = values if transform is None else transform(values)
    assert stats.kstest(values, distribution.cdf).pvalue > 1e-4


def test_every_choice_is_drawn_alike():
    values, counts = np.unique(draws(distribution_of({"choice": [1, 2, 7]})), return_counts=True)
    assert values.tolist() == [1, 2, 7] and stats.chisquare(counts).pvalue > 1e-4


def test_other_entries_are_rejected():
    for given in (
        {"uniform": [5, 2]}, {"log_uniform": [0, 2]}, {"normal": [0, -1]}, {"choice": []},
        {"uniform": [0, 1], "value": 1}, {}, float("nan"), {"uniform": [0, float("inf")]},
    ):  # fmt: skip
        with pytest.raises(ValidationError):
            distribution_of(given)


def test_quantities_that_could_leave_the_range_are_refused():
    class Model(Strict):
        share: configuration.within(0, 1)

    assert Model.model_validate({"share": {"uniform": [0, 1]}}).share.bounds == (0, 1)
    for given in (1.5, {"uniform": [0.5, 1.5]}, {"normal": [0.5, 0.1]}, {"choice": [0, -1]}):
        with pytest.raises(ValidationError, match="from 0 to 1"):
            Model.model_validate({"share": given})
