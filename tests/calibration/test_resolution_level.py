from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import periscopy_sim as ps
from periscopy_sim.calibration.evidence import CorrelatedNoise, Explanation
from periscopy_sim.calibration.prior import UncertainParameters, free_parameters, ruled_values
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.resolution_level import (
    SPREAD,
    Group,
    ResolutionLevel,
    averages,
    footprints,
)
from periscopy_sim.calibration.search import descend
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.pictures import averaged_photograph
from periscopy_sim.testing import derivative_test
from tests.scenes.calibration import ERRORS, TRUTH, Small


def light(across: int) -> Array:
    """Return a cubic and a wave in the middles of (20 x across) squared pixels."""
    points = (np.arange(20 * across) + 0.5) / across
    x, y = np.meshgrid(points, points)
    return np.asarray(x**3 + 2 * x * y**2 - 30 * y**2 + 900 * np.sin(x / 3) * np.cos(y / 4))


MEANS = light(32).reshape(20, 32, 20, 32).mean(axis=(1, 3))
PIXELS = np.ones((20, 20), bool)
PIXELS[:4, :3] = False


@pytest.mark.parametrize("across", [1, 3])
def test_pixels_are_means_of_light_that_is_known_at_points(across: int) -> None:
    """But in the outermost row, beside which no neighbour shows how the light bends."""
    known = light(across).reshape(20, across, 20, across).mean(axis=(1, 3))
    averaged = np.zeros(PIXELS.shape)
    averaged[PIXELS] = footprints(PIXELS, across) @ known[PIXELS]
    before, after = (np.max(np.abs(each - MEANS)[5:-1, 4:-1]) for each in (known, averaged))
    assert before == pytest.approx(6.0 / across**2, rel=0.1)
    assert after < 0.05


@pytest.mark.parametrize("shape", [(20, 20), (10, 10), (7, 9)])
def test_a_photograph_and_a_are_averaged_alike(shape: tuple[int, int]) -> None:
    """Also where large pixels part small ones, and the mask large ones."""
    photograph = Photograph(np.repeat(MEANS[..., None], 3, axis=2), mask=PIXELS)
    means = averaged_photograph(photograph, shape)
    exact = means.values[means.pixels][:, 0]
    S = averages(PIXELS, shape)
    assert S.shape == (len(exact), np.count_nonzero(PIXELS))
    off = np.abs(S @ light(1)[PIXELS] - exact)
    assert np.median(off) < 0.1
    if shape == (10, 10):  # else the outermost row has its part in all large pixels beside it
        inner = np.zeros(shape, bool)
        inner[3:-1, 2:-1] = True
        assert off[inner[means.pixels]].max() < 0.05


GAIN = 0.05, -0.03, 0.04, 0.02, -0.05, 0.02, 0.01, -0.03, 0.02
POINT = np.array([0.003, -0.004, 0.2, *GAIN])


class Room:
    """A scene of two numbers in double precision, which a matrix follows in curves."""

    pixels, across, errors = np.ones((9, 8), bool), 1, np.array([0.3, 0.5])
    A, *CHANGES = np.random.default_rng(0).uniform(0.5, 1, (4, 72, 5))
    scenario = SimpleNamespace(paint=np.ones((1, 1)))  # an even wall

    def transport(self, values: Array) -> Array:
        x, y = values
        return np.asarray(self.A + x * self.CHANGES[0] + np.sin(x * y) * self.CHANGES[1])

    def linearized(self, values: Array) -> tuple[Array, list[Array]]:
        x, y = values
        bend = np.cos(x * y) * self.CHANGES[1]
        return self.transport(values), [self.CHANGES[0] + y * bend, x * bend]


class Known(Explanation):
    """An image that is known, beside a density of A: the evidence is ‖y⊥ − A⊥ f‖² + 2⟨V, A⟩."""

    volume = np.random.default_rng(1).normal(size=(72, 5))

    @classmethod
    def explain(cls, A: Array, background: Array, y: Array) -> "Known":
        f = np.random.default_rng(2).uniform(0, 1, (5, y.shape[1])).astype(np.float32)
        left = y - A @ f
        left -= background @ (background.T @ left)
        evidence = float(np.sum(left**2) + 2 * np.vdot(cls.volume, A))
        return cls(evidence, np.ones(y.shape[1]), f, left, np.sum(y**2, axis=0), background)

    def beyond_image(self, motion: Array) -> Array:
        return motion


