import math
from pathlib import Path
from typing import Any

import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.storage.yaml_document import Strict, read_yaml


class Document(Strict):
    folder: Path
    a: Any = None
    b: Any = None


@pytest.fixture
def read(tmp_path):
    """Read a text, or bytes, as a document."""

    def read(text, **settings):
        file = tmp_path / "a.yaml"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_yaml(file, Document, **settings)

    return read


# YAML 1.2, Sec. 10.3.
CORE = {
    "060": 60, "-7": -7, "0o17": 15, "0x1F": 31, "1e3": 1e3, ".5": 0.5, "5.": 5.0,
    "-.INF": -math.inf, "true": True, "False": False, "~": None, "": None, "'060'": "060",
    "!!str 5": "5", "1:2.5": "1:2.5", "1:9:3": "1:9:3", "0:0.05": "0:0.05",
    "yes": "yes", "off": "off",
}  # fmt: skip


def test_scalars_are_those_of_the_core_schema(read):
    for text, value in CORE.items():
        assert repr(read(f"a: {text}\n").a) == repr(value), text
        is_plain = not text.startswith(("'", "!"))
        assert read(f"a: {text}\n", as_texts=True).a == (text if is_plain else value), text


def test_an_entry_of_its_own_comes_before_a_merged_one(read):
    assert read("a: &x {p: 1, q: 2}\nb: {<<: *x, q: 3}").b == {"p": 1, "q": 3}


def test_faults_have_a_line(read):
    for text, line in (
        ("a: 1\n'a': 2", 2), ("a: 1\n---\nb: 2", 2), ("a:\n\tb: 1", 2),
        ("a: 1\nb: *x", 2), ("a: 1\nb: !!python/name:os.system x", 2), ("a: 1\nyes: 2", 2),
        ("a: [1,\n2", 2), ("b: {<<: 3}", 1),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=rf"a\.yaml.* line {line}\b") as caught:
            read(text)
        assert "\n" not in str(caught.value)
