import json
import re

import pytest

from periscopy_sim.cli.options import parse_indices
from periscopy_sim.dataset.configuration import EXAMPLE
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.rasters import read_exr

pytestmark = pytest.mark.usefixtures("jit")

CONFIGURATION = {
    "count": 12,
    "hidden": "3x4",
    "samples_per_geometry": 6,
    "samples_per_shard": 3,
    "splits": {"train": 1.0, "validation": 0.0, "test": 0.0},
    "scenes": [{"scene": "plate", "parameters": {"resolution": 16}}],
    "hidden_images": [{"kind": "shapes"}],
    "ambient": [{"kind": "lamps"}],
}


@pytest.fixture
def configuration(tmp_path):
    """Write the configuration, with changes."""

    def write(**changes):
        (tmp_path / "config.yaml").write_text(json.dumps({**CONFIGURATION, **changes}))

    return write


def test_data_set_is_made_exported_mended_and_grows(succeeds, refused, configuration, tmp_path):
    configuration()
    make = "dataset", "config.yaml", "--out", "d.zarr"
    made = succeeds(*make)
    assert made.startswith("12 samples of 2 geometries, ")
    assert "\nto make: 2 matrices\nabout " in made
    assert "complete" in succeeds("dataset", "make", *make[1:])
    assert re.search("^samples +12$", succeeds("dataset", "info", "d.zarr"), re.MULTILINE)
    info = json.loads(succeeds("dataset", "info", "d.zarr", "--json"))
    assert (info["samples"], info["finished"], info["geometries"]) == (12, 12, 2)
    assert "7 files" in succeeds("dataset", "export", "d.zarr", "--samples", "0,7-8", "--out", "x")
    names = sorted(path.name for path in (tmp_path / "x").iterdir())
    assert len(names) == 7 and {"00000008_hidden.exr", "sheet.png"} <= {*names}
    image, notes = read_exr(tmp_path / "x/00000007_photograph.exr")
    assert image.shape == (16, 16, 3) and notes["hidden_kind"] == "shapes"
    assert float(notes["sbr"]) > 0
    file = tmp_path / "d.zarr/photograph/c/1/0/0/0"
    file.write_bytes(file.read_bytes()[:-1])
    lines = "samples 3 to 5 are missing or damaged\n"
    assert "d.zarr" in refused("dataset", "verify", "d.zarr", out=lines)
    grown = (*make, "--count", "15")
    assert succeeds(*grown).startswith("6 samples of 2 geometries, ")
    succeeds("dataset", "verify", "d.zarr")
    assert succeeds(*grown, "-q") == ""


def test_example_is_printed_as_it_stands_and_can_be_made(succeeds, tmp_path):
    assert succeeds("dataset", "--example") == EXAMPLE.read_text("utf-8")
    small = EXAMPLE.read_text("utf-8").replace("resolution: 126 ", "resolution: 24 ")
    small = small.replace("29x36", "4x5").replace("resolution: 126\n", "resolution: 24\n")
    small = (
        small.replace("train: 0.8", "train: 1").replace("n: 0.1", "n: 0").replace("t: 0.1", "t: 0")
    )
    (tmp_path / "small.yaml").write_text(small)
    assert "3 samples" in succeeds("dataset", "small.yaml", "--out", "d.zarr", "--count", "3")


def test_lists_of_samples_are_read():
    for text, expected in ("1, 3", [1, 3]), ("2-4", [2, 3, 4]), ("8-9", [8, 9]), ("0,0", [0]):
        assert parse_indices(text, 10) == expected
    for wrong in ("", "3-1", "1,,2", "1.5", "9" * 30, "8-10", "10", "0-999999999999", "\u0663"):
        with pytest.raises(PeriscopyError):
            parse_indices(wrong, 10)


def test_missing_configuration_is_refused(refused):
    for arguments in [["--out", "d.zarr"], ["none.yaml", "--out", "d.zarr"]]:
        assert ".yaml" in refused("dataset", *arguments)
