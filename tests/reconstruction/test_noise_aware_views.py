"""Several views of one hidden scene, against one view of the union of their pixels."""

from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.reconstruction import noise_aware_views as module
from periscopy_sim.reconstruction.noise_aware_views import NoiseAwareViews

SIZE, PIXELS = (6, 7), {"left": 300, "right": 260}
PLAIN = {"hidden": SIZE, "profiles": False, "corrections": ()}
NOISE = 1e-3


@pytest.fixture
def scene():
    """A of two views, and an image with an edge, (6, 7, 3)."""
    rng = np.random.default_rng(4)
    A = {name: rng.uniform(0, 1, (count, 42)) ** 4 for name, count in PIXELS.items()}
    image = np.full((*SIZE, 3), 0.2)
    image[2:5, 1:4] = [0.9, 0.5, 0.3]
    return A, image


def photographed(A, image, scales=(1, 1), noise=NOISE, seed=7):
    """Each view's photograph of scaled light, (M, 3), with noise over its own scale."""
    rng = np.random.default_rng(seed)
    f = image.reshape(42, 3)
    light = {name: each @ f for name, each in A.items()}
    return {
        name: scale * (y + noise * np.sqrt(np.mean(y**2)) * rng.standard_normal(y.shape))
        for (name, y), scale in zip(light.items(), scales, strict=True)
    }


def fitted(A, **settings):
    return NoiseAwareViews({n: ps.NoiseAware(each, **PLAIN | settings) for n, each in A.items()})


@pytest.fixture
def alike(monkeypatch):
    """Solve views whose noise and exposures are said to be the same."""

    def solve(views, y):
        one = np.ones(len(y))
        monkeypatch.setattr(module, "find_exposures", lambda *_: (one, np.zeros(len(y))))
        for name, method in views.views.items():
            alone = replace(method.solve(y[name]), noise=np.ones(3))
            monkeypatch.setattr(method, "solve", lambda _, alone=alone: alone)
        return views.solve(y)

    return solve


def test_views_of_one_exposure_and_noise_are_one_view_of_all_pixels(scene, alike):
    """Without ambient light; the oracle is the method for the union of the pixels."""
    A, image = scene
    y = photographed(A, image)
    union = ps.NoiseAware(np.concatenate([*A.values()]), **PLAIN)
    expected = union.solve(np.concatenate([*y.values()]))
    errors = union.standard_errors(expected)
    # With exposures and noise to estimate, the image moves by less than its errors.
    moved = fitted(A).solve(y).image - expected.image
    assert np.mean(moved**2) < 0.5 * np.mean(errors**2)
    solution = alike(fitted(A), y)
    np.testing.assert_allclose(solution.image, expected.image, atol=2e-6)
    np.testing.assert_allclose(solution.noise, expected.noise, rtol=1e-5)
    union.fit = solution.photograph.fit
    np.testing.assert_allclose(union.standard_errors(solution), errors, rtol=1e-3)


def test_exposures_noise_and_ambient_light_are_each_views_own(scene):
    A, image = scene
    rng = np.random.default_rng(5)
    B = {name: rng.uniform(0, 1, (count, 3)) for name, count in PIXELS.items()}
    y = photographed(A, image, scales=(2000.0, 700.0))
    y = {n: each + each.mean() * B[n] @ rng.uniform(0, 3, (3, 3)) for n, each in y.items()}
    views = NoiseAwareViews({n: ps.NoiseAware(A[n], B[n], **PLAIN) for n in A})
    solution = views.solve(y)
    exposure, error = solution.exposures["right"], solution.exposure_errors["right"]
    assert solution.exposures["left"] == 1 and solution.exposure_errors["left"] == 0
    assert abs(exposure / 0.35 - 1) < 4 * error < 0.01
    assert np.linalg.norm(solution.image / 2000 - image) < 0.01 * np.linalg.norm(image)
    whole, reports = views.report(y, solution)
    assert whole.standard_errors.shape == image.shape and not whole.warnings
    assert [note.values["camera"] for note in whole.notes if note.code == "exposure_of"] == [
        "right"
    ]
    assert [title for title, _ in whole.stages] == ["left alone", "right alone"]
    assert reports.keys() == A.keys()
    both = np.linalg.norm(solution.image - 2000 * image)
    assert both < min(np.linalg.norm(solution.views["left"].image - 2000 * image), 2000)


