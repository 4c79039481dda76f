"""`periscopy video --method`."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

NOISE_AWARE = ("--method", "noise-aware")


@pytest.fixture
def still(transport, scenario):
    return ps.NoiseAware.for_scene(scenario, transport, ps.point_light_backgrounds(scenario))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), {"coupling": "l1"}),
        (("--l1-weight", "3"), {"coupling": "l1", "l1_weight": 3.0}),
        (("--coupling", "none"), {"coupling": "none"}),
    ],
)
@pytest.mark.parametrize("batch", [2, 64])
def test_frames_are_those_of_the_noise_aware_video(
    options, settings, batch, photographs, still, video, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    frames, summary, table = video("y.npy", *NOISE_AWARE, *options, "--batch", batch)
    method = NoiseAwareVideo(still, **settings)
    expected = [method.solve_next(y) for y in photographs]
    images = np.array([found.image for found in expected])
    assert np.allclose(frames, images, rtol=1e-4, atol=1e-5 * images.max())
    assert [int(row["iterations"]) for row in table] == [found.iterations for found in expected]
    noise = [np.sqrt(np.mean(found.noise**2)) for found in expected]
    assert np.allclose([float(row["noise"]) for row in table], noise, rtol=1e-4)
    assert np.allclose([float(row["lambda"]) for row in table], [f.weight for f in expected])
    told = {"method": "noise-aware", "l1_weight": method.l1_weight, **settings}
    if settings["coupling"] == "none":
        del told["l1_weight"]
    assert {name: summary.get(name) for name in told} == told
