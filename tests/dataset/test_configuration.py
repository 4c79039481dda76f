import re

import pytest
import yaml

from periscopy_sim.dataset.configuration import EXAMPLE, Configuration, load_configuration
from periscopy_sim.errors import ConfigurationError

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
    entries = yaml.safe_load(EXAMPLE.read_text("utf-8"))
    least = Configuration.model_validate(yaml.safe_load(LEAST))
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
    found = yaml.safe_load("\n".join(lines))
    kinds = [entry["kind"] for entry in found["hidden_images"] + found["ambient"]]
    assert {"folder", "conditions", "pictures"} <= set(kinds)
    Configuration.model_validate(found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("weather: fine", r"config.yaml: line 7, weather: is not known; there are seed, "),
        ("light: {kind: direct, smaples: 4}", r"line 7, light.smaples: .*'samples'\?$"),
        ("light: {samples: 4}", r"line 7, light: .*'kind'"),
        ("light: 5", r"line 7, light: "),
        ("sbr: {uniform: [1, 0]}", r"line 7, sbr: an interval runs backwards"),
        ("sbr: -1", r"line 7, sbr: every value must lie from"),
        ("seed: 1.5", r"line 7, seed: .*integer"),
        ("clip_length: 7", r"samples_per_shard \(50\) must be a multiple of clip_length \(7\)"),
        ("splits: {train: 0.5}", r"line 7, splits: .* must sum to 1"),
        ("folder: x", "config.yaml"),
        ("light: {}", r"line 7, light: .*'kind'"),
        ("saturation: .inf", r"line 7, saturation: .*finite"),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path, change, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_configuration(written(tmp_path, LEAST + change + "\n"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "", "- 1\n- 2", "count: [1", "count: 1\n\tx: 2", b"\xff\xfe\x00", "{? [1, 2] : 3}",
        "x: !!python/object/apply:os.system [ls]", "count: 2020-13-45", "!!bool x",
    ],
)  # fmt: skip
def test_what_is_no_configuration_is_refused_in_one_line(tmp_path, text):
    with pytest.raises(ConfigurationError, match=r"config\.yaml") as caught:
        load_configuration(written(tmp_path, text))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
