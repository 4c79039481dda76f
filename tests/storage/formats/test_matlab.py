import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.io.matlab

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.matfile import read_matrices
from periscopy_sim.storage.formats.matlab import bayer_colours
from periscopy_sim.storage.formats.table import format_of
from periscopy_sim.storage.photographs import read_photograph

RAW = {"image": np.ones((8, 12)), "shutter_speed": 0.5, "iterations": 4.0}


def save(path, **fields):
    scipy.io.savemat(path, fields)
    return path


def mosaic(red, green_beside_red, green_beside_blue, blue):
    return np.array([[red, green_beside_red], [green_beside_blue, blue]])


@pytest.mark.parametrize("dtype", [np.uint16, np.float64, np.float32, np.int32])
@pytest.mark.parametrize("compressed", [False, True])
def test_raw_counts_become_colours_per_exposure_time(tmp_path, dtype, compressed):
    image = np.tile(mosaic(300, 190, 210, 100), (6, 4)).astype(dtype)
    fields = {"image": image, "shutter_speed": 0.5, "iterations": 4, "ground_truth": "mushroom"}
    scipy.io.savemat(tmp_path / "raw.mat", fields, do_compression=compressed)
    photograph = read_photograph(tmp_path / "raw.mat", (3, 2))
    assert photograph.warnings == ()
    assert np.allclose(photograph.values, np.full((3, 2, 3), [150, 100, 50]), rtol=1e-15)


def test_averaged_exposures_are_counted_where_both_numbers_are_told(tmp_path):
    path = save(tmp_path / "raw.mat", **{**RAW, "averaged_iterations": 8.0})
    assert np.allclose(read_photograph(path, (2, 3)).values, 1 / (0.5 * 8))


def test_published_size_averages_each_block_where_it_stands(tmp_path):
    counts = np.random.default_rng(2).integers(0, 4096, (2016, 2016)).astype(np.uint16)
    path = save(tmp_path / "raw.mat", image=counts, shutter_speed=2.0, averaged_iterations=5.0)
    values = read_photograph(path, (126, 126)).values
    for row, column in [(0, 0), (125, 3), (17, 125), (60, 61)]:
        cells = counts[16 * row : 16 * row + 16, 16 * column : 16 * column + 16].astype(float)
        red = sum(cells[r, c] for r in range(0, 16, 2) for c in range(0, 16, 2)) / 64
        blue = sum(cells[r, c] for r in range(1, 16, 2) for c in range(1, 16, 2)) / 64
        green = (cells.sum() / 64 - red - blue) / 2
        assert np.allclose(values[row, column], np.array([red, green, blue]) / 10, rtol=1e-12)


def test_single_lit_sensor_pixel_lands_in_its_channel():
    counts = np.zeros((4, 4))
    counts[2, 1] = 8.0  # a green beside blue, in the lower left cell
    colours = bayer_colours(counts)
    assert colours[1, 0].tolist() == [0, 4, 0] and np.count_nonzero(colours) == 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"image": None}, "no field 'image', only shutter_speed, iterations"),
        ({"shutter_speed": None}, "no field 'shutter_speed'"),
        ({"iterations": None}, "no field 'iterations'"),
        ({"iterations": 0.0}, "'iterations' is not one positive number"),
        ({"iterations": [1.0, 2.0]}, "'iterations' is not one positive number"),
        ({"shutter_speed": np.nan}, "'shutter_speed' is not one positive number"),
        ({"shutter_speed": "fast"}, "'shutter_speed' is char"),
        ({"image": np.ones((8, 12), complex)}, "'image' is complex"),
        ({"image": np.ones((8, 12), bool)}, "'image' is logical"),
        ({"image": {"counts": 1}}, "'image' is struct"),
        ({"image": np.array([[1], ["a"]], dtype=object)}, "'image' is cell"),
        ({"image": scipy.sparse.csc_array(np.eye(8))}, "'image' is sparse"),
        ({"image": np.ones((8, 12, 3))}, "8, 12, 3"),
        ({"image": np.ones((7, 12))}, "7, 12"),
        ({"image": np.ones((0, 0))}, "0 x 0"),
        ({"image": np.zeros((8, 12))}, "zero"),
        ({"image": np.full((8, 12), np.inf)}, "row 0, column 0, channel 0"),
    ],
)
def test_fields_that_are_no_photograph_are_named(tmp_path, changes, said):
    fields = {name: value for name, value in (RAW | changes).items() if value is not None}
    with pytest.raises(PhotographError, match=said):
        read_photograph(save(tmp_path / "raw.mat", **fields), (2, 3))


def test_sizes_that_do_not_divide_are_both_said(tmp_path):
    with pytest.raises(PhotographError, match=r"4 x 6 .*3 x 3"):
        read_photograph(save(tmp_path / "raw.mat", **RAW), (3, 3))


