"""Light that bounces, against closed forms and Mitsuba's own path tracer."""

import numpy as np
import pytest

from periscopy_sim.rendering.photograph import render_photograph
from periscopy_sim.rendering.transport import bounced
from periscopy_sim.rendering.transport.bounced import render_bounced_light
from periscopy_sim.rendering.transport.bounced_transport import BouncedTransport
from periscopy_sim.rendering.transport.row_blocks import RenderedTransport
from periscopy_sim.rendering.transport.shadow_rays import render_transport

pytestmark = pytest.mark.usefixtures("jit")

SEEDS = 8
GLOSSY = '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>'
SHINY = '<bsdf type="conductor"/>'


def painted(color):
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf>'


def checkered(first, second, squares):
    return (
        '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">'
        f'<rgb name="color0" value="{first}"/><rgb name="color1" value="{second}"/><transform '
        f'name="to_uv"><scale value="{squares}"/></transform></texture></bsdf>'
    )


def board(bsdf, *, x=1.0, y=0.5, size=0.3, angle=-90):
    """A board beside the field of view, which turns its front to it."""
    return (
        f'<shape type="rectangle" id="board">{bsdf}<transform name="to_world">'
        f'<scale value="{size}"/><rotate y="1" angle="{angle}"/>'
        f'<translate x="{x}" y="{y}" z="0.3"/></transform></shape>'
    )


def floor(bsdf):
    return (
        f'<shape type="rectangle" id="floor">{bsdf}<transform name="to_world">'
        '<translate x="0.4" y="0.1" z="0"/></transform></shape>'
    )


def hidden_image(shape, seed=0):
    return np.random.default_rng(seed).random((*shape, 3))


def predicted(seen, image, bounces, target=2e-3):
    """A f, once a seed, in color."""
    f = image.reshape(-1, 3)
    for seed in range(SEEDS):
        A = render_transport(seen, samples=16, pixel_samples=16, seed=seed)
        light = render_bounced_light(seen, bounces=bounces, target=target, seed=seed)
        A += light.rows(slice(None))
        photograph = BouncedTransport(A, light, bounces) @ f
        yield photograph * seen.channel_gain


def traced(seen, image, bounces, samples=1024):
    for seed in range(SEEDS):
        yield render_photograph(seen, image, samples=samples, bounces=bounces, seed=1000 + seed)


@pytest.mark.parametrize(
    ("bounces", "parts", "target"),
    [
        (2, {"board": painted("0.8, 0.4, 0.2")}, 2e-3),
        (None, {"board": painted("0.8, 0.4, 0.2"), "floor": painted("0.5, 0.6, 0.7")}, 2e-3),
        (3, {"board": GLOSSY, "floor": painted(0.8)}, 2e-3),
        (None, {"floor": SHINY}, 1e-2),
    ],
    ids=["once more", "corner", "glossy", "mirror"],
)
def test_matrix_with_bounces_is_the_path_traced_photograph(room, same_mean, bounces, parts, target):
    shapes = [{"board": board, "floor": floor}[name](bsdf) for name, bsdf in parts.items()]
    seen = room.load(*shapes, monitor=room.monitor(room.lcd(2, 1), inside=painted(0.6)))
    image = hidden_image(seen.hidden_shape)
    found = list(predicted(seen, image, bounces, target))
    same_mean(list(traced(seen, image, bounces)), found)
    direct = np.mean(list(traced(seen, image, 1)), axis=0)
    assert np.mean(found) > 1.02 * direct.mean()


@pytest.mark.parametrize(
    "wall",
    [
        painted("0.9, 0.5, 0.3"),
        checkered("0.9, 0.8, 0.2", "0.3, 0.2, 0.4", 40),
        checkered("0", "0.8", 40),
        '<bsdf type="roughplastic"><float name="alpha" value="0.4"/></bsdf>',
    ],
    ids=["coloured", "textured", "half black", "glossy"],
)
def test_walls_of_any_reflection_send_it_on(room, same_mean, wall):
    seen = room.load(
        board(painted("0.8, 0.6, 0.4")),
        wall=room.wall(wall),
        camera=room.camera((18, 20)),
        monitor=room.monitor(room.lcd(2, 1)),
    )
    image = hidden_image(seen.hidden_shape)
    same_mean(list(traced(seen, image, None, 256)), list(predicted(seen, image, None)))


def test_bent_and_mirrored_monitors_light_the_right_patches(room, same_mean):
    seen = room.load(
        board(painted(0.8)),
        floor(SHINY),
        monitor=room.curved_monitor(room.lcd(3, 2), mirrored=True),
        hidden=(3, 4),
    )
    image = hidden_image(seen.hidden_shape)
    same_mean(list(traced(seen, image, None, 4096)), list(predicted(seen, image, None, 1e-2)))


