"""Meshes of one's own: their unit, axes and anchor, and files that are none."""

import struct

import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError, OutputError
from tests.laboratory.built.conftest import (
    CAMERA,
    MONITOR,
    POSITION,
    WALL,
    occluders,
    same_points,
    turned,
)

CORNERS = np.array([(100, 200, 10), (160, 200, 10), (100, 260, 10), (100, 200, 90)], "f4")
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


@pytest.fixture
def tent(tmp_path):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *c.ravel(), 0) for c in CORNERS[FACES])
    (tmp_path / "tent.stl").write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + rows)


@pytest.mark.usefixtures("tent")
@pytest.mark.parametrize(
    ("up", "axes"), [("z", ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
                     ("y", ((1, 0, 0), (0, 0, -1), (0, 1, 0))),
                     ("x", ((0, 1, 0), (0, 0, 1), (1, 0, 0)))],
)  # fmt: skip
@pytest.mark.parametrize("anchor", ["origin", "base", "center"])
def test_mesh_stands_in_metres_upright_at_its_anchor(built, up, axes, anchor):
    own = 0.001 * CORNERS.astype(float) @ np.transpose(axes)
    assert np.linalg.det(axes) == 1
    low, high = own.min(axis=0), own.max(axis=0)
    middle = {
        "origin": np.zeros(3),
        "center": (low + high) / 2,
        "base": np.array([*(low + high)[:2] / 2, low[2]]),
    }[anchor]
    more = f"file: tent.stl, unit: mm, up: {up}, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders("mesh", more)).occluders
    same_points(thing.vertices, turned(own - middle, -15, 25) + POSITION)


@pytest.mark.usefixtures("tent")
def test_files_that_are_given_are_not_written_over(built, tmp_path):
    more = "file: lab_thing.ply, unit: mm"
    (tmp_path / "lab_thing.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(ConfigurationError, match=r"lab_thing\.ply"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    built(WALL, CAMERA, MONITOR, occluders("mesh", "file: tent.stl, unit: mm"))
    before = (tmp_path / "lab_thing.ply").read_bytes()
    with pytest.raises(OutputError, match="it is one of the files given"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    assert (tmp_path / "lab_thing.ply").read_bytes() == before


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "is empty"), (b"solid x\nendsolid x\n", "has no faces"), (b"\0" * 90, "is cut short")],
)
def test_mesh_that_is_none_is_refused_and_nothing_is_written(built, tmp_path, content, said):
    (tmp_path / "bad.stl").write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"occluder 'thing': the file .*bad.stl' {said}"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", "file: bad.stl, unit: mm"))
    with pytest.raises(ConfigurationError, match="there is no file"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", "file: none.stl, unit: mm"))
    assert {path.name for path in tmp_path.iterdir()} == {"bad.stl", "lab.yaml"}
