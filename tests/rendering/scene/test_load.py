import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.scenario import load_scenario
from periscopy_sim.scene import EmissionProfile
from periscopy_sim.shipped import find_scene


def test_two_sided_wall_is_seen_from_behind(room):
    two_sided = room.wall(f'<bsdf type="twosided">{room.diffuse}</bsdf>', angle=-90)
    seen = room.load(wall=two_sided)
    np.testing.assert_allclose(seen.view.center_normals, np.tile([0, -1, 0], (30, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.view.reflectance, 0.5, rtol=1e-6)


def test_orthographic_pixels_see_a_regular_grid_with_row_0_on_top(room):
    seen = room.load()
    assert seen.photograph_shape == (5, 6)
    x = 0.5 + 0.4 * (np.arange(6) + 0.5) / 6
    z = 0.3 - 0.4 * (np.arange(5) - 2) / 6
    grid = seen.view.centers.reshape(5, 6, 3)
    np.testing.assert_allclose(grid[..., 0], np.tile(x, (5, 1)), atol=1e-6)
    np.testing.assert_allclose(grid[..., 1], 1, atol=1e-6)
    np.testing.assert_allclose(grid[..., 2], np.tile(z[:, None], (1, 6)), atol=1e-6)
    np.testing.assert_allclose(seen.view.center_normals, np.tile([0, -1, 0], (30, 1)), atol=1e-6)


def test_perspective_pixels_see_what_a_pinhole_sees(room):
    origin, target, fov = np.array([1.3, -0.2, 0.6]), np.array([0.6, 1.0, 0.25]), 17.0
    camera = (
        f'<sensor type="perspective" id="camera"><float name="fov" value="{fov}"/>'
        '<string name="fov_axis" value="x"/><transform name="to_world">'
        '<lookat origin="1.3, -0.2, 0.6" target="0.6, 1, 0.25" up="0, 0, 1"/></transform>'
        '<film type="hdrfilm"><integer name="width" value="7"/>'
        '<integer name="height" value="4"/></film></sensor>'
    )
    seen = room.load(camera=camera)
    forward = (target - origin) / np.linalg.norm(target - origin)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    pixel = 2 * np.tan(np.radians(fov / 2)) / 7
    for row in range(4):
        for column in range(7):
            ray = forward + pixel * ((column - 3) * right + (1.5 - row) * up)
            hit = origin + ray * (1 - origin[1]) / ray[1]
            index = 7 * row + column
            np.testing.assert_allclose(seen.view.centers[index], hit, atol=3e-6)


def test_patches_run_from_a_viewers_upper_left(room):
    seen = room.load(hidden=(2, 3))
    x = 0.4 - 0.4 * (np.arange(3) + 0.5) / 3
    z = [0.375, 0.225]
    expected = [[x[c], 0, z[r]] for r in range(2) for c in range(3)]
    np.testing.assert_allclose(seen.hidden.centers, expected, atol=1e-6)
    np.testing.assert_allclose(seen.hidden.across, np.tile([-0.4 / 3, 0, 0], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.hidden.up, np.tile([0, 0, 0.15], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.hidden.normals, np.tile([0, 1, 0], (6, 1)), atol=1e-6)
    assert not seen.hidden["monitor"].mirrored
    assert seen.scene.emission["monitor"] == EmissionProfile(18, 1)


def test_tilted_and_scaled_monitor_carries_its_patches_along(room):
    seen = room.load(monitor=room.monitor(scale=(0.3, 0.05), turn=165, tilt=-25), hidden=(3, 2))
    turn = Rotation.from_euler("x", -25, degrees=True) * Rotation.from_euler("z", -15, degrees=True)
    right, up, normal = turn.apply([[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
    np.testing.assert_allclose(seen.hidden.across, np.tile(0.3 * right, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.hidden.up, np.tile(0.1 / 3 * up, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.hidden.normals, np.tile(normal, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(
        seen.hidden.centers[0], [0.2, 0, 0.3] - 0.15 * right + 0.1 / 3 * up, atol=1e-6
    )
    areas = np.linalg.norm(np.cross(seen.hidden.across, seen.hidden.up), axis=1)
    np.testing.assert_allclose(areas, 0.01, rtol=1e-5)


@pytest.mark.parametrize(("flip", "turn", "width"), [(True, 0, 0.2), (False, 180, -0.2)])
def test_flipped_or_mirrored_rectangle_has_the_patches_of_a_plain_one(room, flip, turn, width):
    plain = room.load()
    other = room.load(monitor=room.monitor(flip=flip, turn=turn, scale=(width, 0.15)))
    for name in ("centers", "normals", "across", "up"):
        np.testing.assert_allclose(
            getattr(other.hidden, name), getattr(plain.hidden, name), atol=1e-6
        )


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_curved_mesh_is_cut_into_patches_along_its_curve(room, flip, mirrored):
    monitor = room.curved_monitor(room.area, mirrored=mirrored, flip=flip)
    seen = room.load(monitor=monitor, hidden=(2, 8))
    assert seen.hidden["monitor"].mirrored == mirrored
    # Patches of two facets each; their middles lie on the seams, 0.4 rad to either side at most.
    angle = 0.8 * ((np.arange(8) + 0.5) / 8 - 0.5)
    x, y = 0.2 - 0.5 * np.sin(angle), 0.5 - 0.5 * np.cos(angle)
    expected = [[x[c], y[c], z] for z in (0.375, 0.225) for c in range(8)]
    np.testing.assert_allclose(seen.hidden.centers, expected, atol=1e-6)
    facet = 2 * 0.5 * np.sin(0.025)
    areas = np.linalg.norm(np.cross(seen.hidden.across, seen.hidden.up), axis=1)
    np.testing.assert_allclose(areas, 2 * facet * 0.15, rtol=1e-5)
    towards_axis = np.array([0.2, 0.5]) - seen.hidden.centers[:, :2]
    assert np.all(np.sum(seen.hidden.normals[:, :2] * towards_axis, axis=1) > 0.499 * np.cos(0.026))
    assert np.all(seen.hidden.across[:, 0] < 0)


def test_shapes_without_ids_are_occluders_of_their_own(room):
    cube = (
        '<shape type="cube"><transform name="to_world"><scale value="0.01"/>{}</transform>'
        f"{room.black}</shape>"
    )
    low, high = room.load(cube.format(""), cube.format('<translate y="0.5"/>')).scene.occluders
    assert low.name != high.name
    assert high.vertices[:, 1].min() - low.vertices[:, 1].max() == pytest.approx(0.48, abs=1e-6)


PLATE = """<shape type="rectangle" id="plate"><transform name="to_world"><scale x="0.05" y="0.07"/>
<rotate x="1" angle="70"/><translate x="0.45" y="0.5" z="0.3"/></transform></shape>"""
AXES = [(1, 0, 0), (0, 0.6, 0.8), (2 / 3, -1 / 3, 2 / 3)]


def framed(room, transform=""):
    """Load the room with a plate, all of it in another frame."""
    path = room.write(PLATE, camera=room.camera((10, 12)))
    path.write_text(path.read_text().replace("</transform>", f"{transform}</transform>"))
    return load_scenario(path, (2, 3))


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.fixture
def original(room):
    """A and B of the room where it stands."""
    scenario = framed(room)
    return area_transport(scenario), point_light_backgrounds(scenario)


@settings(max_examples=4, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@given(
    axis=st.sampled_from(AXES),
    angle=st.floats(-180, 180),
    scale=st.sampled_from([0.01, 0.3, 1, 39.37, 1000]),
    shift=st.tuples(*[st.floats(-10, 10)] * 3),
    is_mirrored=st.booleans(),
)
@example(axis=AXES[2], angle=-90.35, scale=1000, shift=(8, 0, 0), is_mirrored=False)
def test_a_scene_moved_turned_scaled_or_mirrored_is_the_same(
    room, original, axis, angle, scale, shift, is_mirrored
):
    """Single precision, 10 m from a field of view of 0.4 m: 3e-5. A mirror swaps left and right."""
    x, y, z = axis
    place = " ".join(f'{name}="{scale * each}"' for name, each in zip("xyz", shift, strict=True))
    scenario = framed(
        room,
        f'<scale x="{-scale if is_mirrored else scale}" y="{scale}" z="{scale}"/>'
        f'<rotate x="{x}" y="{y}" z="{z}" angle="{angle}"/><translate {place}/>',
    )
    A = area_transport(scenario).reshape(-1, 2, 3)
    A = A[..., ::-1] if is_mirrored else A
    assert relative(A.reshape(-1, 6), original[0]) < 3e-4
    B = scale**2 * point_light_backgrounds(scenario)
    if not is_mirrored:  # the grid begins at -3 m, and ends before 3 m
        assert relative(B, original[1]) < 3e-4
    rendered = render_transport(scenario, samples=64).reshape(-1, 2, 3)
    assert relative(rendered[..., ::-1] if is_mirrored else rendered, A) < 0.03


def test_what_single_precision_does_not_resolve_is_refused(room):
    framed(room, '<translate x="200"/>')
    for place in ('x="1e4"', 'y="-1e6"', 'z="1e30"'):
        with pytest.raises(SceneError, match=r"origin|camera|scene"):
            framed(room, f"<translate {place}/>")
    with pytest.raises(SceneError, match="camera"):
        load_scenario(CHAIR, (1, 1), {"camera_stretch": 0})


CHAIR = find_scene("chair")


def test_chair_turns_and_stretches_as_one_about_the_middle_of_its_seats_top():
    given = {"occluder_turn": 30, "occluder_stretch_x": 1.1, "occluder_stretch_z": 0.9}
    size, pivot = {"resolution": 1}, np.array([0.5435, 0.6315, 0.242])
    plain, moved = (
        load_scenario(CHAIR, (1, 1), size | more).scene.occluders for more in ({}, given)
    )
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    for before, after in zip(plain, moved, strict=True):
        expected = pivot + ((before.vertices - pivot) * [1.1, 1, 0.9]) @ turn.T
        np.testing.assert_allclose(after.vertices, expected, atol=1e-6)
