"""Camera raw files, written here as DNG: LibRaw reads them as it reads a camera's."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import read_sensor_image
from periscopy_sim.storage.tables import read_colour_matrix
from tests.scenes.dng import WHITE, write_dng

pytest.importorskip("rawpy")

RNG = np.random.default_rng(4)
MOSAIC = RNG.integers(700, 16000, (64, 96)).astype(np.uint16)
GBRG = (1, 2, 0, 1)


def test_corrections_that_are_not_applied_are_named_once(tmp_path):
    _, warnings = read_sensor_image(
        write_dng(tmp_path / "y.dng", MOSAIC, opcodes=[(51009, (9, 9)), (51022, (1, 3, 99))])
    )
    (line,) = warnings
    assert line.count("OpcodeList2") == line.count("OpcodeList3") == 1


def cells(mosaic):
    """The four pixels of each cell, in reading order."""
    return [mosaic[i::2, j::2].astype(float) for i in (0, 1) for j in (0, 1)]


def test_counts_come_back_linear_above_black_without_interpolation(tmp_path):
    exposure, warnings = read_sensor_image(write_dng(tmp_path / "y.dng", MOSAIC))
    red, green, other, blue = (cell - 512 for cell in cells(MOSAIC))
    expected = np.stack([red, (green + other) / 2, blue], axis=-1)
    assert np.array_equal(exposure.values, expected) and warnings == ()
    assert not exposure.saturated.any()


def test_each_place_of_the_mosaic_has_its_own_black_level_and_colour(tmp_path):
    path = write_dng(tmp_path / "y.dng", MOSAIC, black=(500, 510, 520, 530), pattern=GBRG)
    exposure, _ = read_sensor_image(path)
    green, blue, red, other = (
        cell - black for cell, black in zip(cells(MOSAIC), (500, 510, 520, 530), strict=True)
    )
    assert np.allclose(exposure.values, np.stack([red, (green + other) / 2, blue], axis=-1))


def test_a_monochrome_camera_gives_grey_at_full_size(tmp_path):
    path = write_dng(tmp_path / "y.dng", MOSAIC, photometric="minisblack")
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages.first.tags["PhotometricInterpretation"].overwrite(34892)  # LinearRaw
    exposure, _ = read_sensor_image(path)
    assert exposure.cell == 1
    assert np.array_equal(exposure.values, MOSAIC[..., None] - 512.0)


def test_a_full_pixel_saturates_its_cell(tmp_path):
    mosaic = MOSAIC.copy()
    mosaic[11, 20] = WHITE  # a green one, which the mean of two would hide
    exposure, _ = read_sensor_image(write_dng(tmp_path / "y.dng", mosaic))
    assert np.argwhere(exposure.saturated).tolist() == [[5, 10]]


def test_a_turned_camera_gives_an_upright_picture(tmp_path):
    for turn, quarters in [(3, 2), (6, 3), (8, 1)]:
        upright, _ = read_sensor_image(write_dng(tmp_path / "y.dng", MOSAIC))
        turned, _ = read_sensor_image(write_dng(tmp_path / "z.dng", MOSAIC, turn=turn))
        assert np.array_equal(turned.values, np.rot90(upright.values, quarters))


def test_a_raw_file_states_its_colours_for_an_srgb_monitor(tmp_path, monkeypatch):
    """Of a Nikon D3, from XYZ, as dcraw's table `adobe_coeff` has them, and sRGB's own."""
    camera = 8139, -2171, -663, -8747, 16541, 2295, -1925, 2008, 8093
    srgb = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    expected = np.reshape(camera, (3, 3)) / 1e4 @ srgb
    file = write_dng(tmp_path / "y.dng", MOSAIC, colours=camera)
    np.testing.assert_allclose(read_colour_matrix(file).matrix, expected, atol=1e-3)
    known = np.vstack([np.reshape(camera, (3, 3)) / 1e4, np.zeros((1, 3))])
    raw = SimpleNamespace(num_colors=3, rgb_xyz_matrix=known, color_matrix=np.zeros((3, 4)))
    monkeypatch.setattr("rawpy.imread", lambda _: nullcontext(raw))  # as of a Sony's ARW
    np.testing.assert_allclose(read_colour_matrix(file).matrix, expected, atol=1e-4)


def test_a_file_cut_short_is_refused_by_one_line(tmp_path):
    whole = write_dng(tmp_path / "y.dng", MOSAIC).read_bytes()
    for kept in (len(whole) - 1, len(whole) // 2, 300, 9):
        (tmp_path / "z.dng").write_bytes(whole[:kept])
        with pytest.raises(PhotographError) as caught:
            read_sensor_image(tmp_path / "z.dng")
        assert str(tmp_path / "z.dng") in str(caught.value) and "\n" not in str(caught.value)
