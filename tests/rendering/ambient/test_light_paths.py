"""Light that paths collect, against Mitsuba's own path integrator."""

import numpy as np
import pytest

from periscopy_sim.rendering.ambient import light_paths, path_numbers
from periscopy_sim.rendering.ambient.irradiance import rows_of
from periscopy_sim.rendering.ambient.path_numbers import PathNumbers

pytestmark = pytest.mark.usefixtures("jit")

SEEDS, RAYS = range(24), 1 << 14

WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.7, 0.6]}}
BSDFS = {
    "matt": WHITE,
    "gloss": {"type": "roughconductor", "alpha": 0.2},
    "mirror": {"type": "conductor"},
    "glass": {"type": "thindielectric"},
    "plastic": {"type": "plastic"},
    "mask": {"type": "mask", "opacity": 0.4, "nested": WHITE},
    "twosided": {"type": "twosided", "nested": WHITE},
}
LAMP = {
    "type": "rectangle",
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}},
}
EMITTERS = {
    "lamp": {"lamp": LAMP},
    "bulb": {"bulb": {"type": "point", "position": [0.3, 0.2, 0.8]}},
    "sun": {"sun": {"type": "directional", "direction": [0.2, 0.1, -1]}},
    "sky": {"sky": {"type": "constant"}},
    "daylight": {"daylight": {"type": "sunsky", "sun_direction": [0.3, -0.2, 0.9]}},
    "spot": {"spot": {"type": "spot", "to_world": "above"}},
    "slide": {"slide": {"type": "projector", "to_world": "above", "irradiance": "checked"}},
    "panorama": {"panorama": {"type": "envmap", "bitmap": "uneven"}},
    "screen": {
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": "checked"}},
    },
    "all": {
        "lamp": LAMP,
        "bulb": {"type": "point", "position": [0.3, 0.2, 0.8]},
        "sun": {"type": "directional", "direction": [0.2, 0.1, -1]},
        "sky": {"type": "constant"},
    },
}


def scene_of(bsdf, emitters):
    """A floor, a wall to the right, a pane of the BSDF between them and the rays, emitters."""
    import mitsuba as mi

    T = mi.ScalarTransform4f

    def rectangle(transform, bsdf):
        return {"type": "rectangle", "to_world": transform, "bsdf": bsdf}

    picture = np.random.default_rng(0).uniform(0, 4, (8, 8, 3)).astype(np.float32) ** 2
    words = {
        "above": T().look_at([0.1, 0.2, 1.7], [0.2, 0, 0], [0, 1, 0]),
        "checked": {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True},
        "uneven": mi.Bitmap(picture),
    }

    def meant(value):
        if isinstance(value, dict):
            return {key: meant(each) for key, each in value.items()}
        return words.get(value, value) if isinstance(value, str) else value

    emitters = meant(emitters)
    if "lamp" in emitters:
        emitters["lamp"]["to_world"] = (
            T().translate([0, 0.2, 1.6]).rotate([1, 0, 0], 180).scale(0.3)
        )
    return mi.load_dict(
        {
            "type": "scene",
            "floor": rectangle(T().scale(1.5), WHITE),
            "wall": rectangle(T().translate([1.2, 0, 0.8]).rotate([0, 1, 0], -90), WHITE),
            "pane": rectangle(
                T().translate([0.2, 0, 0.6]).rotate([0, 1, 0], 30).scale([0.5, 0.7, 1]),
                BSDFS[bsdf],
            ),
            "ball": {"type": "sphere", "center": [0.5, -0.4, 0.3], "radius": 0.25, "bsdf": WHITE},
            **emitters,
        }
    )


def rays_of(sample):
    """Rays from one point, most of them down."""
    import mitsuba as mi

    direction = mi.warp.square_to_cosine_hemisphere(sample)
    return mi.Ray3f(mi.Point3f(-0.2, 0.1, 1.3), mi.Vector3f(direction.x, direction.y, -direction.z))


class ByChance:
    """Numbers that know nothing of each other."""

    def __init__(self, seed):
        self.seed = seed

    def at(self, dimension):
        import drjit as dr
        import mitsuba as mi

        path = dr.arange(mi.UInt32, RAYS)
        # Of fewer rounds numbers of neighbouring paths are alike.
        return mi.sample_tea_float32(path, dr.opaque(mi.UInt32, self.seed << 12) + dimension, 8)


