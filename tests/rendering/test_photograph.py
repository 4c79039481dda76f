import numpy as np
import pytest

from periscopy_sim.analytic.point_light import point_light_response
from periscopy_sim.rendering import photograph
from periscopy_sim.rendering.load import build_scene
from periscopy_sim.rendering.photograph import path_trace, render_photograph
from periscopy_sim.rendering.variant import mi
from periscopy_sim.scenario import load_scenario
from tests.scenes.lamps import scene_of

GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf>'


def point_light(x, y, z, intensity="1"):
    return (
        f'<emitter type="point"><point name="position" value="{x}, {y}, {z}"/>'
        f'<rgb name="intensity" value="{intensity}"/></emitter>'
    )


def field_of_view(rows, columns):
    """Centres of the room's pixels."""
    side = 0.4 / columns
    x = 0.7 + side * (np.arange(columns) - (columns - 1) / 2)
    z = 0.3 - side * (np.arange(rows) - (rows - 1) / 2)
    return np.array([[a, 1, c] for c in z for a in x])


def trace(path, depth, samples):
    return path_trace(scene_of(path), depth, samples=samples, seed=0)


@pytest.mark.parametrize("light", [(0.1, -0.4, 1.2), (0.75, 0.0, 0.25), (-2.0, -4.0, 3.0)])
def test_point_emitter_lights_the_wall_by_equation_4(room, light):
    path = room.write(point_light(*light, intensity="2"), monitor="", camera=room.camera((48, 48)))
    picture = trace(path, 2, 400)
    response = point_light_response(
        np.array([light]), field_of_view(48, 48), np.array([0, -1.0, 0])
    )
    # Albedo 0.5, intensity 2.
    expected = (0.5 / np.pi * 2 * response).reshape(48, 48, 1)
    np.testing.assert_allclose(picture, np.tile(expected, 3), rtol=2e-4)


def test_same_seed_gives_the_same_bytes_and_another_seed_others(room):
    seen, image = room.load(), np.ones((2, 3, 3))
    first, again, other = (
        render_photograph(seen, image, samples=16, seed=seed) for seed in (7, 7, 8)
    )
    assert first.shape == (5, 6, 3)
    assert first.dtype == np.float64
    assert first.tobytes() == again.tobytes()
    assert np.all(first != other)


@pytest.mark.parametrize(("bounces", "terms"), [(1, 1), (2, 2), (4, 4), (None, np.inf)])
def test_light_in_an_integrating_sphere_grows_by_the_geometric_series(room, bounces, terms):
    """A small patch on a sphere lights all of it alike, and so does the sphere itself."""
    sphere = (
        f'<shape type="sphere" id="wall">{GREY}<boolean name="flip_normals" value="true"/></shape>'
    )
    side = 0.06
    depth = np.sqrt(1 - side**2 / 2)  # its corners touch the sphere
    patch = (
        '<shape type="rectangle" id="monitor"><transform name="to_world">'
        f'<scale value="{side / 2}"/><translate z="{-depth}"/></transform>'
        f"{room.area}{room.black}</shape>"
    )
    camera = (
        '<sensor type="orthographic" id="camera"><transform name="to_world">'
        '<scale x="0.3" y="0.3"/><lookat origin="0, 0, 0" target="0, 1, 0.2" up="0, 0, 1"/>'
        '</transform><film type="hdrfilm"><integer name="width" value="4"/>'
        '<integer name="height" value="4"/></film></sensor>'
    )
    seen = room.load(wall=sphere, monitor=patch, camera=camera, hidden=(1, 1))
    picture = render_photograph(seen, np.ones((1, 1, 3)), samples=100**2, bounces=bounces)
    share = side**2 / (4 * np.pi)  # of the sphere, by the black screen
    kept = 0.6 * (1 - share)
    direct = 0.6 * share
    expected = direct * (1 - kept**terms) / (1 - kept)
    assert picture.mean() == pytest.approx(expected, rel=3e-3)
    np.testing.assert_allclose(picture, expected, rtol=0.03)


def test_other_lights_add_up_unless_the_monitor_is_to_shine_alone(room):
    """The lamp's own light is known in closed form; without it the bytes are the dark room's."""
    lamp = point_light(0.9, -0.3, 0.5, "0.5, 1, 2")
    sky_behind = room.monitor(room.area, y=-0.5).replace('id="monitor"', 'id="twin"')
    image = np.random.default_rng(0).random((2, 3, 3))
    dark = room.load(sky_behind.replace(room.area, ""))
    lit = room.load(sky_behind, lamp)
    options = {"samples": 1024, "bounces": 1}
    alone = render_photograph(dark, image, **options)
    same = render_photograph(lit, image, only_monitor=True, **options)
    np.testing.assert_array_equal(same, alone)
    # The twin stands behind the monitor, which hides it from the wall only in part.
    lamp_only = room.load(lamp)
    added = render_photograph(lamp_only, image, **options) - alone
    response = point_light_response(
        np.array([[0.9, -0.3, 0.5]]), field_of_view(5, 6), np.array([0, -1.0, 0])
    ).reshape(5, 6, 1)
    np.testing.assert_allclose(added, 0.5 / np.pi * response * [0.5, 1, 2], rtol=0.03)
    assert (render_photograph(lit, image, **options) > alone + added).mean() > 0.9


def test_wavefronts_average_to_the_same_picture(room, monkeypatch):
    seen = room.load()
    scene = build_scene(seen.scene, seen.hidden, {"monitor": np.ones((2, 3, 3))})
    whole = path_trace(scene, -1, samples=4096, seed=1)
    monkeypatch.setattr(photograph, "WAVEFRONT", 30 * 1024)
    fractions = []
    parts = path_trace(scene, -1, samples=4096, seed=2, progress=fractions.append)
    assert fractions == [0.25, 0.5, 0.75, 1.0]
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.02)


def test_a_wavefront_is_what_mitsuba_renders(room):
    seen, image = room.load(), np.random.default_rng(0).random((2, 3, 3))
    scene = build_scene(seen.scene, seen.hidden, {"monitor": image})
    ours = path_trace(scene, -1, samples=64, seed=3)
    integrator = mi.load_dict({"type": "path", "max_depth": -1})
    theirs = np.array(mi.render(scene, integrator=integrator, spp=64, seed=3))
    np.testing.assert_allclose(ours, theirs, rtol=1e-5)


@pytest.mark.parametrize(
    ("image", "options"),
    [
        (np.ones((2, 3)), {}),
        (np.full((2, 3, 3), np.nan), {}),
        (np.full((2, 3, 3), -1e-9), {}),
        (np.ones((1, 1, 3)), {"samples": 0}),
        (np.ones((1, 1, 3)), {"bounces": 0}),
        (np.ones((0, 2, 3)), {}),
    ],
)
def test_impossible_images_samples_and_bounces_are_refused(room, image, options):
    with pytest.raises(ValueError):
        render_photograph(room.load(), image, **{"samples": 1} | options)


def test_a_seed_has_32_bits(jit: None) -> None:  # noqa: ARG001
    """Sweeps draw such seeds: more than Mitsuba's commands count from are no error."""
    scene = load_scenario("chair", (2, 3), {"resolution": "6"})
    assert render_photograph(scene, np.ones((2, 3, 3)), snr=20, bounces=1, seed=2**32 - 1).any()
