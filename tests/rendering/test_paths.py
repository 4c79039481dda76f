"""Light that paths collect, against Mitsuba's own path integrator; the numbers that draw them."""

import numpy as np
import pytest

from periscopy_sim.rendering import paths
from periscopy_sim.rendering.ambient import rows_of
from periscopy_sim.rendering.paths import DIMENSIONS, PathNumbers
from periscopy_sim.rendering.variant import mi

SEEDS, RAYS = range(12), 1 << 14
ORIGINS, PARTS = 16, (32, 96)
COUNT = ORIGINS * sum(PARTS)
LATER = 2 * DIMENSIONS + 3

WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.7, 0.6]}}
BSDFS = {
    "matt": WHITE,
    "gloss": {"type": "roughconductor", "alpha": 0.2},
    "mirror": {"type": "conductor"},
    "glass": {"type": "thindielectric"},
    "mask": {"type": "mask", "opacity": 0.4, "nested": WHITE},
}
LAMP = {
    "type": "rectangle",
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}},
}
EMITTERS = {
    "lamp": {"lamp": LAMP},
    "bulb": {"bulb": {"type": "point", "position": [0.3, 0.2, 0.8]}},
    "daylight": {"daylight": {"type": "sunsky", "sun_direction": [0.3, -0.2, 0.9]}},
    "slide": {"slide": {"type": "projector", "to_world": "above", "irradiance": "checked"}},
    "panorama": {"panorama": {"type": "envmap", "bitmap": "uneven"}},
    "screen": {"lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": "checked"}}},
    "all": {
        "lamp": LAMP,
        "bulb": {"type": "point", "position": [0.3, 0.2, 0.8]},
        "sun": {"type": "directional", "direction": [0.2, 0.1, -1]},
        "sky": {"type": "constant"},
    },
}


def scene_of(bsdf, emitters):
    """A floor, a wall to the right, a pane of the BSDF between them and the rays, emitters."""
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
                T().translate([0.2, 0, 0.6]).rotate([0, 1, 0], 30).scale([0.5, 0.7, 1]), BSDFS[bsdf]
            ),
            "ball": {"type": "sphere", "center": [0.5, -0.4, 0.3], "radius": 0.25, "bsdf": WHITE},
            **emitters,
        }
    )


def rays_of(sample):
    """Rays from one point, most of them down."""
    direction = mi.warp.square_to_cosine_hemisphere(sample)
    return mi.Ray3f(mi.Point3f(-0.2, 0.1, 1.3), mi.Vector3f(direction.x, direction.y, -direction.z))


def by_paths(scene, seed, numbers_of=None):
    numbers = (numbers_of or PathNumbers(1, (RAYS,)).shifted)(seed)
    ray = rays_of(mi.Point2f(*(numbers(k) for k in range(2))))
    light, _ = paths.trace_paths(scene, numbers, 2, ray)
    return rows_of(light).mean(axis=0)


def by_mitsuba(scene, seed):
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


@pytest.mark.thorough
@pytest.mark.parametrize("bsdf", BSDFS)
def test_light_is_that_of_mitsubas_path_integrator_whatever_it_meets(bsdf, same_mean):
    compared(scene_of(bsdf, EMITTERS["all"]), same_mean)


@pytest.mark.parametrize(
    "kind",
    [
        "all",
        *(pytest.param(kind, marks=pytest.mark.thorough) for kind in EMITTERS if kind != "all"),
    ],
)
def test_each_kind_of_emitter_counts_once(kind, same_mean):
    compared(scene_of("gloss", EMITTERS[kind]), same_mean)


@pytest.mark.thorough
def test_numbers_beyond_the_sequence_are_as_good(monkeypatch, same_mean):
    monkeypatch.setattr(paths, "DIMENSIONS", 5)
    compared(scene_of("gloss", EMITTERS["all"]), same_mean)


def numbers_at(seed, dimensions, numbers=None):
    """(dimensions, paths)."""
    shifted = (numbers or PathNumbers(ORIGINS, PARTS)).shifted(seed)
    return np.stack([np.array(shifted(k), float) for k in dimensions])


@pytest.mark.parametrize("dimension", [0, DIMENSIONS - 1, LATER])
def test_every_dimension_fills_its_interval_evenly(dimension):
    (found,) = numbers_at(3, [dimension])
    assert found.shape == (COUNT,) and found.min() >= 0 and found.max() < 1
    # One in each of as many strata: of numbers by chance a third would be empty.
    assert len(np.unique((found * COUNT).astype(int))) == COUNT


def test_paths_of_each_origin_are_even_by_themselves():
    """Each part is ordered by origin."""
    found = numbers_at(1, [0, 1])
    first = found[:, : ORIGINS * PARTS[0]].reshape(2, ORIGINS, PARTS[0])
    for origin in range(ORIGINS):
        for dimension in range(2):
            strata = np.unique((first[dimension, origin] * PARTS[0]).astype(int))
            # Of numbers by chance 20 of 32 are filled, give or take 2.
            assert len(strata) > 27


@pytest.mark.parametrize(("origins", "parts"), [(1, (1,)), (3, (5, 7)), (180, (16, 48))])
def test_any_number_of_paths_is_served(origins, parts):
    found = numbers_at(0, [0, LATER], PathNumbers(origins, parts))
    count = origins * sum(parts)
    assert found.shape == (2, count)
    assert (found >= 0).all() and (found < 1).all()
    # Later ones are in another order, and none is left out or comes twice.
    assert len(np.unique(found[0])) == len(np.unique(found[1])) == count
