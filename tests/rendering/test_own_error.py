"""Photographs state their own error: true against closed forms and against the path tracer."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import points_across
from periscopy_sim.measurement import allowed_error, composite, composite_error
from periscopy_sim.rendering import photograph
from periscopy_sim.rendering.load import build_scene
from periscopy_sim.rendering.photograph import path_trace, render_photograph, rendering_of
from tests.scenes.materials import checkered, diffuse, painted

RATIO = 2.0
"""Of a stated error by rays to one draw's; both are over hundreds of pixels, so known to 10 %."""


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.fixture
def image(request):
    shown = np.zeros((6, 8, 3))
    shown[2, 3] = 1, 0.5, 0.2
    pictures = {
        "letters": ps.read_hidden_image(ps.find_image("letters"), (6, 8)),
        "one patch": shown,
    }
    return pictures[request.param]


@pytest.fixture(scope="module")
def chair():
    """A chair of few pixels, and its A averaged over 32 x 32 points of each."""
    scene = ps.load_scenario("chair", (6, 8), {"resolution": 12})
    return scene, ps.analytic_transport(scene.averaged(32)).astype(float)


@pytest.mark.parametrize(("image", "snr"), [("letters", 40), ("one patch", 65)], indirect=["image"])
def test_error_by_areas_bounds_the_distance_from_a_finer_grid(chair, image, snr):
    scene, A = chair
    rendering = rendering_of(scene, image, snr=snr, bounces=1)
    assert rendering.relative_error <= allowed_error(snr)
    finest = A @ image.reshape(-1, 3)
    off = rms(rendering.photograph.reshape(-1, 3) - finest) / rms(finest)
    assert 0.2 * rendering.relative_error < off < 1.2 * rendering.relative_error + 3e-5


