"""Several hidden surfaces of one scene: in A by areas and by rays, bounces and photographs."""

import mitsuba as mi
import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import SceneError

SIZES = {"monitor": (2, 3), "hidden_card": (3, 2)}
"""Of the card, which has no emitter, stands 0.3 m before the right half of the monitor."""

CARD = """<shape type="rectangle" id="hidden_card"><transform name="to_world">
<scale x="0.08" y="0.1"/><rotate x="1" angle="90"/><rotate z="1" angle="180"/>
<translate x="0.1" y="0.3" z="0.3"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></shape>"""

NULL = '<bsdf type="null"/><emitter type="area"><rgb name="radiance" value="1"/></emitter>'

PLATE = """<shape type="rectangle" id="plate"><transform name="to_world">
<scale x="0.05" y="0.04"/><rotate x="1" angle="90"/><translate x="0.45" y="0.6" z="0.3"/>
</transform></shape>"""


@pytest.fixture
def two(room):
    path = room.write(PLATE + CARD, monitor=room.monitor(room.area))
    return ps.load_scenario(path, SIZES)


@pytest.fixture
def images():
    rng = np.random.default_rng(0)
    return {name: rng.random((*size, 3)) for name, size in SIZES.items()}


def test_each_surface_lights_the_wall_and_hides_the_other(two, images):
    """Against Mitsuba's path tracer, whose noise is some 2e-3 of the mean."""
    y = ps.render_photograph(two, images, samples=1 << 13, bounces=1, seed=1)
    for by in ("areas", "rays"):
        A = ps.transport(two, by=by, noise=0.02)
        lit = (A @ two.hidden.vector(images)).reshape(y.shape)
        np.testing.assert_allclose(lit, y, rtol=0, atol=0.02 * y.mean())
    assert two.hidden.slices == {"monitor": slice(0, 6), "hidden_card": slice(6, 12)}


@pytest.mark.parametrize("bounces", [1, 3])
def test_a_transparent_surface_hides_nothing(room, images, bounces):
    """A photograph of both is the sum of those of either alone, the other out of the scene."""
    card = CARD.replace(CARD[CARD.index("<bsdf") : CARD.index("</shape>")], NULL)
    two = ps.load_scenario(room.write(PLATE + card, monitor=room.monitor(room.area)), SIZES)
    alone = (
        ps.load_scenario(room.write(PLATE, monitor=room.monitor(room.area)), SIZES["monitor"]),
        ps.load_scenario(room.write(PLATE + card, monitor=""), SIZES["hidden_card"]),
    )
    options = {"samples": 1 << 13, "bounces": bounces, "seed": 1}
    y = ps.render_photograph(two, images, **options)
    if bounces == 1:
        for by in ("areas", "rays"):
            lit = (ps.transport(two, by=by, noise=0.02) @ two.hidden.vector(images)).reshape(
                y.shape
            )
            np.testing.assert_allclose(lit, y, rtol=0, atol=0.02 * y.mean())
    else:
        parts = [
            ps.render_photograph(each, image, **options)
            for each, image in zip(alone, images.values(), strict=True)
        ]
        np.testing.assert_allclose(y, sum(parts), rtol=0, atol=0.02 * y.mean())
        with pytest.raises(SceneError, match="'hidden_card' is transparent"):
            ps.transport(two, bounces=bounces)


def test_light_that_bounces_is_told_apart_by_surface(room):
    """A white wall and a white monitor: the card's light returns from both, and none is lost."""
    monitor = room.monitor(room.area, inside=room.diffuse)
    scene = ps.load_scenario(room.write(CARD, monitor=monitor), SIZES)
    bounced = ps.render_bounced_light(scene, bounces=3, target=5e-3, seed=0)
    A = bounced.over_wall @ bounced.mean
    assert A.shape == scene.transport_shape
    for name, part in scene.hidden.slices.items():
        white = {n: np.full((1, 1, 3), float(n == name)) for n in SIZES}
        both, once = (
            ps.render_photograph(scene, white, samples=1 << 12, bounces=b, seed=2) for b in (3, 1)
        )
        expected = (both - once).mean()
        assert A[:, part].sum(axis=1).mean() == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("sizes", "offender"),
    [
        ((2, 3), "'hidden_card'"),
        ({"monitor": (2, 3)}, "'hidden_card'"),
        ({**SIZES, "hidden_cord": (1, 1)}, "'monitor', 'hidden_card', no 'hidden_cord'"),
        ({**SIZES, "monitor": (9, 9)}, "9x9"),
    ],
)
def test_each_surface_needs_a_size(two, sizes, offender):
    with pytest.raises(SceneError, match=offender):
        ps.load_scenario(two.path, sizes)


def placed(card, turn=180, x=0.1, y=0.3):
    """Return the card's tag, elsewhere."""
    place = f'<rotate z="1" angle="{turn}"/>\n<translate x="{x}" y="{y}" z="0.3"/>'
    moved = card.replace('<rotate z="1" angle="180"/>\n<translate x="0.1" y="0.3" z="0.3"/>', place)
    assert place in moved
    return moved