def test_a_small_distant_board_reflects_as_its_closed_form(room):
    size, where = 0.01, np.array([0.9, 0.4, 0.3])
    monitor = room.monitor(room.area, scale=(0.01, 0.01))
    seen = room.load(
        board(painted(0.7), x=where[0], y=where[1], size=size, angle=-90),
        monitor=monitor,
        camera=room.camera((1, 2)),
        hidden=(1, 1),
    )
    with pytest.warns(RuntimeWarning, match="light that bounces"):
        light = render_bounced_light(seen, bounces=2, target=1e-9)
    front, normal = np.array([-1.0, 0, 0]), np.array([0, -1.0, 0])
    source = np.array([0.2, 0, 0.3])
    to_source = source - where
    lit = (to_source @ front) * -(to_source @ np.array([0, 1.0, 0])) / (to_source @ to_source) ** 2
    radiosity = 0.7 / np.pi * lit * 0.02**2  # W/m²/sr of a white monitor
    to_board = where - seen.wall_points
    squared = np.sum(to_board**2, axis=1)
    form = (to_board @ normal) * -(to_board @ front) / squared**2
    expected = 0.5 / np.pi * radiosity * form * (2 * size) ** 2
    np.testing.assert_allclose(light.rows(slice(None))[:, 0], expected, rtol=0.02)


def test_told_error_is_that_of_a_white_photograph(room):
    seen = room.load(board(painted("0.8, 0.4, 0.2")), camera=room.camera((18, 20)), hidden=(4, 5))
    A = render_transport(seen, pixel_samples=4)
    exact = render_bounced_light(seen, target=2e-4, seed=99)
    assert exact.relative_error <= 2e-4

    def white(light):
        return light.over_wall @ light.of_patches.sum(axis=2).T.astype(np.float64)

    whole = A.sum(axis=1, dtype=np.float64)[:, np.newaxis] + white(exact)
    lights = [render_bounced_light(seen, target=3e-3, seed=seed) for seed in range(12)]
    off = [np.mean((white(light) - white(exact)) ** 2) / np.mean(whole**2) for light in lights]
    told = np.mean([light.relative_error**2 for light in lights])
    # Twelve photographs, whose smooth errors are of a few independent numbers each.
    assert 0.6 < np.sqrt(np.mean(off) / told) < 1.5


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(room):
    import drjit as dr

    seen = room.load(board(painted(0.8)), hidden=(4, 5))
    first, again = (render_bounced_light(seen, target=1, seed=3) for _ in range(2))
    other = render_bounced_light(seen, target=1, seed=4)
    threads = dr.thread_count()
    try:
        dr.set_thread_count(1)
        alone = render_bounced_light(seen, target=1, seed=3)
    finally:
        dr.set_thread_count(threads)
    assert first.of_patches.tobytes() == again.of_patches.tobytes() == alone.of_patches.tobytes()
    assert (first.of_patches != other.of_patches).any()


def test_without_surroundings_nothing_bounces_and_direct_light_is_as_before(room):
    seen = room.load()
    direct = render_transport(seen)
    assert render_transport(seen, bounces=1).tobytes() == direct.tobytes()
    A = render_transport(seen, bounces=None)
    assert isinstance(A, BouncedTransport)
    assert not A.bounced.of_patches.any()
    assert np.asarray(A).tobytes() == direct.tobytes()


def test_an_array_of_it_is_the_channels_mean_and_so_are_its_rows(room):
    seen = room.load(board(painted("0.8, 0.4, 0.2")))
    done = []
    A = render_transport(seen, bounces=2, progress=done.append)
    assert A.shape == seen.transport_shape
    assert done[-1] == 1
    assert done == sorted(done)
    channels = [A.channel(c) for c in range(3)]
    np.testing.assert_allclose(np.mean(channels, axis=0), np.asarray(A), rtol=1e-5)
    f = hidden_image(seen.hidden_shape).reshape(-1, 3)
    by_channel = np.stack([channels[c] @ f[:, c] for c in range(3)], axis=1)
    np.testing.assert_allclose(A @ f, by_channel, rtol=1e-5)
    rows = [block for _, block in RenderedTransport(seen, bounced=A.bounced).row_blocks()]
    np.testing.assert_allclose(np.concatenate(rows), np.asarray(A), rtol=1e-6)
    with pytest.raises(ValueError, match="channels"):
        A @ f[:, 0]


def test_what_is_not_known_well_is_warned_of(room, monkeypatch):
    monkeypatch.setattr(bounced, "ROUNDS", 1)
    seen = room.load(board(painted(0.8)))
    with pytest.warns(RuntimeWarning, match="light that bounces is known to"):
        render_bounced_light(seen, target=1e-7)


@pytest.mark.parametrize("bounces", [0, -1, 1.5, True])
def test_absurd_bounces_are_refused(room, bounces):
    with pytest.raises(ValueError, match="bounces"):
        render_transport(room.load(), bounces=bounces)


def test_scalar_variants_refuse_bounces(room, scalar):
    path = room.write(board(painted(0.8)))
    said = scalar(
        """
import sys, warnings
warnings.simplefilter("ignore")
from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
try:
    render_transport(load_scenario(sys.argv[1], (1, 2)), bounces=None)
except VariantError as error:
    print(error)
""",
        path,
    )
    assert "llvm_ad_rgb or cuda_ad_rgb only" in said
