"""Images of a scene whose occluder is not quite where it is said to be: a plate with soft edges."""

from dataclasses import replace

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.evidence import CommonNoise

from periscopy_sim.model.uncertain_transport import UncertainTransport
from periscopy_sim.model.uncertainty import curvature_of_total_variation
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

WALL, HIDDEN = (32, 40), (6, 8)
NAMES = ("plate_x", "plate_z", "plate_width")
ERRORS = np.array([0.015, 0.015, 0.02])
Z, X = (g.ravel() for g in np.meshgrid(*(np.linspace(-1, 1, n) for n in WALL), indexing="ij"))
ROW, COLUMN = (
    g.ravel() for g in np.meshgrid(*(np.linspace(-0.8, 0.8, n) for n in HIDDEN), indexing="ij")
)
B = np.stack([np.ones_like(X), X, Z, X * Z], axis=1)


def transport(values):
    """Light past a plate half-way to the wall: its shadow moves twice as far, against the patch."""
    x, z, width = values

    def covered(wall, light, middle, size):
        from_middle = wall[:, None] - (2 * middle - light)
        return 1 / (1 + np.exp((np.abs(from_middle) - size) / 0.06))

    shadow = covered(X, COLUMN, x, 0.5 + width) * covered(Z, ROW, z, 0.5)
    return (1 - shadow) / (1 + (X[:, None] - COLUMN) ** 2 + (Z[:, None] - ROW) ** 2)


A = transport(np.zeros(3))
CHANGES = np.array([[(transport(step) - transport(-step)) / 2 for step in np.diag(ERRORS)]])
UNCERTAIN = UncertainTransport(NAMES, np.zeros(3), np.diag(ERRORS), CHANGES, transport)


def image(seed):
    random = np.random.default_rng(seed)
    picture = 0.2 + 0.2 * random.random((*HIDDEN, 3))
    for _ in range(4):
        top, left = random.integers(0, HIDDEN[0] - 2), random.integers(0, HIDDEN[1] - 2)
        height, width = random.integers(2, 4, 2)
        picture[top : top + height, left : left + width] += random.random(3)
    return picture


def photograph(values, picture, seed=0, noise=0.0005):
    light = transport(values) @ picture.reshape(-1, 3) + B @ [
        [5, 5, 4],
        [1, 0, 1],
        [0, 1, 0],
        [1] * 3,
    ]
    light += noise * light.mean() * np.random.default_rng(seed).standard_normal(light.shape)
    return light.reshape(*WALL, 3)


def fitted(uncertain=None, **more):
    return NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=WALL, uncertain=uncertain, **more)


@pytest.fixture(scope="module")
def draws():
    """Errors of images by the scene as it is said to be, and by one that is uncertain."""
    nominal, uncertain = fitted(), fitted(UNCERTAIN)
    random, found = np.random.default_rng(7), []
    for seed in range(16):
        values, truth = ERRORS * random.standard_normal(3), image(seed)
        y = photograph(values, truth, seed)
        for method in (nominal, uncertain):
            solved = method.solve(y)
            found.append((solved.image - truth, method.standard_errors(solved), values, solved))
    return found[::2], found[1::2]


@pytest.mark.thorough
def test_most_images_of_a_misplaced_scene_have_a_third_of_the_error(draws):
    """Of the largest displacements some are too far for a linear way there."""
    nominal, uncertain = (np.median([np.mean(error**2) for error, *_ in each]) for each in draws)
    assert uncertain < nominal / 9


@pytest.mark.thorough
def test_errors_of_patches_and_parameters_cover_what_they_say(draws):
    covered = [np.mean([np.abs(error) < σ for error, σ, *_ in each]) for each in draws]
    assert covered[0] < 0.5, covered
    assert 0.55 < covered[1] < 0.85, covered
    z = np.array(
        [
            (found.scene.values - values) / found.scene.standard_errors
            for *_, values, found in draws[1]
        ]
    )
    # Of 48 that are right, 68 % would be 33 ± 3; parameters share their errors.
    assert 0.5 < np.mean(np.abs(z) < 1) < 0.9


def test_the_scene_is_found_where_the_photograph_shows_it():
    values, truth = np.array([0.02, -0.01, 0.015]), image(3)
    method = fitted(UNCERTAIN)
    found = method.solve(photograph(values, truth))
    told = method.told(found)["uncertain"]["parameters"]
    assert list(told) == list(NAMES)
    for k, name in enumerate(NAMES):
        assert told[name]["value"] == 0
        assert told[name]["standard_error"] == pytest.approx(ERRORS[k])
        assert told[name]["value_found"] == found.scene.values[k]
        assert told[name]["standard_error_found"] < ERRORS[k]
    assert "the scene fits better with plate_" in method.remark(found)
    residual, before = (
        each.residual(photograph(values, truth), each.solve(photograph(values, truth)))
        for each in (method, fitted())
    )
    assert residual.unexplained < before.unexplained / 2


def test_it_is_told_where_more_is_wrong_than_what_may_be():
    """A plate that is far off is not explained by the little that its height may err."""
    height = UncertainTransport(
        NAMES[1:2], np.zeros(1), 0.1 * ERRORS[1:2, None], 0.1 * CHANGES[:, 1:2]
    )
    right, wrong = (photograph(values, image(3)) for values in (np.zeros(3), [0.15, 0, -0.1]))
    method = fitted(height)
    told = "more of the scene is wrong, or by more, and the image's standard errors do not count"
    assert told in method.remark(method.solve(wrong))
    assert told not in method.remark(method.solve(right))