@pytest.mark.parametrize(
    ("card", "offender"),
    [
        (placed(CARD, turn=0), "'hidden_card' faces away"),
        (placed(CARD, y=1.5), "'hidden_card' faces away .* or is behind it"),
        (placed(CARD, x=0.35, y=0), "'monitor' coincides with 'hidden_card' in 20% of its area"),
    ],
)
def test_a_surface_that_nothing_sees_or_that_lies_in_another_is_an_error(room, card, offender):
    path = room.write(card, monitor=room.monitor(room.area))
    with pytest.raises(SceneError, match=offender):
        ps.load_scenario(path, SIZES)


@pytest.mark.parametrize("by", ["areas", "rays"])
def test_a_surface_whose_light_is_kept_off_the_wall_is_an_error(room, by):
    before = room.cube((0.1, 0.4, 0.3), (0.3, 0.01, 0.4))
    monitor = room.monitor(room.area).replace('x="0.2" y="0"', 'x="0.7" y="0"')
    scene = ps.load_scenario(room.write(CARD, before, monitor=monitor), SIZES)
    with pytest.raises(SceneError, match="no light of 'hidden_card'"):
        ps.transport(scene, by=by)


def test_surfaces_side_by_side_in_one_plane_light_the_wall_as_one_does(room):
    half = '<translate x="0.1" y="0" z="0.3"/>'
    monitor = room.monitor(room.area, scale=(0.1, 0.15))
    right = monitor.replace('id="monitor"', 'id="hidden_right"').replace(
        '<translate x="0.2" y="0" z="0.3"/>', half
    )
    left = monitor.replace('x="0.2" y="0"', 'x="0.3" y="0"')
    sizes = {"monitor": (2, 2), "hidden_right": (2, 2)}
    two = ps.load_scenario(room.write(PLATE, right, monitor=left), sizes)
    one = ps.load_scenario(room.write(PLATE, monitor=room.monitor(room.area)), (2, 4))
    whole = ps.transport(one, by="areas").reshape(-1, 2, 4)
    parts = two.hidden.split(ps.transport(two, by="areas").T).values()
    np.testing.assert_allclose(
        np.concatenate([each.transpose(2, 0, 1) for each in parts], axis=2),
        whole, rtol=1e-4, atol=1e-6 * whole.max(),
    )  # fmt: skip


def test_bounced_light_of_some_pixels_has_their_rows(two):
    pixels = np.zeros(two.photograph_shape, bool)
    pixels[1:3, 2:] = True
    part = ps.Scenario(two.view.of_pixels(pixels), two.hidden)
    some, whole = (ps.render_bounced_light(each, bounces=2, target=0.1) for each in (part, two))
    np.testing.assert_array_equal(some.over_wall, whole.over_wall[pixels.ravel()])


def test_spherical_caps_are_accepted_and_light_the_wall_as_they_do_in_mitsuba(room):
    """Part of a sphere whose faces cut its UV square otherwise than patches do."""
    faces = 13
    u, v = np.meshgrid(*[np.linspace(0, 1, faces + 1)] * 2, indexing="ij")
    across, up = np.radians(40) * (u - 0.5), np.radians(30) * (v - 0.5)
    x, z = 0.2 - 0.6 * np.sin(across) * np.cos(up), 0.3 + 0.6 * np.sin(up)
    y = 0.6 - 0.6 * np.cos(across) * np.cos(up)
    cap = mi.Mesh("cap", (faces + 1) ** 2, 2 * faces**2, has_vertex_texcoords=True)
    numbers = np.arange((faces + 1) ** 2).reshape(faces + 1, faces + 1)
    corners = numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]
    a, b, c, d = (each.ravel() for each in corners)
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    params = mi.traverse(cap)
    params["vertex_positions"] = np.stack([x, y, z], -1).ravel().astype("f4")
    params["vertex_texcoords"] = np.stack([u, v], -1).ravel().astype("f4")
    params["faces"] = triangles.ravel().astype("u4")
    params.update()
    file = room.folder / f"cap{faces}.ply"
    cap.write_ply(str(file))
    monitor = (
        f'<shape type="ply" id="monitor"><string name="filename" value="{file}"/>'
        f"{room.black}{room.area}</shape>"
    )
    scene = ps.load_scenario(room.write(room.blocker(), monitor=monitor), (3, 4))
    image = np.random.default_rng(faces).random((3, 4, 3))
    picture = ps.render_photograph(scene, image, samples=1 << 14, bounces=1, seed=1)
    lit = (ps.transport(scene, noise=0.02) @ image.reshape(-1, 3)).reshape(picture.shape)
    np.testing.assert_allclose(lit, picture, rtol=0, atol=0.015 * picture.mean())
