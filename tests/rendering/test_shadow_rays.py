"""The matrix A against quadrature and brute force."""

import numpy as np
import pytest
from scipy import integrate
from scipy.spatial.transform import Rotation

from periscopy_sim.rendering import shadow_rays
from periscopy_sim.rendering.shadow_rays import RenderedTransport, render_transport


def closed_form(point, corner, across, up, exponents=(18, 1), albedo=0.5):
    """Radiance of a diffuse wall at y = 1 for a parallelogram of unit normal radiance."""
    normal = np.cross(across, up)
    area = np.linalg.norm(normal)
    axes = np.stack([across, up, normal])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)

    def integrand(t, s):
        ray = point - (corner + s * across + t * up)
        x, z, n = axes @ ray
        profile = (
            np.cos(np.arctan2(z, n)) ** exponents[0] * np.cos(np.arctan2(x, n)) ** exponents[1]
        )
        return profile * n * ray[1] / (ray @ ray) ** 2

    value, _ = integrate.dblquad(integrand, 0, 1, 0, 1, epsabs=0, epsrel=1e-7)
    return albedo / np.pi * area * value


def pixel_center(row, column):
    """Of the room's 5 x 6 pixels."""
    return np.array([0.5 + 0.4 * (column + 0.5) / 6, 1.0, 0.3 - 0.4 * (row - 2) / 6])


@pytest.mark.parametrize("exponents", [(18, 1), (0, 0)])
def test_entry_is_the_closed_form_integral_in_absolute_scale(room, exponents):
    seen = room.load(monitor=room.monitor(room.lcd(*exponents)), hidden=(2, 3))
    A = render_transport(seen, strata="midpoint", samples=1024)
    for row, column, patch_row, patch_column in [(0, 0, 0, 0), (2, 5, 1, 2), (4, 1, 0, 1)]:
        # A viewer's left is the largest x.
        corner = np.array([0.4 - 0.4 / 3 * patch_column, 0, 0.3 - 0.15 * patch_row])
        across, up = np.array([-0.4 / 3, 0, 0]), np.array([0, 0, 0.15])
        expected = closed_form(pixel_center(row, column), corner, across, up, exponents)
        assert A[6 * row + column, 3 * patch_row + patch_column] == pytest.approx(expected, 1e-4)


@pytest.mark.parametrize(("samples", "relative"), [(4, 1e-3), (64, 1e-5)])
def test_gauss_and_legendres_points_are_worth_many_midpoints(room, samples, relative):
    seen = room.load(hidden=(2, 3))
    truth = render_transport(seen, strata="midpoint", samples=4096)
    errors = {
        strata: np.abs(render_transport(seen, strata=strata, samples=samples) / truth - 1).max()
        for strata in ("gauss", "midpoint")
    }
    assert errors["gauss"] < relative
    assert errors["gauss"] < 0.1 * errors["midpoint"]