def test_a_right_scene_stays_where_it_is():
    truth = image(5)
    y = photograph(np.zeros(3), truth)
    found, plain = fitted(UNCERTAIN).solve(y), fitted().solve(y)
    assert (np.abs(found.scene.values) < 3 * found.scene.standard_errors + 1e-3).all()
    errors = [float(np.mean((each.image - truth) ** 2)) for each in (found, plain)]
    assert errors[0] < 1.5 * errors[1]


def test_a_held_scene_keeps_the_image_and_widens_its_errors():
    y = photograph(np.zeros(3), image(1))
    plain, held = fitted(), fitted(replace(UNCERTAIN, held=True))
    found, solved = plain.solve(y), held.solve(y)
    np.testing.assert_array_equal(solved.image, found.image)
    assert (held.standard_errors(solved) >= plain.standard_errors(found)).all()
    assert held.standard_errors(solved).mean() > 1.1 * plain.standard_errors(found).mean()
    told = held.told(solved)["uncertain"]
    assert told["held"]
    assert told["parameters"]["plate_x"]["value_found"] == 0
    assert "uncertain parameters" in held.told(solved)["standard_errors_assume"]
    assert held.remark(solved) == plain.remark(found)


def test_without_a_renderer_the_transport_is_taken_for_linear():
    values, truth = 0.5 * ERRORS, image(2)
    linear = fitted(replace(UNCERTAIN, render=None)).solve(photograph(values, truth))
    exact = fitted(UNCERTAIN).solve(photograph(values, truth))
    plain = fitted().solve(photograph(values, truth))
    errors = [np.mean((each.image - truth) ** 2) for each in (exact, linear, plain)]
    assert errors[1] < errors[2] / 2
    np.testing.assert_allclose(linear.scene.values, exact.scene.values, atol=0.02)


def test_where_there_is_no_such_scene_it_stays():
    def nowhere(values):
        del values
        raise ValueError("the plate is in the wall")

    y = photograph(ERRORS, image(4))
    found = fitted(replace(UNCERTAIN, render=nowhere)).solve(y)
    np.testing.assert_array_equal(found.image, fitted().solve(y).image)
    np.testing.assert_array_equal(found.scene.values, 0)
    assert (found.scene.standard_errors > 0.3 * ERRORS).all()  # it would be elsewhere


def test_pixels_left_out_may_hold_anything():
    mask = np.ones(WALL, bool)
    mask[5:9, 10:20] = False
    y = photograph(ERRORS, image(4))
    y[~mask] = np.nan
    method = fitted(UNCERTAIN, mask=mask)
    found = method.solve(y)
    other = fitted(UNCERTAIN).solve(photograph(ERRORS, image(4)))
    np.testing.assert_allclose(found.scene.values, other.scene.values, atol=0.03)
    assert np.isfinite(method.standard_errors(found)).all()


def test_errors_of_the_scene_move_the_image_as_its_standard_errors_say():
    """The image of a photograph with a little more light along an error, less that without."""
    truth = image(6)
    y = photograph(np.zeros(3), truth)
    wide = fitted(replace(UNCERTAIN, held=True), positive=False, wall_gain=False)
    found = wide.solve(y)
    P = curvature_of_total_variation(found.image, float(found.weight)).toarray()
    rejected = A - B @ np.linalg.lstsq(B, A)[0]
    light = np.einsum("kmn,nc->kmc", CHANGES[0], found.image.reshape(-1, 3))
    extra = np.zeros((len(A[0]), 3))
    for c, σ in enumerate(found.noise):
        H = rejected.T @ rejected / σ**2 + P
        extra[:, c] = np.sum(np.linalg.solve(H, rejected.T @ light[..., c].T / σ**2) ** 2, axis=1)
    plain = replace(found, scene=None)
    gained = wide.standard_errors(found) ** 2 - wide.standard_errors(plain) ** 2
    np.testing.assert_allclose(gained.reshape(-1, 3), extra, rtol=2e-3, atol=1e-3 * extra.max())


def test_axes_of_equal_noise_make_no_difference():
    """Along turned axes of colour, in which noise is as strong as in the channels."""
    method = fitted(replace(UNCERTAIN, held=True))
    found = method.solve(photograph(np.zeros(3), image(6)))
    evidence = replace(found.evidence, noise=np.full(3, found.evidence.mean_noise), common=None)
    axes = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    variances = np.full((3, len(method._curvatures)), evidence.mean_noise**2)
    turned = replace(evidence, common=CommonNoise(axes, variances, 1.0))
    plain, along = (
        method.standard_errors(replace(found, evidence=each)) for each in (evidence, turned)
    )
    np.testing.assert_allclose(along, plain, rtol=1e-3)


def test_uncertain_scenes_need_the_rows_and_columns_of_photographs():
    with pytest.raises(ValueError, match="uncertain needs the rows and columns"):
        NoiseAware(A, B, hidden_shape=HIDDEN, uncertain=UNCERTAIN)
