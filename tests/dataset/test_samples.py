from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.dataset.configuration import Distribution
from periscopy_sim.dataset.samples import draw_clip, lamp_light, make_samples, render_geometry
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.rendering import bounced
from periscopy_sim.rendering.transport import SMALL, planned

INTERVAL = 4.9
"""Standard deviations that one of 10⁶ normal draws exceeds."""


@pytest.fixture(scope="module")
def geometry(configured):
    return render_geometry(configured(), 0)


@pytest.fixture(scope="module")
def block(configured, geometry):
    return make_samples(configured(), geometry, {}, 0, 20)


def noise_free(block, geometry):
    A = geometry.transport.astype(np.float64)
    f = block["hidden"].reshape(20, -1, 3)
    signal = np.einsum("mn,knc->kmc", A, f) * geometry.scenario.channel_gain
    signal = signal.reshape(block["photograph"].shape) * block["signal_scale"][:, None, None, None]
    return signal, signal + block["background"]


def test_photograph_is_scaled_transport_plus_background_plus_noise(block, geometry):
    _, clean = noise_free(block, geometry)
    for photograph, exact, snr in zip(block["photograph"], clean, block["snr"], strict=True):
        noise = photograph - exact
        σ = 10 ** (-snr / 20) * np.sqrt(np.mean(exact**2))
        # Mean and mean square of n normal numbers; 20 samples, both sides: 1 in 25,000 seeds.
        n = noise.size
        assert abs(noise.mean()) < INTERVAL * σ / np.sqrt(n)
        assert abs(noise.var() / σ**2 - 1) < INTERVAL * np.sqrt(2 / n)


M = ((0.7, 0.25, 0.05), (0.2, 1.0, 0.3), (0.0, 0.3, 1.2), (0.1, 0.2, 0.1))


@pytest.mark.parametrize("channels", [3, 4])
def test_a_cameras_colours_are_mixed_but_in_its_own_photographs(configured, geometry, channels):
    shape = (*geometry.scenario.photograph_shape, channels)
    taken = np.random.default_rng(1).random((1, *shape), np.float32) + 0.1
    entries = [{"kind": "lamps"}, {"kind": "pictures", "files": ["y.npy"], "flip": False}]
    configuration = configured(ambient=entries, colour_matrix=M[:channels])
    block = make_samples(configuration, geometry, {1: taken}, 0, 20)
    A, f = geometry.transport.astype(np.float64), block["hidden"].reshape(20, -1, 3)
    signal = np.einsum("mn,knc->kmc", A, f) * geometry.scenario.channel_gain
    signal = (signal @ np.transpose(M[:channels])).reshape(20, *shape)
    signal *= block["signal_scale"][:, None, None, None]
    ambient, clips = block["background"], (10, 2, -1)
    exact = signal + ambient
    means = [each.reshape(clips).mean(axis=(1, 2)) for each in (signal, ambient, exact)]
    np.testing.assert_allclose(means[0] / means[1], block["sbr"][::2], rtol=1e-5)
    np.testing.assert_allclose(means[2], block["exposure"][::2], rtol=1e-5)
    by_camera = block["ambient"] == "y"
    assert 0 < by_camera.sum() < 20
    ratio = ambient[by_camera] / (taken * geometry.scenario.channel_gain.mean())
    assert np.ptp(ratio / ratio.mean(axis=(1, 2, 3), keepdims=True)) < 1e-4
    lamps = ambient[~by_camera].reshape(-1, channels)  # of the scene's three channels
    assert np.linalg.matrix_rank(lamps, tol=1e-4 * np.abs(lamps).max()) <= 3
    for photograph, light, snr in zip(block["photograph"], exact, block["snr"], strict=True):
        σ = 10 ** (-snr / 20) * np.sqrt(np.mean(light**2))
        assert abs((photograph - light).var() / σ**2 - 1) < INTERVAL * np.sqrt(2 / light.size)


def test_signal_stands_to_the_background_as_asked(block, geometry):
    signal, clean = noise_free(block, geometry)
    lit = np.isfinite(block["sbr"])
    assert 0 < lit.sum() < 20

    def of_clips(values):
        return values.reshape(10, 2, -1).mean(axis=(1, 2))

    with np.errstate(divide="ignore"):
        found = of_clips(signal) / of_clips(block["background"])
    np.testing.assert_allclose(found, block["sbr"][::2], rtol=1e-5)
    np.testing.assert_allclose(of_clips(clean), block["exposure"][::2], rtol=1e-5)
    assert (block["background"][~lit] == 0).all()
    assert (block["ambient"][~lit] == "none").all()


def test_photographs_that_do_not_fit_their_type_are_refused(configured, geometry):
    bright = configured(photograph_type="float16", exposure=90, ambient=[{"kind": "none"}])
    make_samples(bright, geometry, {}, 0, 2)
    too_bright = bright.model_copy(update={"exposure": Distribution(value=1e6)})
    with pytest.raises(ConfigurationError, match="do not fit float16"):
        make_samples(too_bright, geometry, {}, 0, 2)


def test_frames_of_a_clip_share_their_light_and_no_noise(block, configured):
    for first, second in zip(range(0, 20, 2), range(1, 20, 2), strict=True):
        for name in ("sbr", "snr", "exposure", "clip_number", "ambient", "hidden_kind", "geometry",
                     "signal_scale", "background"):  # fmt: skip
            np.testing.assert_array_equal(block[name][first], block[name][second])
        assert block["frame"][[first, second]].tolist() == [0, 1]
        noises = block["photograph"][[first, second]] - block["photograph"][[second, first]]
        assert noises.any()
        moves = block["hidden_kind"][first] == "moving"
        still = np.array_equal(block["hidden"][first], block["hidden"][second])
        assert still != moves
    np.testing.assert_array_equal(
        block["hidden"][4:6], draw_clip(configured(), 2).hidden["hidden"].astype(np.float32)
    )


