import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.cli.session import PhotoSession, Session
from periscopy_sim.errors import PeriscopyError

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

CHAIR = ("chair", ["4x5"], ["resolution=24"])
MASK = np.random.default_rng(3).random((24, 24)) > 0.2
MASK[4:9, 10:18] = False
LEFT_OUT = int((~MASK).sum())
GARBAGE = np.resize([1e9, -1e30, np.nan, np.inf, 0.0], (24, 24, 3))


@pytest.fixture
def session(scenario, tmp_path, monkeypatch):
    """A session of the shared scene, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    session = PhotoSession(*CHAIR)
    session.scenario = scenario
    return session


@pytest.fixture
def saved(tmp_path):
    """Save arrays as NPY files; return the name of the first."""

    def save(**arrays):
        for name, array in arrays.items():
            np.save(tmp_path / f"{name}.npy", array)
        return tmp_path / f"{next(iter(arrays))}.npy"

    return save


def test_scene_without_shadows_is_warned_of(capfd):
    session = Session("chair", ["4x5"], ["resolution=24", "occluder_dy=-0.8"])
    session.check_scene()
    (line,) = session.warnings
    assert line.startswith("chair.xml: ") and line in capfd.readouterr().err


def test_photograph_is_black_where_the_mask_leaves_it_out(session, saved, photographs, tmp_path):
    Image.fromarray(MASK).save(tmp_path / "mask.png")
    y = photographs[0]
    session.mask = [tmp_path / "mask.png"]
    wall = session.wall(saved(y=np.where(MASK[..., None], y, GARBAGE)))
    np.testing.assert_array_equal(wall.values, np.where(MASK[..., None], y, 0))
    np.testing.assert_array_equal(wall.mask, MASK)
    assert session.record["pixels_left_out"] == LEFT_OUT and session.warnings == []


def test_defects_are_left_out_with_a_warning(session, saved, photographs, tmp_path):
    y = photographs[0].copy()
    y[11, 3], y[17, 20, 1] = 0, 0
    y[20, 5] *= 100
    path = saved(y=y, mask=MASK)
    for session.mask, used in ((None, np.ones_like(MASK)), ([tmp_path / "mask.npy"], MASK)):
        session.warnings.clear()
        wall = session.wall(path)
        assert len(session.warnings) == 1 and "y.npy" in session.warnings[0]
        expected = used.copy()
        expected[[11, 17, 20], [3, 20, 5]] = False
        np.testing.assert_array_equal(wall.mask, expected)
        assert session.record["pixels_left_out"] == np.count_nonzero(~expected)


@pytest.mark.parametrize("place", ["photograph", "mask", "monitor_off"])
def test_file_that_cannot_be_is_refused_by_name(session, saved, place):
    right, wrong = saved(right=np.ones((24, 24, 3))), saved(wrong=np.ones((24, 23)) > 0)
    if place != "photograph":
        setattr(session, place, [wrong])
    with pytest.raises(PeriscopyError, match=r"wrong\.npy: "):
        session.wall(wrong if place == "photograph" else right)


def test_monitor_off_photographs_are_projected_out(
    reconstruct, saved, photographs, scenario, transport, clip
):
    rng = np.random.default_rng(8)
    lamp = photographs.mean() * rng.uniform(0.5, 1.5, (24, 24, 3))
    off, other = 3 * lamp + 0.002 * photographs.mean() * rng.normal(size=(2, 24, 24, 3))
    y = photographs[0] + lamp
    saved(y=y, off=off, other=other)
    # By the former name, too.
    image, summary = reconstruct("y.npy", "--monitor-off", "off.npy", "--background", "other.npy")
    assert summary["backgrounds"] == ["off.npy", "other.npy"]
    B = ps.point_light_backgrounds(scenario)
    method = ps.NoiseAware.for_scene(scenario, transport, B)
    expected = method.reconstruct(ps.Photograph.of(y, monitor_off=[off, other]))
    np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-4)
    without, _ = reconstruct("y.npy")
    assert ps.psnr_gain_matched(image, clip[0]) > ps.psnr_gain_matched(without, clip[0]) + 3