def by_paths(scene, seed, numbers_of=None):
    import mitsuba as mi

    numbers = (numbers_of or PathNumbers(1, (RAYS,)).shifted)(seed)
    ray = rays_of(mi.Point2f(*(numbers.at(mi.UInt32(k)) for k in range(2))))
    light, _ = light_paths.collected(scene, numbers, 2, ray)
    return rows_of(light).mean(axis=0)


def by_mitsuba(scene, seed):
    import mitsuba as mi

    def traced(depth):
        sampler = mi.load_dict({"type": "independent", "sample_count": RAYS})
        sampler.set_samples_per_wavefront(RAYS)
        sampler.seed(seed + 1000, RAYS)
        ray = rays_of(sampler.next_2d())
        tracer = mi.load_dict({"type": "path", "max_depth": depth})
        return rows_of(tracer.sample(scene, sampler, mi.RayDifferential3f(ray))[0])

    return (traced(-1) - traced(1)).mean(axis=0)


def compared(scene, same_mean):
    found, expected = (
        np.array([estimate(scene, seed) for seed in SEEDS])[:, None]
        for estimate in (by_paths, by_mitsuba)
    )
    assert expected.mean() > 0
    same_mean(found, expected)


@pytest.mark.parametrize("bsdf", BSDFS)
def test_light_is_that_of_mitsubas_path_integrator_whatever_it_meets(bsdf, same_mean):
    compared(scene_of(bsdf, EMITTERS["all"]), same_mean)


@pytest.mark.parametrize("kind", EMITTERS)
def test_each_kind_of_emitter_counts_once(kind, same_mean):
    compared(scene_of("gloss", EMITTERS[kind]), same_mean)


def test_numbers_beyond_the_sequence_are_as_good(monkeypatch, same_mean):
    monkeypatch.setattr(path_numbers, "DIMENSIONS", 5)
    compared(scene_of("gloss", EMITTERS["all"]), same_mean)


def test_numbers_of_low_discrepancy_lower_the_noise():
    """To a sixth here. Of 24 means either way, were both alike, this would be once in 10,000."""
    scene = scene_of("matt", EMITTERS["all"])
    even, chance = (
        np.var([by_paths(scene, seed, numbers).mean() for seed in SEEDS], ddof=1)
        for numbers in (None, ByChance)
    )
    assert chance > 4.5 * even


def test_of_many_emitters_one_is_drawn_with_the_same_mean(monkeypatch, same_mean):
    monkeypatch.setattr(light_paths, "FEW", 2)
    compared(scene_of("gloss", EMITTERS["all"]), same_mean)


def test_asking_all_emitters_lowers_the_noise(monkeypatch):
    """By 2.6 here. Of 200 means either way the ratio is below 1.5 once in 30,000 times.

    Were both alike, it would be above once in 500.
    """
    scene = scene_of("matt", EMITTERS["all"])
    all_asked = np.var([by_paths(scene, seed, ByChance).mean() for seed in range(200)])
    monkeypatch.setattr(light_paths, "FEW", 0)
    one_drawn = np.var([by_paths(scene, seed, ByChance).mean() for seed in range(200)])
    assert one_drawn > 1.5 * all_asked


def test_what_the_rays_first_meet_is_told():
    import mitsuba as mi

    scene = scene_of("mirror", EMITTERS["lamp"])
    origins, downward = np.array([[-0.9, 0, 1.0], [0.2, 0, 1.0], [-0.9, 0, 1.0]]), [-1, -1, 1]
    ray = mi.Ray3f(mi.Point3f(*origins.T), mi.Vector3f(0, 0, mi.Float(downward)))
    numbers = PathNumbers(3, (1,)).shifted(0)
    _, (position, normal, is_valid, scatters_alike) = light_paths.collected(scene, numbers, 0, ray)
    assert np.array(is_valid).tolist() == [True, True, False]
    assert np.array(scatters_alike).tolist()[:2] == [True, False]
    np.testing.assert_allclose(rows_of(position)[:2], [[-0.9, 0, 0], [0.2, 0, 0.6]], atol=1e-5)
    assert (rows_of(normal)[:2, 2] > 0).all()