@pytest.mark.parametrize(("temperature", "is_shared"), [(1.0, False), (3.0, False), (1.0, True)])
def test_slope_is_the_derivative_of_the_objective(temperature: float, is_shared: bool) -> None:
    """Of parameters and gain, which is of single precision; the stand-ins' images are exact."""
    random = np.random.default_rng(3)
    groups = tuple(Group(random.uniform(1, 3, (k, 72, 3)), Known) for k in (1, 2))  # type: ignore
    background = np.linalg.qr(random.normal(size=(72, 2)))[0]
    room: Any = Room()
    noise = CorrelatedNoise.white(room.pixels, background)
    if is_shared:
        noise = replace(noise, excess=random.uniform(0, 9, len(noise.excess)))
    level = ResolutionLevel(room, np.array([0.2, 1.0]), background, groups, noise)
    point = np.array([0.4, 0.7, *GAIN])
    derivative_test(
        lambda x: level.candidate(x).objective_at(temperature) / 2,
        level.look(level.candidate(point), temperature).downhill, point, steps=0.03, atol=1e-3,
    )  # fmt: skip


def test_slope_of_photographs_is_that_of_the_objective_to_a_tenth(small: Small) -> None:
    """With an unknown picture beside a known one; `SharpImages` ends no nearer to its minimum.

    Or to half of what moves the minimum by a standard error: derivatives take fewer wall points.
    """
    level, temperature = small.level(shown=1, count=2), 3.0
    look = level.look(level.candidate(POINT), temperature)
    errors = 1 / np.sqrt(np.diag(look.curvature()))
    derivative_test(
        lambda x: level.candidate(POINT + errors * x).objective_at(temperature) / 2,
        errors * look.downhill, 0 * POINT,
        steps=0.02 * np.append(level.scene.errors, np.full(len(GAIN), SPREAD)) / errors,
        rtol=0.1, atol=0.5,
    )  # fmt: skip


def test_a_newton_step_gains_what_it_promises(small: Small) -> None:
    """Near the minimum the information is the curvature of the objective."""
    level = small.level(shown=1)
    end = level.look(level.candidate(level.center))
    for _ in range(3):
        end = descend(level, end, 1.0)
    values = level.values(end.point)
    np.testing.assert_allclose(values, list(TRUTH.values()), atol=0.2 * np.max(level.scene.errors))
    away = end.point + 2 / np.sqrt(np.diag(end.curvature()))
    look = level.look(level.candidate(away))
    assert look.objective - end.objective == pytest.approx(look.predicted_gain, rel=0.1)


@pytest.mark.thorough
def test_the_last_level_has_no_slope_at_the_truth_but_by_noise(jit: None) -> None:  # noqa: ARG001
    """Its score has the χ² distribution; that of the likeliest image alone has not (p < 1e-4)."""
    hidden, size = (29, 36), {"resolution": "63"}
    scene = ps.load_scenario("plate", hidden, size)
    errors = free_parameters(scene.document)
    names = tuple(errors)
    centers = ruled_values(scene.document, names)
    picture = ps.read_hidden_image(ps.find_image("still_life"), hidden)
    light = (ps.analytic_transport(scene.averaged(2)) @ picture.reshape(-1, 3)).reshape(63, 63, 3)
    y = ps.add_noise(ps.composite(light, np.ones_like(light), 0.5), 60, 1)
    held = UncertainParameters((), np.zeros(0), np.zeros(0))
    known = scene, names, centers, np.array(list(errors.values())), held
    fine = CalibrationProblem(*known, [Photograph.of(y)], ()).fine()
    scores = []
    for level in (fine, fine.with_edges(fine.candidate(fine.center))):
        look = level.look(level.candidate(fine.center))
        # The prior's precision makes the scores smaller, if anything.
        scores.append(float(look.slope @ np.linalg.solve(look.curvature(), look.slope)))
    threshold = chi2.isf(1e-4, len(fine.center))
    assert scores[0] > 3 * threshold
    assert scores[1] < threshold


def test_the_prior_is_normal(small: Small) -> None:
    level = small.level()
    for k, error in enumerate(ERRORS.values()):
        point = level.center.copy()
        point[k] += 2 * error
        assert level.penalty(point) == pytest.approx(4)


def test_a_point_without_shadows_is_no_scene(small: Small) -> None:
    """A scan may put what casts them where no pixel sees it: ambient light then explains all."""
    level = small.level()
    assert level.finer is not None
    scene, averages = level.finer
    bare = replace(level, background=np.linalg.qr(averages @ scene.transport(level.centers))[0])
    assert bare.candidate(level.center).explanations == ()
    with pytest.raises(SceneError):
        bare.look(bare.candidate(level.center))
