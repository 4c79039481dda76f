"""The table of failures: gains are paired, photograph by photograph."""

import numpy as np
import pytest

from experiments.learned import failures


@pytest.fixture(name="rows")
def two_photographs():
    psnr = {"noise-aware": (20.0, 30.0), "unrolled": (21.0, 28.0), "unet": (15.0, 15.0)}
    return [
        {"condition": "c", "geometry": 0, "image": str(image), "method": method,
         "psnr": value - 1, "registered": value}
        for method, values in psnr.items()
        for image, value in enumerate(values)
    ]  # fmt: skip


def test_gains_are_over_the_noise_aware_image_of_the_same_photograph(rows):
    assert sorted(failures.gains(rows, "c", "unrolled")) == [-2.0, 1.0]
    assert sorted(failures.gains(rows, "c", "unet")) == [-15.0, -5.0]
    assert not len(failures.gains(rows, "c", "adapted"))


def test_line_tells_means_and_their_standard_errors(rows):
    line = failures.line_of("c", rows)
    error = 1.5 * np.sqrt(2) / np.sqrt(2)
    assert line.startswith("| c | 2 | 25.0 |") and f"-0.50 ({error:.2f})" in line


def test_rows_are_read_as_they_were_written(rows, tmp_path):
    failures.write_rows(tmp_path / "f.csv", rows)
    assert failures.read_rows(tmp_path / "f.csv") == rows
    assert failures.read_rows(tmp_path / "none.csv") == []


def test_gains_are_drawn(rows, tmp_path):
    failures.draw_gains(rows, tmp_path / "gains.png")
    assert (tmp_path / "gains.png").is_file()
