"""The stand-in's light against closed forms and plain path tracing by Mitsuba."""

import numpy as np
import pytest

from tests.scenes.irradiance import polygon_irradiance

mi = pytest.importorskip("mitsuba")
pytestmark = pytest.mark.skipif(
    "llvm_ad_rgb" not in mi.variants(), reason="the stand-ins are rendered with LLVM"
)


@pytest.fixture(scope="module")
def modules():
    dr = pytest.importorskip("drjit")
    if not dr.has_backend(dr.JitBackend.LLVM):
        pytest.skip("needs LLVM")
    mi.set_variant("llvm_ad_rgb")
    from experiments.laboratories.making import light, render

    return light, render


def test_straight_light_of_a_rectangle_is_lamberts_closed_form(modules):
    light = modules[0]
    scene = mi.load_dict({"type": "scene"})
    across, up = np.array([-0.4, 0.05, 0]), np.array([0, 0.02, 0.3])
    normal = np.cross(across, up) / np.linalg.norm(np.cross(across, up))
    source = light.Source(np.array([0.2, 0, 0.1]), across, up, normal, np.full((3, 4, 3), 2.0))
    assert source.normal[1] > 0
    points = np.array([[0.0, 1.0, 0.2], [0.7, 0.9, -0.1], [-0.5, 0.4, 0.6]])
    wall = np.array([0.0, -1.0, 0.0])
    found = light.direct_irradiance(
        scene, mi.Point3f(points.T.astype(np.float32)), mi.Vector3f(0, -1, 0), source, (128, 128), 3
    )
    corners = source.corner + np.array([0 * across, across, across + up, up])
    known = [2 * polygon_irradiance(p + light.OFFSET * wall, wall, corners) for p in points]
    # Light varies by less than 5 times its mean across the source, so by 5 / 128 in a stratum:
    # 16384 strata leave at most 5 / 128 / sqrt(12 * 16384), 9e-5, as one standard deviation.
    np.testing.assert_allclose(found, np.repeat(np.array(known)[:, None], 3, 1), rtol=3e-4)
