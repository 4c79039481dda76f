"""The stand-in's light against closed forms and plain path tracing by Mitsuba."""

import re

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


@pytest.mark.slow
def test_all_light_together_equals_plain_path_tracing(modules, tmp_path, monkeypatch):
    """Up to six bounces, of the monitor's picture and of the room, within Monte Carlo error."""
    render = modules[1]
    monkeypatch.setattr(render, "PATHS", 4096)
    film = (16, 24)
    world = render.World(tmp_path, film, block=8)
    made = world.light()
    shown = np.ascontiguousarray(np.flipud(world.hidden)).astype(np.float32)
    mi.Bitmap(shown).write(str(tmp_path / "shown.exr"))
    bitmap = (
        '<texture type="bitmap" name="radiance"><string name="filename" value="shown.exr"/>'
        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/></texture>'
    )
    white, text = '<rgb name="radiance" value="1"/>', render.furnished()
    assert text.count(white) == 1
    lights = re.compile(r'(?<=<emitter type="area"><rgb name="radiance" value=")[^"]+')
    assert len(lights.findall(text)) == len(world.lights)
    scenes = {
        "monitor": lights.sub("0", text).replace(white, bitmap),
        "room": text.replace(white, white.replace("1", "0")),
    }
    replicas = 16
    for kind, scene in scenes.items():
        (tmp_path / "plain.xml").write_text(scene)
        plain = mi.load_file(str(tmp_path / "plain.xml"), height=film[0], width=film[1])
        path = mi.load_dict({"type": "path", "max_depth": render.BOUNCES + 1, "rr_depth": 1000})
        seen = np.array(
            [mi.render(plain, integrator=path, spp=1024, seed=k).numpy() for k in range(replicas)],
            float,
        )
        mean, error = seen.mean(0), seen.std(0, ddof=1) / replicas**0.5
        found = render.averaged(world.reflectance * made[kind], 8)
        if kind == "room":  # made to an SBR
            found *= mean.mean() / found.mean()
        # Errors of a mean of 16, each by its own spread: Student's t with 15 degrees of freedom
        # has the variance 15/13. The stand-in's own errors are a tenth of these.
        strays = (found - mean) / error
        assert found.mean() == pytest.approx(mean.mean(), rel=3e-3)
        assert np.sqrt((strays**2).mean()) < 1.1 * np.sqrt(15 / 13)
        assert abs(strays.mean()) < 0.15
