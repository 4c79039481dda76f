"""The matrix A in scalar_rgb, rendered in a process of its own."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import profile_matrix, render_transport

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


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("hidden", [(1, 2), (2, 1), (1, 1)])
def test_single_rows_and_columns_of_patches_are_lit_alone(room, render, hidden):
    path = room.write(monitor=room.monitor(room.area))
    scalar = render(path, hidden, 1024, [0, 1, 2])
    vectorized = render_transport(load_scenario(path, hidden), pixel_samples=16)
    np.testing.assert_allclose(scalar, np.broadcast_to(vectorized, scalar.shape), rtol=0.05)


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
@pytest.mark.parametrize("kind", ["rectangle", "flipped", "mirrored mesh", "colored wall"])
def test_matrix_is_the_vectorized_one_within_the_noise(room, render, same_mean, kind):
    parts = {
        "rectangle": lambda: {"monitor": room.monitor(room.area)},
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


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
def test_falloff_is_right_up_to_its_curvature_over_a_patch(room, render):
    path = room.write(monitor=room.monitor(scale=(0.1, 0.05), turn=170, tilt=10))
    scalar = render(path, (4, 4), 4096, [0])[0]
    vectorized = render_transport(load_scenario(path, (4, 4)), strata="midpoint", pixel_samples=16)
    np.testing.assert_allclose(scalar, vectorized, rtol=0.01)
    assert vectorized.max() > 2 * vectorized.min()


DETAILS = """
import sys
import numpy as np
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
plain, lamp, unknown = sys.argv[1:]
seen = load_scenario(plain, (1, 2))
fractions = []
out = np.empty(seen.transport_shape, np.float32)
A = render_transport(seen, samples=16, seed=3, out=out, progress=fractions.append)
assert A is out
assert fractions == [0.5, 1.0], fractions
again = render_transport(seen, samples=16, seed=3)
assert A.tobytes() == again.tobytes()
assert (A != render_transport(seen, samples=16, seed=4)).all()
alone = render_transport(load_scenario(lamp, (1, 2)), samples=16, seed=3)
np.testing.assert_allclose(alone, A, rtol=1e-5)
try:
    render_transport(load_scenario(unknown, (1, 2)), samples=1)
except SceneError as error:
    print(error)
"""


def test_seeds_progress_other_lights_and_unknown_emitters(room, scalar):
    lamp = (
        '<emitter type="point"><point name="position" value="1, 0.2, 0.4"/>'
        '<rgb name="intensity" value="3"/></emitter>'
    )
    unknown = room.write(monitor=room.monitor(room.area.replace("area", "directionalarea")))
    message = scalar(DETAILS, room.write(), room.write(lamp), unknown)
    assert "in scalar variants the monitor's emitter must be an 'area' or 'lcd'" in message
    assert message.count("\n") == 1


def test_profile_matrix_is_the_profile_from_patch_to_pixel(room):
    seen = room.load(hidden=(2, 3))
    profile = profile_matrix(seen)
    for pixel, patch in [(0, 0), (17, 4), (29, 2)]:
        ray = seen.wall_points[pixel] - seen.patch_centers[patch]
        expected = np.cos(np.arctan2(ray[2], ray[1])) ** 18 * np.cos(np.arctan2(ray[0], ray[1]))
        assert profile[pixel, patch] == pytest.approx(expected, rel=1e-6)


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