@pytest.mark.parametrize(("by_areas", "snr"), [(True, 30), (True, 55), (False, 45)])
def test_a_photograph_has_wall_points_of_its_own(chair, snr, by_areas, monkeypatch):
    """A's grid, whose error it would share, has the first number of points or even multiples."""
    made, (scene, _) = [], chair

    def watched(_, seen, f):
        made.append(seen.view.across // points_across(scene.photograph_shape))
        return f[:1].repeat(len(seen.view.centers), axis=0) * (1 + 0.3 ** len(made))

    monkeypatch.setattr(photograph, "_by_channel", watched)
    monkeypatch.setattr(photograph, "has_areas", lambda _: by_areas)
    rendering_of(scene, np.ones((1, 2, 3)), snr=snr, bounces=1)
    assert made[-1] % 2 == 1 < made[-1] if by_areas else made[-2:] == [2, 2]


@pytest.mark.parametrize("image", ["one patch"], indirect=True)
def test_error_by_rays_is_the_distance_from_areas(chair, image, monkeypatch):
    scene, A = chair
    exact = (A @ image.reshape(-1, 3)).reshape(12, 12, 3)
    monkeypatch.setattr(photograph, "has_areas", lambda _: False)
    first, second = (rendering_of(scene, image, snr=45, bounces=1, seed=k) for k in range(2))
    assert first.relative_error <= allowed_error(45)
    assert (first.photograph != second.photograph).any()
    off = rms(first.photograph - exact) / rms(exact)
    assert 1 / RATIO < off / first.relative_error < RATIO


@pytest.mark.usefixtures("few_paths")
def test_photograph_is_the_path_tracers(room, same_mean):
    """All bounces and lamps, by other code, at an error rate of 1e-5."""
    lamp = (
        '<emitter type="point"><point name="position" value="0.9, -0.3, 0.5"/>'
        '<rgb name="intensity" value="0.1, 0.2, 0.4"/></emitter>'
    )
    bright = room.blocker().replace(room.black, '<bsdf type="diffuse"/>')
    wall = room.wall(painted("0.9, 0.3, 0.15"))
    scene = room.load(bright, lamp, wall=wall, hidden=(2, 3))
    image = np.random.default_rng(0).random((2, 3, 3))
    ours = [render_photograph(scene, image, snr=40, seed=seed) for seed in range(8)]
    shown = build_scene(scene.scene, scene.hidden, {"monitor": image})
    theirs = [path_trace(shown, -1, samples=1024, seed=100 + seed) for seed in range(8)]
    same_mean(theirs, ours)


def test_other_light_passes_a_transparent_hidden_surface(room):
    """A lamp behind the monitor, which lets light pass: as without it, but for its own light."""
    lamp = (
        '<emitter type="point"><point name="position" value="0.2, -0.2, 0.3"/>'
        '<rgb name="intensity" value="1"/></emitter>'
    )
    clear = room.monitor('<bsdf type="null"/>' + room.area, inside="")
    image = np.full((2, 3, 3), 1e-6)
    scenes = [room.load(lamp, hidden=(2, 3), **parts) for parts in ({"monitor": clear}, {})]
    seen, hidden = (rendering_of(each, image, snr=30, bounces=1).photograph for each in scenes)
    assert seen.min() > 100 * hidden.max()


def test_path_tracers_error_is_its_scatter(room):
    scene, image = room.load(room.blocker()), np.ones((2, 3, 3))
    draws = [rendering_of(scene, image, samples=128, seed=seed) for seed in range(12)]
    scatter = rms(np.std([each.photograph for each in draws], axis=0, ddof=1))
    scatter /= rms(draws[0].photograph)
    assert np.mean([each.relative_error for each in draws]) == pytest.approx(scatter, rel=0.3)


def test_images_of_very_many_patches_are_path_traced(shipped, monkeypatch):
    for way in ("_light_by_areas", "_light_by_rays"):
        monkeypatch.setattr(photograph, way, None)
    image = np.ones((1000, 2000, 3))
    rendering = rendering_of(shipped("chair"), image, snr=20, bounces=1)
    assert 0 < rendering.relative_error <= allowed_error(20)


@pytest.mark.parametrize("reflectance", ["0.9, 0.3, 0.15", None])
def test_detail_of_images_of_any_channels_lights_the_wall(room, reflectance):
    """Beside that of a grey wall; of a texture a channel alone is that of the mean albedo."""
    tiles = diffuse(checkered("0.8, 0.8, 0.3", "0.2, 0.1, 0.3", 9))
    wall = room.wall(painted(reflectance) if reflectance else tiles)
    scene, image = room.load(hidden=(2, 3), wall=wall), np.random.default_rng(0).random((2, 3, 4))
    lights = [photograph.detail_light(scene, {"monitor": image[..., :n]}) for n in (1, 3, 4)]
    assert [each.shape for each in lights] == [(len(lights[0]), n) for n in (1, 3, 4)]
    np.testing.assert_allclose(lights[2][:, :1], lights[0], rtol=1e-6)
    even = photograph.detail_light(scene, {"monitor": np.ones((2, 3, 1))})
    assert np.abs(even).max() < 1e-9 * np.abs(lights[0]).max()
    same = 0.1 if reflectance is None else 1e-6
    assert rms(lights[1] - lights[2][:, :3]) <= same * rms(lights[1])


def test_error_counts_the_walls_colour(room):
    """A coloured wall in white light is a white wall in coloured light."""
    colour, image = np.array([0.02, 0.02, 0.92]), np.zeros((2, 3, 3))
    image[..., 0], image[0, 1, 2] = 1, 1
    walls = [room.wall(painted(each)) for each in ("0.02, 0.02, 0.92", "0.32, 0.32, 0.32")]
    scenes = [room.load(room.blocker(), wall=wall) for wall in walls]
    lit, white = (
        rendering_of(scene, shown, snr=30, bounces=1)
        for scene, shown in zip(scenes, [image, image * colour / colour.mean()], strict=True)
    )
    np.testing.assert_allclose(lit.photograph, white.photograph, rtol=1e-5)
    assert lit.relative_error == pytest.approx(white.relative_error, rel=1e-4)


def test_a_grid_that_misses_the_wall_leaves_the_coarser_ones(room, monkeypatch):
    """The wall ends between the last points of the second and the third grid."""
    monkeypatch.setattr(photograph, "_path_traced", None)
    scene = room.load(monitor=room.monitor(room.area), wall=room.wall(x=-0.1004))
    rendering = rendering_of(scene, np.ones((2, 3, 3)), snr=140, bounces=1)
    assert allowed_error(140) < rendering.relative_error < 1e-3


def test_an_snr_beyond_the_budget_is_warned_of(shipped, monkeypatch):
    monkeypatch.setattr(photograph, "MOST_POINTS", 0)
    with pytest.warns(RuntimeWarning, match="error"):
        render_photograph(shipped("chair"), np.ones((6, 8, 3)), snr=120, bounces=1)


def test_error_of_a_composite_is_that_of_its_parts():
    """Over 200 draws of both errors, known to 5 %."""
    rng = np.random.default_rng(0)
    signal, ambient = 1 + rng.random((2, 12, 10, 3))
    signal[:6] = 0
    exact, off = composite(signal, ambient, 0.4), []
    for _ in range(200):
        noisy = (y + 0.01 * rms(y) * rng.standard_normal(y.shape) for y in (signal, ambient))
        off.append(rms(composite(*noisy, 0.4) - exact) / rms(exact))
    assert rms(off) == pytest.approx(composite_error(signal, ambient, 0.4, 0.01, 0.01), rel=0.1)


@pytest.mark.usefixtures("few_paths")
def test_bounced_light_of_any_channels_is_that_of_the_surfaces_mean(shipped):
    """By the same rays: a channel alone meets the mean of red, green and blue."""
    scene, image = shipped("bright_room", resolution=8), np.random.default_rng(0).random((6, 8, 1))
    grey = photograph.bounced_light(scene, {"monitor": image})
    three = photograph.bounced_light(scene, {"monitor": image.repeat(3, axis=2)})
    two = photograph.bounced_light(scene, {"monitor": image.repeat(2, axis=2)})
    assert (grey.shape, two.shape) == ((64, 1), (64, 2))
    np.testing.assert_allclose(grey[:, 0], three.mean(axis=1), rtol=1e-6)
    np.testing.assert_allclose(two[:, 0], grey[:, 0], rtol=1e-6)
