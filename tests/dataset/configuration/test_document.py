import re

import pytest
import yaml
from pydantic import ValidationError

from periscopy_sim.dataset.configuration.document import EXAMPLE, Configuration, load_configuration
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


def test_least_configuration_takes_the_defaults(tmp_path):
    found = load_configuration(written(tmp_path, LEAST))
    assert (found.count, found.hidden, found.seed) == (10, (3, 4), 0)
    assert found.light.kind == "direct" and found.splits.train == 0.8
    assert found.folder == tmp_path.resolve()


def test_example_is_a_configuration():
    found = load_configuration(EXAMPLE)
    assert {source.kind for source in found.hidden_images} >= {"shapes", "text", "moving"}


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
        (
            "colour: red",
            r"config.yaml: line 7, colour: is not known; there are seed, .*; see .*--example",
        ),
        (
            "light: {kind: direct, smaples: 4}",
            r"line 7, light.smaples: is not known; did you mean 'samples'\?$",
        ),
        ("7: 8", r"line 7, 7: is not known"),
        ("splits: {<<: {tarin: 1}}", r"line 7, splits.tarin: .* 'train'"),
        ("light: {samples: 4}", r"line 7, light: has no 'kind'; see"),
        ("light: 5", r"line 7, light: give entries"),
        ("sbr: {uniform: [1, 0]}", r"line 7, sbr: the interval .* runs backwards"),
        ("sbr: -1", r"line 7, sbr: every value must lie from"),
        ("snr: {normal: [60, 1]}", r"line 7, snr: every value must lie from -100 to 300"),
        ("seed: -1", r"line 7, seed: .*greater than or equal to 0"),
        ("seed: 1.5", r"line 7, seed: .*integer"),
        ("clip_length: 7", r"samples_per_shard \(50\) must be a multiple of clip_length \(7\)"),
        ("samples_per_shard: 30", r"samples_per_geometry \(1000\) must be a multiple"),
        ("splits: {train: 0.5}", r"line 7, splits: .* must sum to 1"),
        ("light: {kind: radiosity}", r"line 7, light: .*'direct'"),
        ("photograph_type: int8", r"line 7, photograph_type: .*'float32' or 'float16'"),
        ("count: 11", r"line 7: 'count' is given twice"),
        ("folder: x", r"'folder' is this file's own"),
        ("saturation: .inf", r"line 7, saturation: .*finite"),
        ("sbr: {uniform: [1, 2], choice: [1]}\nsnr: x", r"\(and 1 more\)"),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path, change, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_configuration(written(tmp_path, LEAST + change + "\n"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "size", ["29", "0x4", "29x", "29x36x3", "-2x3", "1e1x2", 5, [1, 2, 3], None]
)
def test_hidden_size_is_rows_times_columns(size):
    entries = {**yaml.safe_load(LEAST), "hidden": size}
    with pytest.raises(ValidationError, match="hidden"):
        Configuration.model_validate(entries)


@pytest.mark.parametrize("missing", ["count", "hidden", "scenes", "hidden_images", "ambient"])
def test_missing_entry_is_named(tmp_path, missing):
    text = "\n".join(line for line in LEAST.splitlines() if not line.startswith(missing))
    with pytest.raises(ConfigurationError, match=f"{missing}: is missing"):
        load_configuration(written(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("count", "cuont", r"line 2, cuont: is not known; did you mean 'count'\?$"),
        (
            "scene:",
            "scne:",
            r"line 4, the first of scenes, scne: is not known; did you mean 'scene'\?$",
        ),
        (
            "count: 10",
            "light: {kind: path-traced, bounce: 2}",
            r"line 2, light.bounce: .* 'bounces'\? \(and 1 more\)$",
        ),
    ],
)
def test_misspelt_entries_are_told_before_missing_ones(tmp_path, old, new, message):
    with pytest.raises(ConfigurationError, match=message):
        load_configuration(written(tmp_path, LEAST.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("scenes: [chair]", r"line 7, the first of scenes: give entries, NAME: VALUE$"),
        (
            "scenes: [{scene: chair, parameters: {a: [1]}}]",
            r"the first of scenes, parameters.a: .*\[numbers\]$",
        ),
        (
            "hidden_images: [{kind: folder, folder: a, flip: 5}]",
            r"line 7, the first of hidden_images \('folder'\), flip: Input should be a valid",
        ),
        (
            "hidden_images: [{kind: folder, folder: 5}]",
            r"line 7, the first of hidden_images \('folder'\), folder: Input should be a",
        ),
        (
            "hidden_images: [{kind: folder}]",
            r"line 7, the first of hidden_images \('folder'\), folder: is missing$",
        ),
        ("hidden_images: [{kind: shape}]", r": kind 'shape' is not known; there are 'shapes',"),
    ],
)
def test_one_mistake_is_counted_once(tmp_path, entry, message):
    kept = [line for line in LEAST.splitlines() if not line.startswith(entry.partition(":")[0])]
    with pytest.raises(ConfigurationError, match=message):
        load_configuration(written(tmp_path, "\n".join([*kept, "", entry])))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no entries"),
        ("- 1\n- 2", "holds no entries"),
        ("count: [1", "line 1: "),
        ("count: 1\n\tx: 2", "line 2: "),
        ("a: &a [*a]", "config.yaml"),
        (b"\xff\xfe\x00", "no text in UTF-8"),
        ("x: !!python/object/apply:os.system [ls]", "line 1: could not determine a constructor"),
        ("[" * 1000, "config.yaml"),
        ("{? [1, 2] : 3}", "config.yaml"),
        ("count: 2020-13-45", "config.yaml"),
        ("# " + "x" * (1 << 20), "larger than 128 KB"),
        ("a: &a {<<: *a}", "within its own anchor"),
        ("!!bool x", "cannot be read as YAML"),
        ("a: !!float " + ":".join(["1"] * 5000), "cannot be read as YAML"),
    ],
)
def test_what_is_no_configuration_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_configuration(written(tmp_path, text))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000


def test_aliases_that_multiply_do_not_use_up_memory(tmp_path):
    lines = ["a0: &a0 [1, 1]"] + [f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 60)]
    for text in (lines, [*lines, LEAST], [*lines, LEAST, "sbr: *a59"]):
        with pytest.raises(ConfigurationError, match="more than 65536 entries, aliases followed"):
            load_configuration(written(tmp_path, "\n".join(text)))


def test_merges_that_multiply_do_not_use_up_memory(tmp_path):
    lines = ["a0: &a0 {k: 1}"]
    lines += [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, 60)]
    with pytest.raises(ConfigurationError, match="more than 65536 entries"):
        load_configuration(written(tmp_path, "\n".join(lines)))


def test_merged_keys_stand_behind_those_given(tmp_path):
    merged = "light: {kind: direct}\nsplits:\n  <<: &s {train: 0.5, validation: 0.5}\n  test: 0\n"
    found = load_configuration(written(tmp_path, LEAST + merged))
    assert (found.splits.train, found.splits.validation, found.splits.test) == (0.5, 0.5, 0)
    again = "sbr: &s {uniform: [1, 2]}\nsnr: {<<: *s, uniform: [40, 60]}\n"
    found = load_configuration(written(tmp_path, LEAST + again))
    assert (found.sbr.uniform, found.snr.uniform) == ((1, 2), (40, 60))


def test_missing_file_and_folder_are_named(tmp_path):
    with pytest.raises(ConfigurationError, match="No such file"):
        load_configuration(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match="Is a directory"):
        load_configuration(tmp_path)
