"""Light that bounces, against closed forms and Mitsuba's own path tracer."""

import numpy as np
import pytest

from periscopy_sim.rendering import bounced
from periscopy_sim.rendering.bounced import add_bounces, render_bounced_light
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.rendering.variant import dr
from periscopy_sim.scenario import load_scenario
from tests.scenes.materials import GLOSSY, SLOPE, painted, write_files
from tests.scenes.room import Room

SHINY = '<bsdf type="conductor"/>'


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


@pytest.mark.parametrize(
    ("bounces", "parts", "target"),
    [
        (2, {"board": painted("0.8, 0.4, 0.2")}, 2e-3),
        pytest.param(
            None,
            {"board": painted("0.8, 0.4, 0.2"), "floor": painted("0.5, 0.6, 0.7")},
            2e-3,
            marks=pytest.mark.thorough,
        ),
        pytest.param(3, {"board": GLOSSY, "floor": painted(0.8)}, 2e-3, marks=pytest.mark.thorough),
        pytest.param(None, {"floor": SHINY}, 1e-2, marks=pytest.mark.thorough),
    ],
    ids=["once more", "corner", "glossy", "mirror"],
)
def test_matrix_with_bounces_is_the_path_traced_photograph(room, agrees, bounces, parts, target):
    shapes = [{"board": board, "floor": floor}[name](bsdf) for name, bsdf in parts.items()]
    seen = room.load(*shapes, monitor=room.monitor(room.lcd(2, 1), inside=painted(0.6)))
    predicted = agrees(seen, bounces, seeds=8, samples=1024, target=target)
    assert predicted.mean() > 1.02 * agrees(seen, seeds=2, samples=64).mean()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "wall",
    [
        painted("0.9, 0.5, 0.3"),
        '<bsdf type="roughplastic"><float name="alpha" value="0.4"/></bsdf>',
        SLOPE,
    ],
    ids=["coloured", "glossy", "sloping"],
)
def test_walls_of_any_reflection_send_it_on(room, agrees, wall):
    write_files(room.folder)
    seen = room.load(
        board(painted("0.8, 0.6, 0.4")),
        wall=room.wall(wall),
        camera=room.camera((18, 20)),
        monitor=room.monitor(room.lcd(2, 1)),
    )
    agrees(seen, None, seeds=8)


@pytest.mark.thorough
def test_in_a_sphere_it_is_a_geometric_series(tmp_path):
    """What a sphere of albedo ρ sends on is even: ρ²/(1 - ρ) of the power over π and its area."""
    albedo, half = 0.9, 0.02
    path = tmp_path / "sphere.xml"
    path.write_text(f"""<scene version="3.0.0">
<sensor type="perspective" id="camera"><float name="fov" value="30"/><transform name="to_world">
<lookat origin="0, -0.5, 0.3" target="0, 1, 0" up="0, 0, 1"/></transform><film type="hdrfilm">
<integer name="height" value="3"/><integer name="width" value="4"/><rfilter type="box"/></film>
</sensor>
<shape type="sphere" id="wall"><bsdf type="twosided"><bsdf type="diffuse">
<rgb name="reflectance" value="{albedo}"/></bsdf></bsdf></shape>
<shape type="rectangle" id="monitor"><transform name="to_world"><scale value="{half}"/>
<rotate x="1" angle="-90"/><translate z="-0.3"/></transform>
{Room.area}{Room.black}</shape></scene>""")
    light = render_bounced_light(load_scenario(path, (1, 1)), target=3e-3)
    power, area = np.pi * (2 * half) ** 2, 4 * np.pi
    expected = albedo**2 / (1 - albedo) * power / (np.pi * area)
    # What falls on the monitor's black back and front is lost: its sides over the sphere's area.
    lost = 2 * (2 * half) ** 2 / area / (1 - albedo)
    found = light.rows(slice(None))[:, 0].mean()
    assert found == pytest.approx(expected * (1 - lost), rel=1e-2)


@pytest.mark.thorough
def test_reported_error_is_that_of_a_white_photograph(room):
    seen = room.load(board(painted("0.8, 0.4, 0.2")), camera=room.camera((18, 20)), hidden=(4, 5))
    A = render_transport(seen.averaged(2))
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


@pytest.mark.usefixtures("few_paths")
def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(room):
    seen = room.load(board(painted("0.8, 0.4, 0.2")))
    first, again = (render_bounced_light(seen, target=1, seed=3) for _ in range(2))
    other = render_bounced_light(seen, target=1, seed=4)
    threads = dr.thread_count()
    try:
        dr.set_thread_count(1)
        alone = render_bounced_light(seen, target=1, seed=3)
    finally:
        dr.set_thread_count(threads)
    assert first.of_patches.tobytes() == again.of_patches.tobytes() == alone.of_patches.tobytes()
    assert first.of_patches.tobytes() != other.of_patches.tobytes()


def test_without_surroundings_nothing_bounces_and_direct_light_is_as_before(room):
    seen = room.load()
    direct = render_transport(seen)
    A = add_bounces(seen, direct.copy())
    assert not A.bounced.of_patches.any()
    assert np.asarray(A).tobytes() == direct.tobytes()


@pytest.mark.usefixtures("few_paths")
def test_rows_and_columns_of_patches_have_the_sums_of_their_light(room):
    """By the same paths, whatever the patches."""
    sites, traced = np.arange(30), {}
    for size in ((2, 3), (2, 1), (1, 3)):
        seen = room.load(board(painted("0.8, 0.4, 0.2")), hidden=size)
        traced[size] = bounced.make_tracer(seen, sites, 2)(7).reshape(30, *size, 3)
    patches = traced[2, 3]
    assert (patches.sum(axis=0) > 0).all()
    for axis, size in ((1, (1, 3)), (2, (2, 1))):
        whole = traced[size]
        off = patches.sum(axis=axis, keepdims=True) - whole
        np.testing.assert_allclose(off, 0, atol=1e-5 * whole.max())


def test_an_array_of_it_is_the_channels_mean(room):
    seen = room.load(board(painted("0.8, 0.4, 0.2")))
    done = []
    A = add_bounces(seen, render_transport(seen), 2, progress=done.append)
    assert A.shape == seen.transport_shape
    assert done[-1] == 1
    assert done == sorted(done)
    channels = [A.mean + A.bounced.over_wall @ A.bounced.colour[c] for c in range(3)]
    np.testing.assert_allclose(np.mean(channels, axis=0), np.asarray(A), rtol=1e-5)
    f = np.random.default_rng(0).random((*seen.hidden_shape, 3)).reshape(-1, 3)
    by_channel = np.stack([channels[c] @ f[:, c] for c in range(3)], axis=1)
    np.testing.assert_allclose(A @ f, by_channel, rtol=1e-5)
    with pytest.raises(ValueError, match="channels"):
        A @ f[:, 0]


@pytest.mark.thorough
def test_shadows_that_a_small_mirror_sends_are_warned_of(room, monkeypatch):
    monkeypatch.setattr(bounced, "ROUNDS", 4)
    strip = board(SHINY, x=0.75, y=0.6, size=0.03)
    seen = room.load(strip, camera=room.camera((60, 60)), monitor=room.monitor(room.area))
    with pytest.warns(RuntimeWarning, match="not smooth over the wall"):
        light = render_bounced_light(seen)
    assert light.relative_error > 1e-3


@pytest.mark.parametrize("bounces", [0, 1, 2.5, True, "all"])
def test_absurd_bounces_are_refused(room, bounces):
    with pytest.raises((TypeError, ValueError)):
        render_bounced_light(room.load(), bounces=bounces)
