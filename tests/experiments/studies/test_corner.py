import numpy as np
import pytest

import periscopy_sim as ps
from experiments.studies.corner import recovered_angles, write_photographs


@pytest.mark.thorough
def test_angles_come_back_from_a_floor_under_room_light(tmp_path):
    """Two bright sectors about a wall's end, at half the light of a lamp; the wall is masked."""
    scene = ps.load_scenario("corner", (1, 60), {"film": 93})
    truth = np.zeros(60)
    truth[8:14], truth[30:40] = 1.0, 0.5
    penumbra = (ps.transport(scene, noise=0.01) @ truth).reshape(93, 93)
    lamp = ps.point_light_backgrounds(scene)[:, 77].reshape(93, 93)
    ambient = 2 * penumbra.mean() / lamp.mean() * lamp
    rng = np.random.default_rng(0)
    for light in (penumbra, ambient):
        light += 5e-3 * penumbra.mean() * rng.standard_normal(light.shape)
        light[:4], light[:, 81:] = 0.1, 0.1
    np.savez(tmp_path / "light.npz", penumbra=penumbra, ambient=ambient)
    taken, mask = write_photographs(tmp_path / "light.npz", tmp_path / "out")
    assert mask.sum() == 89 * 81
    np.testing.assert_allclose(np.load(tmp_path / "out/sum.npy"), penumbra + ambient)
    for angles in recovered_angles(taken, mask).values():
        assert np.corrcoef(angles, truth)[0, 1] > 0.9