def element(kind, body, order="<"):
    return struct.pack(f"{order}II", kind, len(body)) + body + bytes(-len(body) % 8)


def header(version=0x0100, order="<"):
    return (
        b"MATLAB".ljust(124) + struct.pack(f"{order}H", version) + {"<": b"IM", ">": b"MI"}[order]
    )


def test_big_endian_files_are_read(tmp_path):
    content = header(order=">")
    for name, values in {name: np.atleast_2d(v) for name, v in RAW.items()}.items():
        parts = [
            element(6, struct.pack(">II", 6, 0), ">"),
            element(5, struct.pack(">ii", *values.shape), ">"),
            element(1, name.encode(), ">"),
            element(9, values.astype(">f8").tobytes(order="F"), ">"),
        ]
        content += element(14, b"".join(parts), ">")
    (tmp_path / "raw.mat").write_bytes(content)
    assert np.allclose(read_photograph(tmp_path / "raw.mat", (4, 6)).values, 0.5)


def test_opaque_objects_are_refused(tmp_path):
    parts = [element(6, struct.pack("<II", 17, 0)), element(1, b"image"), element(1, b"MCOS")]
    (tmp_path / "raw.mat").write_bytes(header() + element(14, b"".join(parts)))
    with pytest.raises(PhotographError, match="'image' is opaque"):
        read_photograph(tmp_path / "raw.mat", (2, 3))


def test_element_that_overruns_its_tag_is_refused(tmp_path):
    flags, size = element(6, struct.pack("<II", 6, 0)), element(5, struct.pack("<ii", 1, 1))
    small = struct.pack("<HH", 1, 7) + b"image" + bytes(7)  # four bytes at most fit in the tag
    (tmp_path / "raw.mat").write_bytes(header() + element(14, flags + size + small))
    with pytest.raises(PhotographError, match="cut short 32 bytes in"):
        read_matrices(tmp_path / "raw.mat")


def test_compressed_variable_without_its_checksum_is_refused(tmp_path):
    scipy.io.savemat(tmp_path / "raw.mat", {"image": np.eye(4)})
    body = zlib.compress((tmp_path / "raw.mat").read_bytes()[128:])
    for cut, refused in ((body, False), (body[:-4], True)):
        content = header() + struct.pack("<II", 15, len(cut)) + cut
        (tmp_path / "packed.mat").write_bytes(content)
        if refused:
            with pytest.raises(PhotographError, match="cut short"):
                read_matrices(tmp_path / "packed.mat")
        else:
            assert np.array_equal(read_matrices(tmp_path / "packed.mat")["image"].values, np.eye(4))


def test_absurd_size_is_refused_before_it_is_allocated(tmp_path):
    parts = [
        element(6, struct.pack("<II", 6, 0)),
        element(5, struct.pack("<ii", 1 << 20, 1 << 20)),
        element(1, b"image"),
        element(9, b""),
    ]
    (tmp_path / "raw.mat").write_bytes(header() + element(14, b"".join(parts)))
    with pytest.raises(PhotographError, match="announces 1048576 x 1048576"):
        read_photograph(tmp_path / "raw.mat", (2, 3))


@pytest.mark.parametrize("start", [header(0x0200), b"\x89HDF\r\n\x1a\n" + bytes(600)])
def test_hdf5_files_are_refused_with_the_mend(tmp_path, start):
    (tmp_path / "raw.mat").write_bytes(start + bytes(512))
    with pytest.raises(PhotographError, match="-v7"):
        read_photograph(tmp_path / "raw.mat", (2, 3))


def test_files_by_matlab_itself_read_as_scipy_reads_them():
    folder = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    paths = [p for p in folder.glob("test*_[67]*.mat") if format_of(p).name == "MATLAB"]
    if not paths:
        pytest.skip("this SciPy comes without its test data")
    compared = 0
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = scipy.io.loadmat(path)
        matrices = read_matrices(path)
        assert set(matrices) == {name for name in expected if not name.startswith("__")}
        for name, matrix in matrices.items():
            if matrix.values is not None:
                assert np.array_equal(matrix.values, expected[name]), path
                compared += 1
    assert compared > 5


@pytest.mark.parametrize(
    ("image", "shutter_speed"),
    [
        (np.full((8, 12), 1e300), 1e-300),
        (np.full((8, 12), 1.7e308), 0.5),
        (np.frombuffer(b"\x01\x00\x80\x7f" * 96, "<f4").reshape(8, 12), 0.5),  # signalling NaN
        (np.tile([[np.inf, -np.inf], [-np.inf, np.inf]], (4, 6)), 0.5),
    ],
)
def test_counts_that_overflow_are_refused_without_a_warning(tmp_path, image, shutter_speed):
    path = save(tmp_path / "raw.mat", image=image, shutter_speed=shutter_speed, iterations=1.0)
    with pytest.raises(PhotographError, match="values are NaN or infinite"):
        read_photograph(path, (2, 3))
