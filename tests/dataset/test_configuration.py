import re

import numpy as np
import pytest
from pydantic import ValidationError
from ruamel.yaml import YAML
from scipy import stats

from periscopy_sim.dataset.configuration import EXAMPLE, Configuration, load_configuration
from periscopy_sim.dataset.distributions import Distribution, within
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.storage.formats.yaml_document import Strict

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
    entries = YAML(typ="safe").load(EXAMPLE.read_text("utf-8"))
    least = Configuration.model_validate(YAML(typ="safe").load(LEAST))
    shown = Configuration.model_validate(entries)
    for name in ("seed", "samples_per_shard", "clip_length", "splits", "light", "sbr", "snr",
                 "exposure", "saturation", "photograph_type", "keep_background"):  # fmt: skip
        assert getattr(shown, name) == getattr(least, name), name
    assert re.search(r"samples_per_geometry: 250 .*\(default 1000\)", EXAMPLE.read_text("utf-8"))
    assert least.samples_per_geometry == 1000
    for sources in ("hidden_images", "ambient"):
        for given, source in zip(entries[sources], getattr(shown, sources), strict=True):
            plain = type(source).model_validate({"kind": source.kind})
            for name in set(given) - {"kind", "weight"}:
                default = getattr(plain, name)
                if default is not None:  # else it depends on the kind, and draw() has it
                    assert getattr(source, name) == default, (source.kind, name)


def test_what_the_example_leaves_in_comments_is_valid_too():
    text = EXAMPLE.read_text("utf-8")
    lines = [re.sub(r"^( +)# ( *[-a-z])", r"\1\2", line) for line in text.splitlines()]
    found = YAML(typ="safe").load("\n".join(lines))
    kinds = [entry["kind"] for entry in found["hidden_images"] + found["ambient"]]
    assert {"folder", "conditions", "pictures"} <= set(kinds)
    Configuration.model_validate(found)


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
            load_configuration(written(tmp_path, LEAST + change + "\n"))
        assert "\n" not in str(caught.value) and "Input" not in str(caught.value)


def draws(drawn, count=4000):
    rng = np.random.default_rng(0)
    return np.array([drawn.draw(rng) for _ in range(count)])


def distribution_of(given):
    return Distribution.model_validate(given)


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
        share: within(0, 1)

    assert Model.model_validate({"share": {"uniform": [0, 1]}}).share.bounds == (0, 1)
    for given in (1.5, {"uniform": [0.5, 1.5]}, {"normal": [0.5, 0.1]}, {"choice": [0, -1]}):
        with pytest.raises(ValidationError, match="from 0 to 1"):
            Model.model_validate({"share": given})
