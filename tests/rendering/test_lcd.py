"""The emitter against NumPy, in frames that the tests lay out by themselves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from periscopy_sim.rendering.variant import mi
from periscopy_sim.scene import EmissionProfile

WIDE = (np.eye(3), (0.4, 0.15))
TURNED = (Rotation.from_euler("xyz", [70, -20, 35], degrees=True).as_matrix(), (0.4, 0.15))
CENTER = np.array([0.3, -0.2, 0.5])
FRAMES = pytest.mark.parametrize(("axes", "scale"), [WIDE, TURNED])
EXPONENTS = (18.0, 1.0)


def screen(axes, scale, exponents=EXPONENTS, radiance=None, kind="lcd"):
    """A Mitsuba scene of one rectangle whose u, v and normal are the columns of `axes`."""
    to_world = np.eye(4)
    to_world[:3, :3] = axes * [*scale, 1]
    to_world[:3, 3] = CENTER
    emitter = {"type": kind, "radiance": radiance or {"type": "rgb", "value": 1.0}}
    if kind == "lcd":
        emitter |= {"vertical_exponent": exponents[0], "horizontal_exponent": exponents[1]}
    scene = mi.load_dict(
        {
            "type": "scene",
            "screen": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f(to_world),
                "emitter": emitter,
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
            },
        }
    )
    return scene, scene.shapes()[0]


def picture(values):
    """Texture of (rows, columns) grey radiances; row 0 at v = 0."""
    pixels = np.repeat(np.asarray(values, np.float32)[..., None], 3, axis=2)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    return bitmap | {"filter_type": "nearest", "wrap_mode": "clamp"}


def on_screen(axes, scale, uv):
    """World positions of UV coordinates (2, n)."""
    local = np.stack([scale[0] * (2 * uv[0] - 1), scale[1] * (2 * uv[1] - 1)])
    return CENTER[:, None] + axes[:, :2] @ local


def interaction(position):
    it = mi.SurfaceInteraction3f()
    it.p = mi.Point3f(*map(float, position))
    return it


@FRAMES
@pytest.mark.parametrize("exponents", [EXPONENTS, (0.0, 0.0), (0.0, 4.0)])
def test_radiance_follows_the_profile_about_the_screens_own_axes(axes, scale, exponents):
    scene, shape = screen(axes, scale, exponents)
    rng = np.random.default_rng(0)
    uv = rng.uniform(0.02, 0.98, (2, 4000))
    away = rng.normal(size=(3, 4000))
    away /= np.linalg.norm(away, axis=0)
    origin = on_screen(axes, scale, uv) + 0.7 * axes @ away
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(-(axes @ away)))
    seen = scene.ray_intersect(ray)
    assert np.all(seen.is_valid().numpy())
    radiance = np.array(shape.emitter().eval(seen))
    expected = EmissionProfile(*exponents)(*away)
    np.testing.assert_allclose(radiance, np.tile(expected, (3, 1)), rtol=2e-4, atol=1e-6)
    assert np.all(radiance[:, away[2] < 0] == 0)
    assert 1000 < (radiance[0] > 0).sum() < 3000


@FRAMES
@pytest.mark.parametrize("height", [-0.5, 0.0])
def test_no_light_is_sampled_from_behind_or_within_the_screens_plane(axes, scale, height):
    _, shape = screen(axes, scale)
    reference = CENTER + axes @ np.array([1.7, 1.2, height])
    draws = np.random.default_rng(5).random((2, 500)).astype(np.float32)
    ds, weight = shape.emitter().sample_direction(interaction(reference), mi.Point2f(draws))
    # Rounding may leave a point of the plane a little in front of it.
    assert np.all(np.isfinite(np.array(ds.pdf)))
    np.testing.assert_allclose(np.array(weight), 0, atol=1e-6)
    if height < 0:
        assert not np.array(ds.pdf).any()


def corner_scene(emitter):
    """A screen over a floor and beside a wall in the screen's own plane, all seen by a camera."""
    T = mi.ScalarTransform4f
    grey = {"type": "diffuse", "reflectance": 0.6}
    return mi.load_dict(
        {
            "type": "scene",
            "screen": {
                "type": "rectangle",
                "to_world": T().translate([0, 0, 0.3]).rotate([1, 0, 0], 90).scale([0.3, 0.3, 1]),
                "emitter": emitter,
                "bsdf": {"type": "diffuse", "reflectance": 0.05},
            },
            "floor": {"type": "rectangle", "bsdf": grey},
            "beside": {
                "type": "rectangle",
                "to_world": T().translate([1.3, 0, 1]).rotate([1, 0, 0], 90),
                "bsdf": grey,
            },
            "camera": {
                "type": "perspective",
                "fov": 50,
                "to_world": T().look_at(*VIEW),
                "film": {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}},
            },
        }
    )


VIEW = [0.3, -1.2, 0.6], [0.2, 0, 0.2], [0, 0, 1]
LCD = {"type": "lcd", "vertical_exponent": 18.0, "horizontal_exponent": 1.0}


ONCE = {"type": "path", "max_depth": 2}
BY_SCREEN = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
BY_SURFACE = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}


def render(scene, integrator, samples, seed=0):
    integrator = mi.load_dict(integrator)
    return np.array(mi.render(scene, integrator=integrator, spp=samples, seed=seed), np.float64)


def test_light_found_by_sampling_the_screen_the_surface_or_both_is_the_same(same_mean):
    scene = corner_scene(LCD | {"radiance": picture([[1.0, 4.0], [2.0, 0.5]])})
    by_screen, by_surface, by_both = (
        [render(scene, way, 1024, 100 * number + seed) for seed in range(12)]
        for number, way in enumerate([BY_SCREEN, BY_SURFACE, ONCE])
    )
    same_mean(by_screen, by_surface)
    same_mean(by_both, by_screen)
