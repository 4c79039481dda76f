import subprocess
import sys

import numpy as np
import pytest
import scipy.io

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.matlab import averaged_counts, bayer_colours
from periscopy_sim.storage.photographs import read_photograph

RAW = {"image": np.ones((8, 12)), "shutter_speed": 0.5, "iterations": 4.0}


def save(path, **fields):
    scipy.io.savemat(path, fields)
    return path


def test_raw_counts_become_colours_per_exposure_time(tmp_path):
    image = np.tile([[300, 190], [210, 100]], (6, 4)).astype(np.uint16)
    fields = {"image": image, "shutter_speed": 0.5, "iterations": 4, "ground_truth": "mushroom"}
    path = save(tmp_path / "raw.mat", **fields)
    photograph = read_photograph(path, (3, 2))
    assert np.allclose(photograph.values, np.array([300, 200, 100]) / 2)
    assert photograph.warnings == ()
    averaged = save(path, **fields, averaged_iterations=8)  # which count where both are there
    assert np.allclose(read_photograph(averaged, (3, 2)).values, np.array([300, 200, 100]) / 4)


def test_colours_and_means_are_those_of_a_slow_loop():
    counts = np.random.default_rng(1).integers(0, 999, (8, 12))
    colours = bayer_colours(counts)
    for row, column in np.ndindex(4, 6):
        cell = counts[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        expected = [cell[0, 0], (cell[0, 1] + cell[1, 0]) / 2, cell[1, 1]]
        assert np.array_equal(colours[row, column], expected)
    means = averaged_counts(colours, 1.0, (2, 3), "y")
    assert np.allclose(means[1, 2], colours[2:, 4:].mean(axis=(0, 1)))


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"image": np.ones((8, 12, 3))}, "'image'"),
        ({"image": np.ones((7, 12))}, "'image'"),
        ({"image": "photo"}, "'image'"),
        ({"shutter_speed": 0.0}, "'shutter_speed'"),
        ({"iterations": np.ones(2)}, "'iterations'"),
    ],
)
def test_fields_of_another_form_are_named(tmp_path, fields, name):
    with pytest.raises(PhotographError, match=rf"raw\.mat: .*{name}"):
        read_photograph(save(tmp_path / "raw.mat", **RAW | fields), (4, 6))


def test_a_reader_that_crashes_is_one_line(tmp_path, monkeypatch):
    crash = subprocess.run([sys.executable, "-c", "import os; os.abort()"], capture_output=True)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: crash)
    with pytest.raises(PhotographError, match=r"raw\.mat: cannot be read as MATLAB"):
        read_photograph(save(tmp_path / "raw.mat", **RAW), (4, 6))
