"""Light that bounces in scalar_rgb, rendered in a process of its own."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport import bounced
from periscopy_sim.rendering.transport.bounced import render_bounced_light
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.rendering.transport.test_bounced import board, checkered, floor, hidden_image, painted

SEEDS = 6
PATHS = 54  # of a round; of six patches nine each

SENT = """
import sys
import numpy as np
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport import bounced
path, bounces, paths, target, out, *seeds = sys.argv[1:]
bounced.PATHS = int(paths)
seen = load_scenario(path, (2, 3))
bounces, target = (None if bounces == "all" else int(bounces)), float(target)
image = np.random.default_rng(0).random((2, 3, 3)).reshape(-1, 3)
found, told = [], []
for seed in map(int, seeds):
    light = bounced.render_bounced_light(seen, bounces=bounces, target=target, seed=seed)
    found.append(light.over_wall @ np.einsum("ckn,nc->kc", light.of_patches, image))
    told.append(light.relative_error)
np.savez(out, found=found, told=told)
"""

WHITE = """
import sys
import numpy as np
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.scalar_paths import white_direct_light
seen = load_scenario(sys.argv[1], (1, 1))
print(*white_direct_light(seen, np.arange(seen.transport_shape[0]), 0))
"""

THREADS = """
import sys
import numpy as np
import drjit as dr
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.photograph import render_photograph
from periscopy_sim.rendering.transport.scalar_paths import make_scalar_tracer
from periscopy_sim.rendering.transport.shadow_rays import render_transport
seen = load_scenario(sys.argv[1], (2, 3))
for threads in (1, 2, 8):
    dr.set_thread_count(threads)
    print(
        make_scalar_tracer(seen, np.arange(20), None)(54, 7).tobytes().hex(),
        render_transport(seen, samples=4).tobytes().hex(),
        render_photograph(seen, np.ones((2, 3, 3)), samples=4).tobytes().hex(),
    )
"""

PROGRESS = """
import sys
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport import bounced
from periscopy_sim.rendering.transport.shadow_rays import render_transport
bounced.PATHS, bounced.SCALAR_TARGET = 24, 2e-2
told = []
render_transport(load_scenario(sys.argv[1], (2, 3)), samples=4, bounces=None, progress=told.append)
print(*told)
"""

WORDS = """
import sys
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
for path in sys.argv[1:]:
    try:
        render_transport(load_scenario(path, (1, 2)), samples=1, bounces=None)
    except SceneError as error:
        print(error)
"""


@pytest.fixture
def sent(scalar, tmp_path):
    """Return what has bounced of an image's light, once a seed, and the told errors."""

    def run(path, bounces, target, seeds):
        out = tmp_path / "light.npz"
        scalar(SENT, path, bounces or "all", PATHS, target, out, *seeds)
        with np.load(out) as kept:
            return kept["found"], kept["told"]

    return run


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    ("bounces", "emitter", "wall"),
    [
        (2, "area", painted(0.5)),
        (None, "area", painted("0.9, 0.5, 0.3")),
        (None, "area", checkered("0.9, 0.8, 0.2", "0.3, 0.2, 0.4", 40)),
        pytest.param(None, "lcd", painted(0.5), marks=pytest.mark.thorough),
    ],
    ids=["once more", "coloured wall", "textured wall", "falloff"],
)
def test_light_is_the_vectorized_one_within_the_noise(
    room, sent, same_mean, bounces, emitter, wall
):
    path = room.write(
        board(painted("0.8, 0.4, 0.2")),
        floor(painted("0.5, 0.6, 0.7")),
        wall=room.wall(wall),
        camera=room.camera((4, 5)),
        monitor=room.monitor(room.lcd(2, 1) if emitter == "lcd" else room.area),
    )
    found, _ = sent(path, bounces, 0.05, range(SEEDS))
    seen = load_scenario(path, (2, 3))
    image = hidden_image((2, 3)).reshape(-1, 3)
    lights = [render_bounced_light(seen, bounces=bounces, target=2e-3, seed=s) for s in range(8)]
    same_mean(
        [light.over_wall @ np.einsum("ckn,nc->kc", light.of_patches, image) for light in lights],
        found,
    )


