"""Wrong kinds of values are one error by name, at each entrance from Python."""

import numpy as np
import pytest

import periscopy_sim as ps

IMAGE, WALL = np.ones((3, 4, 3)), np.ones((16, 16, 3))


@pytest.fixture(scope="module")
def scene():
    return ps.load_scenario("chair", (3, 4), {"resolution": 16})


@pytest.mark.usefixtures("jit")
def test_photographs_name_what_is_no_number_or_no_image(scene):
    for name, *values in (("snr", "60", None, np.nan), ("samples", "16", 1.5),
                          ("bounces", "all"), ("seed", "a", -1, True)):  # fmt: skip
        for value in values:
            with pytest.raises(ps.PeriscopyError, match=f"^{name} "):
                ps.render_photograph(scene, IMAGE, **{name: value})
    for image in ("mushroom", None, IMAGE + 1j, IMAGE[..., 0], {"monitor": "x"}):
        with pytest.raises(ps.PeriscopyError, match="image"):
            ps.render_photograph(scene, image)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda _: ps.add_noise(WALL, "60", 0), "snr"),
        (lambda _: ps.add_noise(WALL, 60, 0.5), "seed"),
        (lambda _: ps.add_noise("y.npy", 60, 0), "photograph"),
        (lambda _: ps.composite(WALL, WALL, "1"), "sbr"),
        (lambda _: ps.composite(WALL, ps.Background(WALL, 0, 0), 1), "background"),
        (lambda _: ps.transport("chair"), "scene"),
        (lambda scene: ps.transport(scene, by="area"), "by"),
        (lambda scene: ps.transport(scene, noise="x"), "noise"),
        (lambda scene: ps.transport(scene, bounces="all"), "bounces"),
        (lambda scene: ps.render_transport(scene, samples="4"), "samples"),
        (lambda _: ps.Light(samples=1.5), "samples"),
        (lambda _: ps.Light(bounces=1.5), "bounces"),
        (lambda scene: ps.sweep(scene, ["mushroom"], seeds=1.5), "seeds"),
        (lambda scene: ps.design(scene, {"occluder_dx": (0, 1)}, grid=2.5), "grid"),
        (lambda _: ps.NoiseAware.for_scene("chair", WALL[0]), "scene"),
        (lambda _: ps.NoiseAware(np.ones((9, 12)), hidden="3by4"), "size"),
        (lambda _: ps.Periscope(np.eye(9)[:, :4], hidden=(2, 2)).reconstruct("y"), "photograph"),
        (lambda _: ps.Periscope(np.eye(9)[:, :4], hidden=(2, 2), tv_weight="1"), "tv_weight"),
    ],
)
def test_a_value_of_the_wrong_kind_is_one_error_by_name(scene, call, name):
    with pytest.raises(ps.PeriscopyError, match=name):
        call(scene)


def test_numbers_of_numpy_are_numbers():
    same = ps.add_noise(WALL, np.float32(60), np.int64(3))
    np.testing.assert_allclose(same, ps.add_noise(WALL, np.array(60), 3), rtol=1e-12)
