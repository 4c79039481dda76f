import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient import render_background, smooth_fit
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.scene_nodes import SceneNodes

FAST = {"samples": 256, "indirect_samples": 16}


def centers(pixels):
    return (np.arange(pixels) + 0.5) / pixels


def polynomial(coefficients, shape):
    """Sum of c_ij y^i x^j at the centres of pixels, a channel for each last index."""
    y, x = np.meshgrid(centers(shape[0]), centers(shape[1]), indexing="ij")
    terms = [
        coefficients[i, j] * (y**i * x**j)[..., None]
        for i in range(coefficients.shape[0])
        for j in range(coefficients.shape[1])
    ]
    return np.sum(terms, axis=0)


@pytest.mark.parametrize("shape", [(24, 24), (126, 126), (7, 31), (1, 1)])
def test_polynomials_of_the_degree_are_resampled_exactly(shape):
    coefficients = np.random.default_rng(0).normal(size=(6, 6, 3))
    fitted = smooth_fit(polynomial(coefficients, (24, 20)), shape)
    np.testing.assert_allclose(fitted, polynomial(coefficients, shape), atol=1e-10)


def test_fit_is_the_least_squares_one():
    noisy = np.random.default_rng(0).normal(size=(9, 8, 3))
    y, x = np.meshgrid(centers(9), centers(8), indexing="ij")
    basis = np.stack([(y**i * x**j).ravel() for i in range(3) for j in range(3)], axis=1)
    expected = basis @ np.linalg.lstsq(basis, noisy.reshape(-1, 3))[0]
    fitted = smooth_fit(noisy, (9, 8), degree=2)
    np.testing.assert_allclose(fitted, expected.reshape(9, 8, 3), atol=1e-10)


@pytest.fixture
def office(room):
    """Wall, coloured floor and bookshelf, lit by a panel; declares the film's `resolution`."""

    def plane(name, x, y, z, turn, color, inside=""):
        return (
            f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale value="0.8"/>'
            f'{turn}<translate x="{x}" y="{y}" z="{z}"/></transform><bsdf type="diffuse">'
            f'<rgb name="reflectance" value="{color}"/></bsdf>{inside}</shape>'
        )

    left = '<rotate y="1" angle="90"/>'
    down = '<rotate x="1" angle="180"/>'
    return room.write(
        '<default name="resolution" value="5"/>',
        plane("floor", 0.7, 0.2, -0.2, "", "0.7, 0.5, 0.2"),
        plane("shelf", 0.0, 0.2, 0.3, left, "0.4, 0.5, 0.8"),
        plane("panel", 0.9, 0.1, 1.5, down, "0", room.area),
        monitor="",
        camera=room.camera(("$resolution", "$resolution")),
    )


SIZE = {"resolution": "16"}


def brute_force(path, seed, samples):
    nodes = SceneNodes(path, SIZE, required={"wall": "Shape", "camera": "Sensor"})
    nodes.average_pixels()
    return path_trace(nodes.instantiate(), -1, samples=samples, seed=seed)


@pytest.mark.usefixtures("jit")
def test_direct_and_fitted_indirect_light_make_the_path_traced_background(office, same_mean):
    parts = [
        render_background(office, SIZE, samples=256, indirect_samples=16**2, seed=seed)
        for seed in range(10)
    ]
    whole = [brute_force(office, 100 + seed, 900) for seed in range(10)]
    # The fit spreads its noise over the picture: pixels are not independent, their mean is tested.
    same_mean(*(np.mean(x, axis=(1, 2), keepdims=True) for x in (parts, whole)))
    halves = [np.mean(x, axis=0) for x in (parts, whole)]
    np.testing.assert_allclose(*halves, rtol=0.02)
    assert np.ptp(halves[0][..., 0]) > 0.1 * halves[0].mean()


@pytest.mark.usefixtures("jit")
def test_light_that_does_not_bounce_back_is_the_direct_light_alone(room):
    light = (
        '<emitter type="point"><point name="position" value="0.2, -0.5, 0.9"/>'
        '<rgb name="intensity" value="1, 2, 3"/></emitter>'
    )
    picture = render_background(room.write(light, monitor=""), **FAST)
    x = 0.7 + 0.4 / 6 * (np.arange(6) - 2.5)
    z = 0.3 - 0.4 / 6 * (np.arange(5)[:, None] - 2)
    squared = (x - 0.2) ** 2 + 1.5**2 + (z - 0.9) ** 2
    expected = (0.5 / np.pi * 1.5 / squared**1.5)[..., None] * [1, 2, 3]
    np.testing.assert_allclose(picture, expected, rtol=3e-3)


@pytest.mark.usefixtures("jit")
def test_same_seed_gives_the_same_bytes_and_another_seed_others(office):
    first, again, other = (render_background(office, SIZE, seed=seed, **FAST) for seed in (2, 2, 3))
    assert first.shape == (16, 16, 3)
    assert first.tobytes() == again.tobytes()
    assert np.all(first != other)


@pytest.mark.usefixtures("jit")
def test_progress_rises_to_one(room):
    fractions = []
    render_background(
        room.write(monitor=room.monitor(room.area)), progress=fractions.append, **FAST
    )
    assert len(fractions) >= 3
    assert np.all(np.diff(fractions) > 0)
    assert fractions[-1] == 1


@pytest.mark.parametrize(("missing", "kind"), [("wall", "shape"), ("camera", "sensor")])
def test_scene_without_wall_or_camera_is_refused(room, missing, kind):
    path = room.write(monitor="", **{missing: ""})
    with pytest.raises(SceneError, match=f"has no {kind} with id '{missing}'"):
        render_background(path, **FAST)


def test_undeclared_parameter_is_refused(office):
    with pytest.raises(SceneError, match="declares no parameter 'color'"):
        render_background(office, {"color": "1"}, **FAST)
