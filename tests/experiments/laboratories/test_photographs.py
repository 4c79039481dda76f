import csv
from dataclasses import replace

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    dr = pytest.importorskip("drjit")
    if not dr.has_backend(dr.JitBackend.LLVM):
        pytest.skip("the stand-ins are rendered with LLVM")
    pytest.importorskip("trimesh")
    from experiments.laboratories.making import render
    from experiments.laboratories.making.laboratory import LABORATORIES

    out = tmp_path_factory.mktemp("laboratories")
    small = replace(LABORATORIES["lamp"], block=2, points=(2, 3))
    patch = pytest.MonkeyPatch()
    patch.setattr(render, "PATHS", 256)
    patch.setattr(render, "MONITOR_RAYS", 1)
    patch.setattr(render, "LIGHT_RAYS", 4)
    folder = render.make(small, out)
    yield small, folder, out
    patch.undo()


def test_points_lie_on_the_wall_where_the_truth_sees_them(made):
    """By a pinhole's formula, from the scene file's numbers; six draws of a click and a ruler."""
    laboratory, folder, _ = made
    with (folder / "points.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert len(rows) == 6
    from experiments.laboratories.making.ruler import declared

    true = declared(laboratory.scene)
    origin = np.array([true[f"camera_{axis}"] for axis in "xyz"])
    ahead = np.array([true["aim_x"], 1.1, true["aim_z"]]) - origin
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0.7, 0.71])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    focal = 150 / np.tan(np.radians(11))
    for row in rows:
        assert row["y"] == pytest.approx(1.1)
        to = np.array([row["x"], row["y"], row["z"]]) - origin
        seen = np.array([150, 100]) + focal * np.array([to @ right, to @ down]) / (to @ ahead)
        # 0.3 pixels of the click and 1 mm of the ruler, here at most a pixel.
        assert np.hypot(*(seen - [row["column"], row["row"]])) < 4 * np.hypot(0.3, 0.6)