def test_reported_error_of_an_exposure_is_its_scatter(scene):
    A, image = scene
    deviations = []
    for seed in range(12):
        y = photographed(A, image, scales=(1, 0.4), noise=0.02, seed=seed)
        solution = fitted(A).solve(y)
        error = solution.exposure_errors["right"]
        deviations.append(np.log(solution.exposures["right"] / 0.4) / error)
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.6


def test_corrections_leave_the_exposures(scene):
    A, image = scene
    y = photographed(A, image, scales=(1, 0.4), noise=1e-4)

    def correction(photograph, _):
        return replace(photograph, planes=0.8 * photograph.planes), {}

    views = fitted(A)
    views.views["right"] = ps.NoiseAware(
        A["right"], **PLAIN | {"corrections": [lambda _: correction]}
    )
    assert views.solve(y).exposures["right"] == pytest.approx(0.4, rel=1e-3)


@pytest.mark.parametrize("noise", [1e-2, 1e-4, 1e-6])
def test_exposures_are_found_at_any_noise(scene, noise, monkeypatch):
    """Alone, the views' images are far from the scene's; so is where the search begins."""
    A, image = scene
    y = photographed(A, image, scales=(1, 0.4), noise=noise)
    solution = fitted(A).solve(y)
    error = solution.exposure_errors["right"]
    assert abs(solution.exposures["right"] / 0.4 - 1) < 4 * error < 0.1
    monkeypatch.setattr(module, "MOST_STEPS", 1)
    with pytest.raises(InputError, match="the exposures of the views cannot be estimated"):
        fitted(A).solve(y)


def test_derivatives_of_the_evidence_are_those_of_its_value():
    """Of three views in two channels."""
    rng = np.random.default_rng(3)
    A, noise = rng.standard_normal((3, 20, 12)), rng.uniform(0.5, 1, (3, 2))
    y = rng.standard_normal((2, 12)) @ A.swapaxes(1, 2) + rng.standard_normal((3, 2, 20))
    x, widths = 0.3 * rng.standard_normal(4), np.array([0.7, 0.7, 3, 3])

    def evidence(x):
        return module.evidence_of(x, np.zeros(4), widths, A.swapaxes(1, 2) @ A, y @ A, noise)

    ends = [(evidence(x + step), evidence(x - step)) for step in 1e-5 * np.eye(4)]
    _, slopes, curvature, _ = evidence(x)
    differences = [(above[0] - below[0]) / 2e-5 for above, below in ends]
    np.testing.assert_allclose(slopes, differences, rtol=1e-6, atol=1e-6)
    differences = [(above[1] - below[1]) / 2e-5 for above, below in ends]
    np.testing.assert_allclose(curvature, differences, rtol=1e-6, atol=1e-6)


def test_views_that_share_nothing_warn_of_the_exposure():
    """Each view shows patches of its own, far apart."""
    rng = np.random.default_rng(2)
    A = {name: rng.uniform(0, 1, (80, 42)) ** 4 for name in ("left", "right")}
    A["left"][:, 18:], A["right"][:, :24] = 0, 0
    image = rng.uniform(0.2, 1, (*SIZE, 3))
    y = photographed(A, image, scales=(1, 3))
    views = fitted(A)
    solution = views.solve(y)
    # The prior alone knows it; it errs by how bright the two parts are.
    exposure, error = solution.exposures["right"], solution.exposure_errors["right"]
    assert error > 0.5 and abs(np.log(exposure / 3)) < 2 * error
    whole, _ = views.report(y, solution)
    (warning,) = whole.warnings
    assert warning.code == "exposure" and warning.values["camera"] == "right"


