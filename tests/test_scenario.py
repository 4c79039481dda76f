import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from periscopy_sim.scene import EmissionProfile
from periscopy_sim.view import rises, wall_frame


def hemisphere(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(3, count))
    directions[2] = np.abs(directions[2])
    return directions


def field(rows=3, columns=4):
    """Points of a wall at y = 2 as seen by a viewer who looks along y with z up."""
    x, z = np.meshgrid(np.linspace(1.0, 2.2, columns), np.linspace(1.5, 0.7, rows))
    points = np.stack([x, np.full_like(x, 2.0), z], axis=-1).reshape(-1, 3)
    return points, np.tile([0.0, -1.0, 0.0], (len(points), 1))


@pytest.mark.parametrize("exponents", [(18, 1), (20, 0), (0, 2.5), (0, 0)])
def test_profile_is_a_power_of_the_cosine_of_each_angle(exponents):
    across, up, normal = hemisphere(500)
    vertical, horizontal = np.arctan2(up, normal), np.arctan2(across, normal)
    expected = np.cos(vertical) ** exponents[0] * np.cos(horizontal) ** exponents[1]
    np.testing.assert_allclose(EmissionProfile(*exponents)(across, up, normal), expected, 1e-9)


@pytest.mark.parametrize("exponents", [(18, 1), (0, 0)])
def test_nothing_is_emitted_backwards_or_within_the_screens_plane(exponents):
    across, up, normal = hemisphere(100)
    profile = EmissionProfile(*exponents)
    np.testing.assert_array_equal(profile(across, up, -normal), 0)
    in_plane = np.array([[1.0, 0, 0], [0, 1, 0], [1, 1, 0]]).T
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(profile(*in_plane), 0)


@pytest.mark.parametrize("seed", range(4))
def test_frame_follows_the_photograph_however_the_wall_stands(seed):
    points, normals = field()
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    shift = np.array([3.0, -5.0, 0.5])
    frame = wall_frame(points @ turn.T + shift, normals @ turn.T, (3, 4))
    np.testing.assert_allclose(frame.center, turn @ [1.6, 2.0, 1.1] + shift, atol=1e-12)
    np.testing.assert_allclose(frame.across, turn @ [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(frame.normal, turn @ [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(frame.up, turn @ [0, 0, 1], atol=1e-12)


@settings(deadline=None)
@given(
    shape=st.tuples(st.integers(1, 6), st.integers(2, 6)),
    seed=st.integers(0, 10_000),
    roughness=st.floats(0, 0.05),
    distance=st.floats(0, 1e3),
)
def test_frame_holds_every_point_of_any_wall(shape, seed, roughness, distance):
    rng = np.random.default_rng(seed)
    points, normals = field(*shape)
    points = Rotation.random(rng=rng).apply(points + roughness * rng.normal(size=points.shape))
    normals = Rotation.random(rng=rng).apply(normals + 0.2 * rng.normal(size=normals.shape))
    points += distance * rng.normal(size=3)
    frame = wall_frame(points, normals / np.linalg.norm(normals, axis=1, keepdims=True), shape)
    axes = np.stack([frame.across, frame.up, frame.normal])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    coordinates = (points - frame.center) @ axes.T
    np.testing.assert_allclose(coordinates.mean(axis=0), 0, atol=1e-9 * (1 + distance))
    np.testing.assert_allclose(
        frame.center + coordinates @ axes, points, atol=1e-9 * (1 + distance)
    )


def test_rolled_cameras_columns_say_what_is_across():
    points, normals = field()
    rolled = points.reshape(3, 4, 3).transpose(1, 0, 2)[:, ::-1].reshape(-1, 3)
    frame = wall_frame(rolled, normals, (4, 3))
    np.testing.assert_allclose(frame.across, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(frame.up, [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_frame_without_columns_or_of_some_pixels_turns_with_the_scene(seed):
    points, normals = field()
    some, corners = [3, 5, 6, 10], points[[0, 3, 11, 8]]
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    for frame in (
        wall_frame(points[::4] @ turn.T, normals[::4] @ turn.T, (3, 1)),
        wall_frame(points[some] @ turn.T, normals[some] @ turn.T, (3, 4), corners @ turn.T),
    ):
        np.testing.assert_allclose(frame.across, turn @ [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(frame.up, turn @ [0, 0, 1], atol=1e-12)
    frame = wall_frame(points[:1], normals[:1], (1, 1))
    assert abs(frame.across @ frame.normal) < 1e-12


def test_neighbours_rise_above_a_wall_that_bends_towards_the_room_and_not_else():
    angle = np.linspace(-0.2, 0.2, 5)
    up = np.arange(3.0)
    grid = np.stack(
        np.broadcast_arrays(2 * np.sin(angle), 2 - 2 * np.cos(angle), up[:, None]), axis=-1
    )
    normals = np.stack(np.broadcast_arrays(-np.sin(angle), np.cos(angle), 0 * up[:, None]), axis=-1)
    points, normals = grid.reshape(-1, 3), normals.reshape(-1, 3)
    # A neighbour is 0.1 rad away on a circle of radius 2.
    np.testing.assert_allclose(rises(points, normals, (3, 5)), 2 * (1 - np.cos(0.1)), rtol=1e-12)
    np.testing.assert_allclose(rises(points, -normals, (3, 5)), 0, atol=1e-12)
    flat = np.stack(np.meshgrid(angle, [1.0], up), axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(rises(flat, np.tile([0, -1.0, 0], (15, 1)), (3, 5)), 0)
    assert rises(points[:1], normals[:1], (1, 1)) == [0]
