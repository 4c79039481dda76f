"""The matrix A against path-traced photographs."""

import numpy as np
import pytest

from periscopy_sim.rendering.photograph import render_photograph
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.scenes.materials import GLOSSY, painted

SEEDS = 12


def predictions(seen, image, seeds=SEEDS):
    """A f of several seeds, in color."""
    for seed in range(seeds):
        A = render_transport(seen.averaged(4), samples=16, seed=seed)
        yield (A.astype(np.float64) @ image.reshape(-1, 3)) * seen.channel_gain


def photographs(seen, image, seeds=SEEDS, samples=256):
    for seed in range(seeds):
        yield render_photograph(seen, image, samples=samples, bounces=1, seed=1000 + seed)


@pytest.mark.parametrize(
    "name",
    [
        "plate",
        pytest.param("chair", marks=pytest.mark.thorough),
        pytest.param("plant", marks=pytest.mark.thorough),
    ],
)
def test_matrix_times_image_is_the_path_traced_photograph(shipped, same_mean, name):
    seen = shipped(name)
    image = np.random.default_rng(0).random((*seen.hidden_shape, 3))
    same_mean(list(photographs(seen, image)), list(predictions(seen, image)))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["glossy", "colored", "tilted", "flipped", "mirrored", "sphere"])
def test_matrix_times_image_is_the_photograph_in_any_room(room, same_mean, kind):
    parts = {
        "glossy": {"wall": room.wall(GLOSSY)},
        "colored": {"wall": room.wall(painted("0.9, 0.3, 0.15"))},
        "tilted": {"monitor": room.monitor(scale=(0.1, 0.3), turn=170, tilt=10)},
        "flipped": {"monitor": room.monitor(flip=True, turn=0)},
        "mirrored": {"monitor": room.monitor(scale=(-0.2, 0.15))},
        "sphere": {},
    }[kind]
    extra = [room.blocker()] if kind == "sphere" else []
    seen = room.load(*extra, hidden=(2, 3), **parts)
    image = np.random.default_rng(0).random((2, 3, 3))
    same_mean(list(photographs(seen, image)), list(predictions(seen, image)))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("emitter", ["area", "lcd"])
def test_matrix_times_image_is_the_photograph_with_a_curved_monitor(
    room, same_mean, emitter, mirrored
):
    light = room.area if emitter == "area" else room.lcd(6, 2)
    monitor = room.curved_monitor(light, mirrored=mirrored)
    seen = room.load(room.blocker(), monitor=monitor, hidden=(2, 5))
    assert seen.hidden["monitor"].mirrored == mirrored
    image = np.random.default_rng(0).random((2, 5, 3))
    same_mean(list(photographs(seen, image)), list(predictions(seen, image)))
