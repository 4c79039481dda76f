"""The solvers and rules of the ablation, where the answer is known."""

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.beyond.ablation import lowest
from experiments.beyond.ablation_cases import Case
from experiments.beyond.ablation_table import Row, summary
from experiments.beyond.normal_equations import NormalEquations, median_deviation
from experiments.beyond.regularizers import (
    Problem,
    Regularized,
    damped,
    generalized_variation,
    gradient,
    rounded,
    total_variation,
)
from experiments.beyond.wall_gain import plain_gain
from experiments.beyond.weight_rules import trials, unbiased_risk

HIDDEN = (6, 7)
PHOTOGRAPH = (16, 18)
RNG = np.random.default_rng(0)
A = RNG.random((288, 42)) + 0.1
B = RNG.random((288, 4))
TRUTH = np.zeros((*HIDDEN, 3))
TRUTH[1:4, 1:5] = (0.9, 0.5, 0.2)
SIGNAL = A @ TRUTH.reshape(-1, 3) + 2 * B @ RNG.random((4, 3))
NOISE = np.array([0.05, 0.1, 0.2])
EQUATIONS = NormalEquations(A, np.linalg.qr(B)[0])


def photographs(count=3, noise=1.0):
    draws = (np.random.default_rng(seed).standard_normal(SIGNAL.shape) for seed in range(count))
    return np.stack([SIGNAL + noise * NOISE * draw for draw in draws])


def minimized(terms, problem, **settings):
    exact = {"tolerance": 1e-5, "max_iterations": 20_000} | settings
    return Regularized(EQUATIONS.gram, terms, **exact).minimize(problem)


@pytest.mark.parametrize("positive", [True, False])
def test_own_problem_has_the_packages_image(positive):
    y = photographs()
    method = ps.NoiseAware(
        A, B, hidden_shape=HIDDEN, positive=positive, tolerance=1e-5, max_iterations=20_000
    )
    measured = EQUATIONS.measured(y)
    problem = measured.problem(0.02)
    negatives = np.inf if positive else 0.0
    images = minimized(total_variation(HIDDEN), problem, negatives=negatives) / EQUATIONS.unit
    for k, photograph in enumerate(y):
        found = method.solve(photograph)
        # What is left of the photograph is a difference of sums of squares in single precision.
        rejected = photograph - B @ np.linalg.lstsq(B, photograph)[0]
        rounding = 2e-7 * np.sum(rejected**2, axis=0) / (288 - 4 - 42)
        assert (np.abs(found.noise**2 - measured.noise[k] ** 2) < rounding).all()
        error = np.linalg.norm(images[:, k].reshape(found.image.shape) - found.image)
        assert error < 0.002 * np.linalg.norm(found.image)


def test_quadratic_penalty_solves_its_linear_equations():
    problem = EQUATIONS.measured(photographs()).problem(0.02)
    f = minimized(total_variation(HIDDEN, factor=damped), problem, negatives=0)
    cells = np.eye(42).reshape(42, *HIDDEN)
    slopes = [np.diff(cells, axis=axis).reshape(42, -1) for axis in (1, 2)]
    K = sum(slope @ slope.T for slope in slopes)
    w, h = problem.trust, problem.data
    for k in range(3):
        pull = w[k] * (h[:, k] - EQUATIONS.gram @ f[:, k])
        stiff = K @ f[:, k]
        weight = np.vdot(pull, stiff) / np.vdot(stiff, stiff)  # λ over the image's scale
        assert weight > 0
        assert np.linalg.norm(pull - weight * stiff) < 2e-3 * np.linalg.norm(w[k] * h[:, k])


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_a_heavy_generalized_variation_leaves_the_ramp_that_fits_best(ratio):
    measured = EQUATIONS.measured(photographs(1))
    problem = Problem(measured.data, np.ones((1, 3)), np.array([5.0]))
    f = minimized(generalized_variation(HIDDEN, ratio), problem, negatives=0)[:, 0]
    rows, columns = (axis.ravel() for axis in np.indices(HIDDEN))
    ramps = np.stack([np.ones(42), rows, columns], axis=1)
    expected = ramps @ np.linalg.solve(
        ramps.T @ EQUATIONS.gram @ ramps, ramps.T @ measured.data[:, 0]
    )
    np.testing.assert_allclose(f, expected, atol=0.01 * np.abs(expected).max())


@pytest.mark.thorough
def test_huber_lies_between_total_variation_and_quadratic():
    problem = EQUATIONS.measured(photographs()).problem(0.02)
    sharp, barely, round_, wide = (
        minimized(terms, problem)
        for terms in (
            total_variation(HIDDEN),
            total_variation(HIDDEN, factor=rounded(1e-4)),
            total_variation(HIDDEN, factor=rounded(0.3)),
            total_variation(HIDDEN, factor=rounded(20)),
        )
    )
    size = np.linalg.norm(sharp)
    assert np.linalg.norm(barely - sharp) < 1e-3 * size < np.linalg.norm(round_ - sharp)
    # No gradient is as steep as that: λ/ε times ½‖∇f‖².
    quadratic = minimized(total_variation(HIDDEN, factor=damped), problem_of(0.02 / 20))
    assert np.linalg.norm(wide - quadratic) < 5e-3 * size


def problem_of(weight):
    return EQUATIONS.measured(photographs()).problem(weight)