@pytest.mark.usefixtures("jit")
def test_told_error_holds_beside_the_vectorized_light(room, sent):
    path = room.write(
        board(painted(0.8)), camera=room.camera((4, 5)), monitor=room.monitor(room.area)
    )
    found, told = sent(path, None, 5e-3, range(SEEDS))
    seen = load_scenario(path, (2, 3))
    light = render_bounced_light(seen, target=2e-4, seed=9)
    image = hidden_image((2, 3)).reshape(-1, 3)
    sent_on = light.over_wall @ np.einsum("ckn,nc->kc", light.of_patches, image)
    whole = np.sqrt(np.mean((bounced._direct(seen, np.arange(20), 0) * image.mean()) ** 2))
    error = np.sqrt(np.mean((found - sent_on) ** 2)) / whole
    assert told.max() <= 5e-3
    # Of an image of mean square 1/3 and mean 1/2 chance errs up to 2 / sqrt(3) times as much.
    assert 0.4 < error / np.sqrt(np.mean(told**2)) < 1.8


def bent(radius):
    """Return a wall that bends towards the room about an upright axis."""
    y = 1 - radius
    return (
        f'<shape type="cylinder" id="wall"><float name="radius" value="{radius}"/>'
        f'<point name="p0" x="0.7" y="{y}" z="-0.5"/><point name="p1" x="0.7" y="{y}" z="1.5"/>'
        f'<boolean name="flip_normals" value="true"/>{painted(0.5)}</shape>'
    )


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("kind", ["textured", "bent", "lone pixel"])
def test_white_direct_light_is_the_vectorized_one(room, scalar, kind):
    checks = checkered("0.9, 0.8, 0.2", "0.3, 0.2, 0.4", 40)
    wall = {"textured": room.wall(checks), "bent": bent(1.5)}.get(kind, room.wall())
    parts = {
        "camera": room.camera((1, 1) if kind == "lone pixel" else (4, 5)),
        "monitor": room.monitor(room.area),
    }
    path = room.write(wall=wall, **parts)
    found = np.array(scalar(WHITE, path).split(), float)
    seen = load_scenario(path, (1, 1))
    if kind == "textured":  # its pixels' albedos multiply what a plain wall of the mean has
        plain = room.load(wall=room.wall(painted(seen.wall_reflectance.mean())), **parts)
        expected = render_transport(plain, samples=256, pixel_samples=64).sum(axis=1)
        expected *= seen.wall_texture
    else:  # of a lone pixel the size is not known: it counts as a point
        over = 1 if kind == "lone pixel" else 64
        expected = render_transport(seen, samples=256, pixel_samples=over).sum(axis=1)
    # By 256 samples of a pixel the share of its checks is known to 2 %.
    np.testing.assert_allclose(found, expected, rtol=0.025 if kind == "textured" else 0.01)


def test_bytes_do_not_follow_the_number_of_threads(room, scalar):
    path = room.write(
        board(painted(0.8)), camera=room.camera((4, 5)), monitor=room.monitor(room.area)
    )
    alone, two, eight = scalar(THREADS, path).splitlines()
    assert alone == two == eight
    assert len(set(alone.split())) == 3


def test_progress_never_runs_back(room, scalar):
    path = room.write(
        board(painted(0.8)), camera=room.camera((4, 5)), monitor=room.monitor(room.area)
    )
    told = np.array(scalar(PROGRESS, path).split(), float)
    assert len(told) > 8 and np.all(np.diff(told) >= 0) and told[-1] == 1


def test_same_seed_gives_the_same_bytes_and_another_does_not(room, sent):
    path = room.write(
        board(painted(0.8)), camera=room.camera((4, 5)), monitor=room.monitor(room.area)
    )
    found, _ = sent(path, None, 0.05, [3, 3, 4])
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[2] - found[0]).min() > 0


def test_walls_that_mitsubas_cameras_cannot_tell_are_refused_by_name(room, scalar):
    glossy = '<bsdf type="roughplastic"><float name="alpha" value="0.4"/></bsdf>'
    paths = [
        room.write(board(painted(0.8)), wall=room.wall(wall), monitor=room.monitor(room.area))
        for wall in (glossy, painted("0.9, 0, 0.3"))
    ]
    refused, black = scalar(WORDS, *paths).splitlines()
    assert "in scalar variants light that bounces is known of diffuse walls" in refused
    assert f"in scalar variants the wall of scene '{paths[1]}' must be black nowhere" in black