def test_errors_of_the_scene_move_all_views_together(scene, alike):
    A, image = scene
    rng = np.random.default_rng(8)
    D = {name: 0.05 * each * rng.uniform(-1, 1, each.shape) for name, each in A.items()}

    def uncertain(name):
        def slopes(image):
            return (D[name] @ image.reshape(42, -1))[None]

        return UncertainTransport(("dx",), np.eye(1), slopes)

    y = photographed(A, image)
    views = NoiseAwareViews(
        {n: ps.NoiseAware(each, uncertain=uncertain(n), **PLAIN) for n, each in A.items()}
    )
    whole, _ = views.report(y, alike(views, y))
    assert whole.numbers["standard_errors_count"] == ["dx"]
    joint = np.concatenate([D[name] for name in A])
    moved = UncertainTransport(
        ("dx",), np.eye(1), lambda image: (joint @ image.reshape(42, -1))[None]
    )
    union = ps.NoiseAware(np.concatenate([*A.values()]), uncertain=moved, **PLAIN)
    expected = union.solve(np.concatenate([*y.values()]))
    np.testing.assert_allclose(whole.standard_errors, union.standard_errors(expected), rtol=1e-3)
    union.fit = replace(union.fit, uncertain=None)
    assert (whole.standard_errors > union.standard_errors(expected)).all()


def test_colour_matrix_mixes_all_views(scene):
    A, image = scene
    M = ps.ColourMatrix(np.array([[0.9, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]]))
    y = {n: M.mix(each) for n, each in photographed(A, image, scales=(1, 0.5), noise=1e-4).items()}
    photographs = {n: ps.Photograph.of(each[:, None], colour_matrix=M) for n, each in y.items()}
    solution = fitted(A).solve(photographs)
    assert solution.exposures["right"] == pytest.approx(0.5, rel=1e-3)
    assert np.linalg.norm(solution.image - image) < 0.01 * np.linalg.norm(image)
    other = ps.ColourMatrix(np.eye(3))
    photographs["right"] = replace(photographs["right"], colour_matrix=other)
    with pytest.raises(InputError, match="colour matrices"):
        fitted(A).solve(photographs)


def test_what_belongs_to_no_one_scene_is_refused(scene):
    A, image = scene
    y = photographed(A, image)
    with pytest.raises(InputError, match="one view at least"):
        NoiseAwareViews({})
    with pytest.raises(InputError, match="photographs of left, the views are left, right"):
        fitted(A).solve({"left": y["left"]})
    with pytest.raises(InputError, match="'right' has 1 channels"):
        fitted(A).solve({"left": y["left"], "right": y["right"][:, :1]})
    views = {
        "left": ps.NoiseAware(A["left"], **PLAIN),
        "right": ps.NoiseAware(A["right"], **PLAIN | {"hidden": (7, 6)}),
    }
    with pytest.raises(InputError, match="'right' has 7x6 hidden patches"):
        NoiseAwareViews(views)
    first, second = (ps.load_scenario(name, (3, 4)) for name in ("chair", "plate"))
    with pytest.raises(InputError, match="views of different scenes"):
        NoiseAwareViews.for_scene({"left": first, "right": second}, A, {})


def test_black_channels_and_noise_free_views_have_an_image(scene):
    A, image = scene
    image[..., 2] = 0
    y = photographed(A, image, scales=(1, 0.3), noise=0)
    solution = fitted(A).solve(y)
    assert solution.exposures["right"] == pytest.approx(0.3, rel=1e-3)
    assert np.linalg.norm(solution.image - image) < 0.02 * np.linalg.norm(image)
    nothing = fitted(A).solve({name: 0 * each for name, each in y.items()})
    assert not nothing.image.any()
    assert nothing.exposures["right"] == 1 and nothing.exposure_errors["right"] > 0.5
