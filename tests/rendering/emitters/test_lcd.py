"""The emitter against NumPy, in frames that the tests lay out by themselves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from periscopy_sim.scenario import EmissionProfile

SQUARE = (np.eye(3), (1.0, 1.0))
WIDE = (np.eye(3), (0.4, 0.15))
TURNED = (Rotation.from_euler("xyz", [70, -20, 35], degrees=True).as_matrix(), (0.4, 0.15))
CENTER = np.array([0.3, -0.2, 0.5])
FRAMES = pytest.mark.parametrize(("axes", "scale"), [SQUARE, WIDE, TURNED])
EXPONENTS = (18.0, 1.0)


def screen(axes, scale, exponents=EXPONENTS, radiance=None, kind="lcd"):
    """A Mitsuba scene of one rectangle whose u, v and normal are the columns of `axes`."""
    import mitsuba as mi

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
    import mitsuba as mi

    pixels = np.repeat(np.asarray(values, np.float32)[..., None], 3, axis=2)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    return bitmap | {"filter_type": "nearest", "wrap_mode": "clamp"}


def on_screen(axes, scale, uv):
    """World positions of UV coordinates (2, n)."""
    local = np.stack([scale[0] * (2 * uv[0] - 1), scale[1] * (2 * uv[1] - 1)])
    return CENTER[:, None] + axes[:, :2] @ local


def integrals(axes, scale, reference, values, exponents=EXPONENTS, side=600):
    """Solid angle of the screen and of its light (radiance times profile), by fine midpoints."""
    middle = (np.arange(side) + 0.5) / side
    u, v = (grid.ravel() for grid in np.meshgrid(middle, middle))
    away = reference[:, None] - on_screen(axes, scale, np.stack([u, v]))
    across, up, normal = axes.T @ away
    distance = np.linalg.norm(away, axis=0)
    solid_angle = normal / distance**3 * (4 * scale[0] * scale[1] / side**2)
    rows, columns = values.shape
    shown = values[(v * rows).astype(int), (u * columns).astype(int)]
    light = shown * EmissionProfile(*exponents)(across, up, normal)
    return solid_angle.sum(), (light * solid_angle).sum()


def interaction(position):
    import mitsuba as mi

    it = mi.SurfaceInteraction3f()
    it.p = mi.Point3f(*map(float, position))
    return it


def assert_mean(samples, expected):
    """z-test at 5 standard errors (probability of a false alarm 6e-7)."""
    error = samples.std(ddof=1) / np.sqrt(samples.size)
    assert error < 0.01 * expected
    assert abs(samples.mean() - expected) < 5 * error


@FRAMES
@pytest.mark.parametrize("exponents", [EXPONENTS, (0.0, 0.0), (0.0, 4.0)])
def test_radiance_follows_the_profile_about_the_screens_own_axes(axes, scale, exponents):
    import mitsuba as mi

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
@pytest.mark.parametrize("values", [np.ones((1, 1)), np.array([[1.0, 4.0], [2.0, 0.5]])])
def test_sampled_light_and_density_integrate_over_the_screen(axes, scale, values):
    import mitsuba as mi

    _, shape = screen(axes, scale, radiance=picture(values) if values.size > 1 else None)
    reference = CENTER + axes @ np.array([0.5, 0.2, 0.9])
    draws = np.random.default_rng(2).random((2, 1 << 17)).astype(np.float32)
    ds, weight = shape.emitter().sample_direction(interaction(reference), mi.Point2f(draws))
    density = np.array(ds.pdf, np.float64)
    solid_angle, light = integrals(axes, scale, reference, values)
    assert_mean(1 / density, solid_angle)
    assert_mean(np.array(weight, np.float64)[0], light)


@FRAMES
def test_density_of_a_direction_that_met_the_screen_is_the_one_it_is_sampled_with(axes, scale):
    import mitsuba as mi

    values = np.array([[1.0, 4.0], [2.0, 0.5]])
    scene, shape = screen(axes, scale, radiance=picture(values))
    emitter = shape.emitter()
    reference = CENTER + axes @ np.array([0.5, 0.2, 0.9])
    it = interaction(reference)
    draws = np.random.default_rng(4).random((2, 2000)).astype(np.float32)
    ds, weight = emitter.sample_direction(it, mi.Point2f(draws))
    np.testing.assert_allclose(np.array(emitter.pdf_direction(it, ds)), np.array(ds.pdf), 1e-5)
    np.testing.assert_allclose(
        np.array(emitter.eval_direction(it, ds)), np.array(weight * ds.pdf), rtol=1e-5
    )
    # As a path tracer finds it: by a ray, its density from the geometry alone.
    seen = scene.ray_intersect(mi.Ray3f(it.p, ds.d))
    met = mi.DirectionSample3f(scene, seen, it)
    found = np.array(emitter.pdf_direction(it, met), np.float64)
    away = reference[:, None] - np.array(seen.p, np.float64)
    distance = np.linalg.norm(away, axis=0)
    cosine = axes[:, 2] @ away / distance
    uv = np.array(seen.uv)
    share = values / values.mean()
    on_texel = share[(uv[1] * 2).astype(int), (uv[0] * 2).astype(int)]
    expected = on_texel * distance**2 / (cosine * 4 * scale[0] * scale[1])
    inside = np.all(np.abs(uv - 0.5) > 1e-4, axis=0)
    np.testing.assert_allclose(found[inside], expected[inside], rtol=1e-4)


@FRAMES
@pytest.mark.parametrize("height", [-0.5, 0.0])
def test_no_light_is_sampled_from_behind_or_within_the_screens_plane(axes, scale, height):
    import mitsuba as mi

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
    import mitsuba as mi

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
    import mitsuba as mi

    integrator = mi.load_dict(integrator)
    return np.array(mi.render(scene, integrator=integrator, spp=samples, seed=seed), np.float64)


def test_light_found_by_sampling_the_screen_the_surface_or_both_is_the_same(same_mean):
    scene = corner_scene(LCD)
    by_screen, by_surface, by_both = (
        [render(scene, way, 1024, 100 * number + seed) for seed in range(12)]
        for number, way in enumerate([BY_SCREEN, BY_SURFACE, ONCE])
    )
    same_mean(by_screen, by_surface)
    same_mean(by_both, by_screen)