def test_falloff_is_about_the_axes_of_a_tilted_and_stretched_monitor(room):
    monitor = room.monitor(scale=(0.3, 0.05), turn=165, tilt=-25)
    A = render_transport(room.load(monitor=monitor, hidden=(1, 2)), strata="midpoint", samples=1024)
    turn = Rotation.from_euler("x", -25, degrees=True) * Rotation.from_euler("z", -15, degrees=True)
    right, above, _ = turn.apply([[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
    corner = [0.2, 0, 0.3] - 0.3 * right - 0.05 * above
    for pixel, patch in [(0, 0), (17, 1), (29, 0)]:
        expected = closed_form(
            pixel_center(*divmod(pixel, 6)), corner + 0.3 * patch * right, 0.3 * right, 0.1 * above
        )
        assert A[pixel, patch] == pytest.approx(expected, rel=2e-4)


def brute_force(points, lights, triangles):
    """Whether each segment from a point to a light crosses a triangle (Möller and Trumbore)."""
    ray = (lights[None] - points[:, None]).reshape(-1, 3)
    start = np.repeat(points, len(lights), axis=0)
    blocked = np.zeros(len(ray), bool)
    for a, b, c in triangles:
        p = np.cross(ray, c - a)
        determinant = p @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.sum(p * (start - a), axis=1) / determinant
            q = np.cross(start - a, b - a)
            v = np.sum(q * ray, axis=1) / determinant
            t = q @ (c - a) / determinant
        blocked |= (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)
    return blocked.reshape(len(points), len(lights))


@pytest.mark.parametrize("name", ["chair", "plate"])
def test_shadows_are_those_of_the_occluders_triangles(shipped, name):
    seen = shipped(name)
    A = render_transport(seen, strata="midpoint", samples=1)
    triangles = np.concatenate([each.vertices[each.faces] for each in seen.scene.occluders])
    blocked = brute_force(seen.view.centers, seen.hidden.centers, triangles)
    assert 0.03 < blocked.mean() < 0.5
    # A segment that grazes an edge may fall either way in single precision.
    assert np.mean((A == 0) != blocked) < 2e-4
    ray = seen.view.centers[:, None] - seen.hidden.centers
    distance = np.linalg.norm(ray, axis=2)
    profile = seen.scene.emission["monitor"](
        *np.moveaxis(ray @ [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], 2, 0)
    )
    areas = np.linalg.norm(np.cross(seen.hidden.across, seen.hidden.up), axis=1)
    unblocked = 0.8 / np.pi * profile * ray[..., 1] ** 2 / distance**4 * areas
    np.testing.assert_allclose(A[A > 0], unblocked[A > 0], rtol=2e-5)


def test_object_half_a_millimetre_before_the_monitor_hides_its_patch_alone(room):
    cover = (
        '<shape type="rectangle" id="cover"><transform name="to_world"><scale x="0.06" y="0.07"/>'
        '<rotate x="1" angle="90"/><translate x="0.3333" y="0.0005" z="0.375"/></transform></shape>'
    )
    bare = render_transport(room.load(hidden=(2, 3)), strata="midpoint", samples=1)
    A = render_transport(room.load(cover, hidden=(2, 3)), strata="midpoint", samples=1)
    assert not A[:, 0].any()
    np.testing.assert_array_equal(A[:, 1:], bare[:, 1:])


@pytest.mark.parametrize("across", [1, 2])
def test_same_seed_gives_the_same_bytes_and_another_seed_others(shipped, across):
    seen = shipped("chair").averaged(across)
    first, again, other = (render_transport(seen, seed=seed) for seed in (3, 3, 4))
    assert first.dtype == np.float32
    assert first.tobytes() == again.tobytes()
    lit = (first > 0) & (other > 0)
    assert np.mean(first[lit] != other[lit]) > 0.99


def test_strata_beat_independent_samples(room):
    """Of a smooth integrand n strata leave a variance of n^-2, not n^-1."""
    seen = room.load()
    spread = [
        np.std([render_transport(seen, samples=n, seed=s) for s in range(20)], axis=0).mean()
        for n in (1, 16)
    ]
    assert spread[1] < spread[0] / 12


@pytest.mark.parametrize("wrong", [{"samples": 0}, {"strata": "random"}])
def test_impossible_arguments_are_refused(room, wrong):
    with pytest.raises(ValueError):
        render_transport(room.load(), **wrong)


def test_jittered_samples_are_unbiased_in_penumbrae(room, same_mean):
    seen = room.load(room.blocker(), hidden=(2, 3))
    jittered = [render_transport(seen, samples=6, seed=seed) for seed in range(64)]
    # 128 x 128 samples: an error far below that of 384 jittered ones.
    exact = render_transport(seen, strata="midpoint", samples=128**2)
    bare = render_transport(room.load(hidden=(2, 3)), strata="midpoint", samples=128**2)
    partly = (exact > 0.05 * bare) & (exact < 0.95 * bare)
    clear = exact == bare
    assert partly.mean() > 0.1
    assert clear.mean() > 0.1
    same_mean([A[partly | clear] for A in jittered], [exact[partly | clear]] * 64)


@pytest.mark.parametrize("lanes", [1, 1000, 1 << 22])
def test_every_pass_gives_the_bytes_of_the_stored_matrix(shipped, lanes, monkeypatch):
    scene = shipped("chair", (4, 5), 6).averaged(2)
    settings = {"samples": 6, "seed": 3}
    A = render_transport(scene, **settings)
    monkeypatch.setattr(shadow_rays, "LANES", lanes)
    rendered = RenderedTransport(scene, **settings)
    assert rendered.shape == A.shape
    for _ in range(2):
        covered = 0
        for rows, block in rendered.row_blocks():
            assert rows.start == covered
            covered = rows.stop
            np.testing.assert_array_equal(block, A[rows])
        assert covered == len(A)