def test_sample_does_not_depend_on_its_neighbours(block, configured, geometry):
    alone = make_samples(configured(), geometry, {}, 8, 12)
    for name, values in alone.items():
        np.testing.assert_array_equal(values, block[name][8:12], err_msg=name)


def test_pictures_of_ambient_light_are_mixed_turned_and_coloured(configured, geometry):
    scenario = geometry.scenario
    shape = (*scenario.photograph_shape, 3)
    pictures = np.random.default_rng(0).random((3, *shape)).astype(np.float32) + 0.1
    entry = {"kind": "conditions", "names": ["overcast", "low_sun", "corridor"], "mixed": 2}
    configuration = configured(ambient=[entry])
    block = make_samples(configuration, geometry, {0: pictures}, 0, 20)
    turned = set()
    for k in range(20):
        expected = np.zeros(shape)
        for which, weight, down, across in draw_clip(configuration, k // 2).ambient.mixture:
            picture = pictures[which].astype(np.float64)
            turned.add((down, across))
            picture = np.flipud(picture) if down else picture
            picture = np.fliplr(picture) if across else picture
            expected += weight * picture / picture.mean()
        found = block["background"][k].astype(np.float64)
        np.testing.assert_allclose(found / found.mean(), expected / expected.mean(), rtol=1e-5)
    assert len(turned) == 4


def test_lamps_add_up_by_their_powers_and_are_dark_behind_the_wall():
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(-1, 1, 57), np.zeros(57), rng.uniform(-1, 1, 57)], 1)
    normals = np.tile([0.0, 1, 0], (57, 1))
    lamps, powers = np.array([[0.0, 2, 0], [1, 1, 1], [0, -50, 0]]), rng.random((3, 3))
    ways = lamps[:2, None] - points
    response = ways[..., 1] / np.linalg.norm(ways, axis=2) ** 3  # Eq. 4
    expected = np.einsum("lm,lc->mc", response / response.mean(axis=1)[:, None], powers[:2])
    np.testing.assert_allclose(lamp_light(lamps, powers, points, normals), expected, rtol=1e-10)


def test_bounced_photographs_are_those_of_the_channels_matrices(configured, monkeypatch):
    trace = partial(bounced.render_bounced_light, target=0.1)
    monkeypatch.setattr(bounced, "render_bounced_light", trace)
    monkeypatch.setattr(bounced, "PATHS", 32)
    monkeypatch.setattr("periscopy_sim.rendering.wall_polynomials.POWERS", (0, 1, 2, 3, 5))
    scenes = [{"scene": "bright_room", "parameters": {"resolution": 12}}]
    light = {"kind": "bounced", "samples": 4}
    configuration = configured(light=light, scenes=scenes, ambient=[{"kind": "none"}], snr=300)
    with pytest.warns(RuntimeWarning, match="A errs"):  # by 4 rays
        geometry = render_geometry(configuration, 0)
    block = make_samples(configuration, geometry, {}, 0, 4)
    assert (block["bounced_error"] == geometry.transport.bounced.relative_error).all()
    for photograph, hidden in zip(block["photograph"], block["hidden"], strict=True):
        f = hidden.reshape(-1, 3)
        expected = geometry.transport @ f
        scale = photograph.mean() / expected.mean()
        np.testing.assert_allclose(photograph.reshape(-1, 3), scale * expected, rtol=1e-4)
        mean = np.asarray(geometry.transport) @ f
        assert np.abs(scale * mean / photograph.reshape(-1, 3) - 1).max() > 1e-3  # colours


def test_transport_serves_structured_images_too(configured):
    """At 100 pixels, against 16 times as many wall points; an A planned by white light errs more.

    Seed 3; the light of the 8 images that chose A, whose error 64 of 3969 pixels sample.
    """
    scenes = [{"scene": "chair", "parameters": {"resolution": 63}}]
    hidden = [{"kind": "text"}, {"kind": "gratings"}]
    settings = configured(
        hidden=(15, 18),
        hidden_images=hidden,
        scenes=scenes,
        snr=64,
        clip_length=1,
        light={"kind": "direct"},
    )
    noise = 10 ** (-64 / 20)
    geometry, used = render_geometry(settings, 0), np.zeros(63 * 63, bool)
    used[np.random.default_rng(1).permutation(63 * 63)[:100]] = True
    scenario = geometry.scenario
    plan = planned(scenario, noise)
    f = np.stack([draw_clip(settings, k).hidden["hidden"][0].reshape(-1, 3) for k in range(8)])

    def light(across):
        view = scenario.averaged(across).view.of_pixels(used.reshape(63, 63))
        return ps.analytic_transport(replace(scenario, view=view)).astype(float) @ f

    fine = light(4 * plan.across)

    def error(light):
        off = np.sqrt(((light - fine) ** 2).mean(axis=(1, 2)))
        return (off / fine.mean(axis=(1, 2))).max()

    assert error(light(plan.across)) > 1.2 * SMALL * noise
    assert error(geometry.transport[used].astype(float) @ f) < SMALL * noise


def test_rays_that_err_more_than_the_noise_are_warned_of(configured):
    with pytest.warns(RuntimeWarning, match="geometry 0: A errs"):
        render_geometry(configured(light={"kind": "direct", "samples": 4}, snr=60), 0)


def test_photographs_are_clipped_where_they_saturate(configured, geometry):
    free = make_samples(configured(), geometry, {}, 0, 4)["photograph"]
    level = float(np.median(free))
    found = make_samples(configured(saturation=level), geometry, {}, 0, 4)["photograph"]
    np.testing.assert_array_equal(found, np.minimum(free, np.float32(level)))
