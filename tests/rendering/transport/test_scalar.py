"""The matrix A in scalar_rgb, rendered in a process of its own."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport

RENDER = """
import sys
import numpy as np
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
path, rows, columns, samples, out, *seeds = sys.argv[1:]
seen = load_scenario(path, (int(rows), int(columns)))
np.save(out, [render_transport(seen, samples=int(samples), seed=int(s)) for s in seeds])
"""


@pytest.fixture
def render(scalar, tmp_path):
    def run(path, hidden, samples, seeds):
        scalar(RENDER, path, *hidden, samples, tmp_path / "A.npy", *seeds)
        return np.load(tmp_path / "A.npy")

    return run


def test_entry_is_the_closed_form_integral_in_absolute_scale(room, render):
    path = room.write(monitor=room.monitor(room.area))
    A = render(path, (2, 3), 4096, [0])[0]
    assert A.dtype == np.float32
    # Pixel (1, 4) and patch (1, 0), by midpoints; the screen lies at y = 0, the wall at y = 1.
    points = np.array([0.7 + 0.4 / 6 * 1.5, 1, 0.3 + 0.4 / 6])
    u, v = (np.arange(100) + 0.5) / 100, (np.arange(100)[:, None] + 0.5) / 100
    x, z = 0.4 - 0.4 / 3 * u, 0.3 - 0.15 * v
    squared = (points[0] - x) ** 2 + 1 + (points[2] - z) ** 2
    expected = 0.5 / np.pi * np.mean(squared**-2.0) * (0.4 / 3 * 0.15)
    assert A[6 * 1 + 4, 3] == pytest.approx(expected, rel=5e-3)


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("kind", ["flipped", "mirrored mesh", "colored wall"])
def test_matrix_is_the_vectorized_one_within_the_noise(room, render, same_mean, kind):
    parts = {
        "flipped": lambda: {"monitor": room.monitor(room.area, flip=True, turn=0)},
        "mirrored mesh": lambda: {"monitor": room.curved_monitor(room.area, mirrored=True)},
        "colored wall": lambda: {
            "monitor": room.monitor(room.area),
            "wall": room.wall(room.diffuse.replace("0.5", "0.9, 0.3, 0.15")),
        },
    }[kind]()
    path = room.write(room.blocker(), camera=room.camera((8, 8)), **parts)
    # Each column has a seed of its own, counted from the given one.
    scalar = render(path, (2, 3), 256, range(0, 1000, 100))
    seen = load_scenario(path, (2, 3))
    vectorized = [
        render_transport(seen, samples=16, pixel_samples=16, seed=seed) for seed in range(10)
    ]
    same_mean(*(np.reshape(x, (10, -1)) for x in (scalar, vectorized)))


NEEDS_LLVM = """
import sys
import periscopy_sim as ps
from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.transport.shadow_rays import RenderedTransport
scene = ps.load_scenario(sys.argv[1], (1, 1))
for render in (
    lambda: ps.render_transport(scene, bounces=None),
    lambda: ps.render_bounced_light(scene),
    lambda: ps.render_background("ambient/overcast", scene),
    lambda: ps.emitter_backgrounds("ambient/window_left", scene),
    lambda: next(RenderedTransport(scene).row_blocks()),
):
    try:
        render()
    except VariantError:
        print("refused")
"""


def test_what_needs_a_vectorized_variant_is_refused(room, scalar):
    assert scalar(NEEDS_LLVM, room.write()).split() == 5 * ["refused"]