def test_anisotropic_image_has_the_least_objective():
    terms = total_variation(HIDDEN, together=(3,))
    problem = problem_of(0.05)
    f = minimized(terms, problem)[:, :1]

    def objective(x):
        w, h = problem.trust[0], problem.data[:, :1]
        data = np.sum(w * (x * np.einsum("ij,jpc->ipc", EQUATIONS.gram, x) / 2 - h * x))
        return data + problem.weight[0] * np.linalg.norm(gradient(HIDDEN) @ x[:, 0], axis=1).sum()

    least, rng = objective(f), np.random.default_rng(1)
    for size in (1e-2, 1e-1):
        for _ in range(50):
            other = np.maximum(f + size * rng.standard_normal(f.shape), 0)
            assert objective(other) > least
            blocks = np.where(f > rng.random() * f.max(), f * (1 + size * rng.normal()), f)
            assert objective(blocks) > least - 1e-5 * abs(least)


@pytest.mark.thorough
def test_unbiased_risk_is_the_risk_on_average():
    y = photographs(60)
    measured = EQUATIONS.measured(y)
    solver = Regularized(EQUATIONS.gram, total_variation(HIDDEN), tolerance=1e-4)
    found = trials(solver, EQUATIONS, measured, [0.01, 0.1], seed=0)
    truth = TRUTH.reshape(-1, 1, 3) * EQUATIONS.unit
    wrong = found.images - truth
    risk = np.einsum("wipc,ij,wjpc,pc->wp", wrong, EQUATIONS.gram, wrong, measured.noise**-2.0)
    told = found.misfit + 2 * found.freedom - found.pixels
    differences = told - risk
    # Five standard errors; and the noise's own estimate is within 2 % on average.
    error = differences.std(axis=1, ddof=1) / np.sqrt(len(y))
    assert (np.abs(differences.mean(axis=1)) < 5 * error + 2).all()
    assert (unbiased_risk(found) == np.argmin(told, axis=0)).all()


def test_unpenalized_image_has_a_degree_of_freedom_for_each_patch():
    measured = EQUATIONS.measured(photographs(20))
    solver = Regularized(
        EQUATIONS.gram, total_variation(HIDDEN), negatives=0, tolerance=1e-5,
        max_iterations=20_000,
    )  # fmt: skip
    found = trials(solver, EQUATIONS, measured, [1e-4], seed=0)
    # 126 squares of normal draws, 20 times: a standard error of √(2 · 126 / 20) = 3.5.
    assert abs(found.freedom.mean() - 126) < 18
    left = found.pixels - 126
    assert found.misfit.mean() == pytest.approx(left, rel=0.01)


def test_noise_is_told_from_neighbours_whatever_the_ramp():
    ramp = np.add.outer(np.arange(80.0), 3 * np.arange(90.0))
    noise = np.random.default_rng(0).standard_normal((2, 80, 90, 3)) * NOISE
    found = median_deviation(ramp[None, :, :, None] + noise)
    # A median of some 6900 dependent values scatters by about 2 %.
    np.testing.assert_allclose(found, np.tile(NOISE, (2, 1)), rtol=0.1)


def test_gain_of_the_wall_is_found():
    down, across = np.linspace(-1, 1, 16)[:, None], np.linspace(-1, 1, 18)
    terms = np.stack([(across + 0 * down).ravel(), (down * across).ravel()])
    gain = 1 + 0.2 * terms[0] + 0.1 * terms[1]
    light = A @ TRUTH.reshape(-1, 3)
    F = np.linalg.qr(np.hstack([A, B]))[0]
    bent = gain[:, None] * light + 3 * B @ np.ones((4, 3))
    np.testing.assert_allclose(plain_gain(bent, light, F, terms), gain, atol=1e-9)
    np.testing.assert_allclose(plain_gain(SIGNAL, light, F, terms), 1, atol=1e-9)


def test_a_line_tells_geometric_means_over_the_papers_errors():
    none = np.zeros((0, 16, 18, 3))
    tried = [
        Case("bars 10", none, TRUTH, common=True),
        Case("bars 0.5", none, TRUTH, common=True),
        Case("dots 10", none, TRUTH, common=True),
        Case("low_sun 10", none, TRUTH),
        Case("real", none, TRUTH, real=True),
        Case("real 0.5", none, TRUTH, real=True),
    ]
    errors = {"bars 10": [[1.0, 3.0]], "bars 0.5": [[4.0]], "dots 10": [[5.0]]}
    real = {"real": [[9.0], [12.0]], "real 0.5": [[8.0, 9.0], [10.0, 11.0]]}
    paper = Row("paper", "", errors | {"low_sun 10": [[2.0]]} | real)
    ours = {"bars 10": [[0.5, 0.5]], "bars 0.5": [[0.5]], "dots 10": [[5.0]]}
    table = summary([paper, Row("ours", "w", ours | {"low_sun 10": [[1.0]]} | real)], tried)
    assert table.header[2:] == ("overall", "SBR 10", "SBR 0.5", "low sun", "real", "real 0.5")
    assert table.rows[0][2:6] == ["1.000"] * 4
    # (1/4 · 1/8 · 1)^(1/3), (1/4 · 1)^(1/2), 1/8, 1/2
    assert table.rows[1][:6] == ["ours", "w", "0.315", "0.500", "0.125", "0.500"]
    assert table.rows[1][6:] == ["9.00 / 12.00", "8.50 / 10.50"]
    rendered = summary([paper], tried[:4])
    assert "PSNR" in table.caption and "PSNR" not in rendered.caption


def test_walk_ends_in_the_valley():
    for start in (0.01, 3.0, 1.0):
        assert np.log(lowest(lambda x: np.log(x / 0.3) ** 2, start) / 0.3) == pytest.approx(
            0, abs=np.log(2) / 4 + 1e-9
        )


def test_the_more_negatives_cost_the_fewer_there_are():
    problem = problem_of(0.02)
    left = [
        -np.minimum(minimized(total_variation(HIDDEN), problem, negatives=cost), 0).sum()
        for cost in (0.0, 30.0, 1000.0, np.inf)
    ]
    assert left[0] > 1.1 * left[1] > 2.2 * left[2] > 0 == left[3]
