"""What of the noise-aware method helps, and what would help it more: one table of errors.

The first rows are the package's methods: the paper's; the noise-aware one as users have it, which
takes a gain over the wall into account where a test finds one; and the same without its gain. From
the last of these, in all rows below, one thing at a time is taken, or put in another's place: the
photograph's noise, the sign, the channels' common edges; the penalty, the rule for its weight, the
estimate of σ, the model of ambient light. The last rows divide by a plainer estimate of the gain,
of several degrees, without a test.

Weights of different penalties mean different things. Each row marked * has the weight that is best,
by the truth, over rendered photographs under three of the realistic lights (geometric mean over
images and ratios); the same is then used on all others, the real photograph included. Where * marks
a rule, the truth of each photograph, the real one too, chose.

No row's numbers are fitted to the real photograph, but it is one photograph, and its scores were
seen while the package's gain and the rows on the gain, on negatives and on B were chosen, among
more than a hundred: the best of them flatters.

`python -m experiments.beyond.ablation --out DIR [--real FILE.npz]`
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.beyond.ablation_cases import REAL, Case, cases
from experiments.beyond.ablation_table import MARKDOWN, Row, markdown, noise_table, summary, table
from experiments.beyond.normal_equations import Measured, NormalEquations, median_deviation
from experiments.beyond.regularizers import (
    CHANNELS,
    DIRECTIONS,
    Problem,
    Regularized,
    Term,
    damped,
    generalized_variation,
    rounded,
    total_variation,
)
from experiments.beyond.wall_gain import plain_gain
from experiments.beyond.weight_rules import RULES, Choices, Trials, trials
from experiments.page import alone, described
from experiments.paper.background_models import FINER, grids, polynomials, sketched_basis
from experiments.report import Claim, Section, Verdict
from experiments.setting import Setting
from periscopy_sim.reconstruction.background_subspace import background_basis
from periscopy_sim.reconstruction.noise_aware.nuisance.wall_gain import polynomials as gain_terms
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]

WEIGHT = 0.02
"""The package's own."""

PAPER = "paper's method"
WITH_GAIN, WITHOUT_GAIN = "noise-aware method", "noise-aware method without its gain"
GRID = tuple(WEIGHT * 2 ** (k / 2) for k in range(-6, 7))
DENSER = "nearer, denser across"
ROUNDINGS = (0.05, 0.2, 0.5)
DEGREE = 10
COSTS = (1.0, 10.0)
"""Of negatives, see `Regularized`."""

Weigh = Callable[[Measured, float], Problem]
Recover = Callable[[Case], Array]


def flat(case: Case) -> Array:
    """Return its photographs as (P, M, 3)."""
    return case.photographs.reshape(len(case.photographs), -1, 3)


class Bench:
    """Cases, reduced once, and the methods that are tried on them."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.cases = list(cases(setting))
        self.Q = background_basis(setting.B)
        self.equations = NormalEquations(setting.A, self.Q)
        self.measured = {case.name: self.equations.measured(flat(case)) for case in self.cases}

    @cached_property
    def variation(self) -> Regularized:
        """The method's own problem, by the solver of this experiment."""
        return Regularized(self.equations.gram, total_variation(self.setting.hidden))

    def fitted(self, *, wall_gain: bool | None = None) -> ps.NoiseAware:
        """Fit the package's method."""
        setting = self.setting
        return ps.NoiseAware.for_scene(setting.scenario, setting.A, setting.B, wall_gain=wall_gain)

    @cached_property
    def denser(self) -> Array:
        """Basis of nearer lights, denser across."""
        lights = ps.point_light_backgrounds(self.setting.scenario, grids()[DENSER])
        return sketched_basis(lights)

    def images(self, solutions: Array) -> Array:
        """Shape (N, P, 3) solutions into (P, R, C, 3) images; errors do not depend on the scale."""
        return np.moveaxis(solutions, 0, 1).reshape(-1, *self.setting.hidden, 3)

    def row(self, name: str, weight: str, recover: Recover, solves: str = "1") -> Row:
        """Score a method on every case."""
        scores = {case.name: case.scores(recover(case)).tolist() for case in self.cases}
        print(f"{name} {weight}", flush=True)
        return Row(name, weight, scores, solves)

    def tuned(
        self, name: str, solver: Regularized, weigh: Weigh = Measured.problem, start: float = WEIGHT
    ) -> Row:
        """Score a penalty at the weight that is best on the rendered photographs."""
        some = [
            (case, replace(m, data=m.data[:, ::3], energy=m.energy[::3], noise=m.noise[::3]))
            for case in self.cases
            if case.common
            for m in [self.measured[case.name]]
        ]

        def loss(weight: float) -> float:
            errors = [
                np.mean(case.scores(self.images(solver.minimize(weigh(m, weight)))))
                for case, m in some
            ]
            return float(np.mean(np.log(errors)))

        weight = lowest(loss, start)
        return self.row(f"{name} *", f"{weight:.2g}", self.solved(solver, weigh, weight))

    def solved(
        self, solver: Regularized, weigh: Weigh = Measured.problem, weight: float = WEIGHT
    ) -> Recover:
        """Recover by a solver at one weight."""
        return lambda case: self.images(solver.minimize(weigh(self.measured[case.name], weight)))


def lowest(loss: Callable[[float], float], start: float) -> float:
    """Walk by factors of √2 to where a function of one valley is least."""
    here, least = start, loss(start)
    for factor in (np.sqrt(2), 1 / np.sqrt(2)):
        while (value := loss(here * factor)) < least:
            here, least = here * factor, value
        if here != start:
            break
    return here


def alike(measured: Measured, weight: float) -> Problem:
    """Weigh all channels as if their noise were the same."""
    problem = measured.problem(weight)
    return replace(problem, trust=np.ones_like(problem.trust))


def run(setting: Setting) -> Section:
    """Score every variant, and write `ablation.md` and `ablation.json`."""
    bench = Bench(setting)
    rows = [
        *packaged(bench),
        *parts(bench),
        *penalties(bench),
        *rules(bench),
        *estimates(bench),
        *backgrounds(bench),
        *gains(bench),
    ]
    section = Section(
        name="ablation",
        title="What of the noise-aware method helps",
        text=described(__doc__),
        claims=list(gains_found(bench)),
        tables=[summary(rows, bench.cases), noise_table(bench.cases, bench.measured)],
    )
    with staged_file(setting.out / MARKDOWN) as file:
        file.write_text(markdown(section, table(rows, bench.cases)), "utf-8")
    with staged_file(setting.out / "ablation.json") as file:
        text = json.dumps([asdict(row) for row in rows], indent=1, ensure_ascii=False)
        file.write_text(text + "\n", "utf-8")
    return section


def packaged(bench: Bench) -> Iterator[Row]:
    """Score the paper's method, the noise-aware one as users have it, and that without its gain."""

    def each(method: ps.Periscope | ps.NoiseAware) -> Recover:
        return lambda case: np.stack([*map(method.reconstruct, case.photographs)])

    yield bench.row(PAPER, "", each(bench.setting.preconditioned))
    yield bench.row(WITH_GAIN, f"{WEIGHT}", each(bench.fitted()))
    without = bench.fitted(wall_gain=False)
    yield bench.row(WITHOUT_GAIN, f"{WEIGHT}", each(without))


def parts(bench: Bench) -> Iterator[Row]:
    """Take one part after another from the method."""
    gram, hidden = bench.equations.gram, bench.setting.hidden
    colour = total_variation(hidden)
    yield bench.tuned("the same at its best weight", bench.variation)

    def white(measured: Measured, weight: float) -> Problem:
        return bench.equations.whitened(measured).problem(weight)

    yield bench.tuned("noise taken as white in P y", Regularized(np.eye(len(gram)), colour), white)
    free = Regularized(gram, colour, negatives=0)
    yield bench.row("f of either sign", f"{WEIGHT}", bench.solved(free))
    yield bench.tuned("f of either sign", free)
    for cost in COSTS:
        lenient = Regularized(gram, colour, negatives=cost)
        yield bench.row(f"negatives at a cost of {cost:g}", f"{WEIGHT}", bench.solved(lenient))
    yield bench.row("same noise in all channels", f"{WEIGHT}", bench.solved(bench.variation, alike))
    apart = Regularized(gram, total_variation(hidden, together=(DIRECTIONS,)))
    yield bench.row("channels apart", f"{WEIGHT}", bench.solved(apart))
    yield bench.tuned("channels apart", apart)


def penalties(bench: Bench) -> Iterator[Row]:
    """Put other penalties in the place of total variation."""
    hidden = bench.setting.hidden
    tried: dict[str, list[Term]] = {
        "anisotropic total variation": total_variation(hidden, together=(CHANNELS,)),
        **{
            f"Huber, ε = {ε} of the image's RMS": total_variation(hidden, factor=rounded(ε))
            for ε in ROUNDINGS
        },
        "TGV², β = 2": generalized_variation(hidden),
        "TGV², β = 1": generalized_variation(hidden, 1.0),
        "quadratic ‖∇f‖²": total_variation(hidden, factor=damped),
    }
    for name, terms in tried.items():
        yield bench.tuned(name, Regularized(bench.equations.gram, terms))


def rules(bench: Bench) -> Iterator[Row]:
    """Choose the weight of each photograph by rules, from one grid; last by the truth."""
    found: dict[str, Trials] = {}
    scores: dict[str, Array] = {}
    for number, case in enumerate(bench.cases):
        measured, seed = bench.measured[case.name], bench.setting.seed + number
        found[case.name] = trials(bench.variation, bench.equations, measured, GRID, seed)
        tried = found[case.name].images
        scores[case.name] = np.stack([case.scores(bench.images(images)) for images in tried])

    def row(name: str, choices: Mapping[str, Choices], solves: str) -> Row:
        weights = [GRID[k] for case in bench.cases for k in choices[case.name]]
        told = f"{np.quantile(weights, 0.1):.2g} to {np.quantile(weights, 0.9):.2g}"
        chosen = {
            case: scores[case][choice, :, np.arange(len(choice))].T.tolist()
            for case, choice in choices.items()
        }
        print(name, flush=True)
        return Row(name, told, chosen, solves)

    for name, (rule, each) in RULES.items():
        choices = {case: rule(trial) for case, trial in found.items()}
        yield row(f"λ by {name}", choices, f"{each} a weight")
    best = {
        case.name: np.argmin((-1 if case.real else 1) * scores[case.name][:, -1], axis=0)
        for case in bench.cases
    }
    yield row("λ by the truth, of each photograph *", best, "1 a weight")


def estimates(bench: Bench) -> Iterator[Row]:
    """Estimate σ from neighbouring pixels instead of what least squares leaves."""

    def recover(case: Case) -> Array:
        measured = replace(bench.measured[case.name], noise=median_deviation(case.photographs))
        return bench.images(bench.variation.minimize(measured.problem(WEIGHT)))

    yield bench.row("σ by neighbouring pixels", f"{WEIGHT}", recover)


def backgrounds(bench: Bench) -> Iterator[Row]:
    """Score models of ambient light with more columns."""
    setting = bench.setting
    smooth = polynomials(setting.scenario.photograph_shape, DEGREE)
    finer = ps.point_light_backgrounds(setting.scenario, grids()[FINER])
    bases = {
        f"B: {FINER}": sketched_basis(finer),
        f"B: {DENSER}": bench.denser,
        f"B: and polynomials of degree {DEGREE}": np.linalg.qr(np.hstack([bench.Q, smooth]))[0],
    }
    for name, Q in bases.items():
        equations = NormalEquations(setting.A, Q)
        solver = Regularized(equations.gram, total_variation(setting.hidden))

        def recover(
            case: Case, equations: NormalEquations = equations, solver: Regularized = solver
        ) -> Array:
            problem = equations.measured(flat(case)).problem(WEIGHT)
            return bench.images(solver.minimize(problem))

        yield bench.row(f"{name} (rank {Q.shape[1]})", f"{WEIGHT}", recover)


def gains(bench: Bench) -> Iterator[Row]:
    """Find a gain over the wall from a first image, divide by it, and recover again.

    These rows differ from the package's own gain, which is of degree 2, by the degrees tried; no
    test accepts the gain; no smooth ambient light but that of B, or of a richer one, is kept apart
    while it is found; the first image is a converged one; and the photograph, ambient light
    included, is divided by the gain, where the package subtracts what the gain adds.
    """
    setting, equations = bench.setting, bench.equations
    plain = "divided by a plain gain of degree {}, no test"
    tried = {
        **{plain.format(degree): (bench.Q, degree) for degree in (1, 2, 3)},
        f"{plain.format(2)}, found with B {DENSER}": (bench.denser, 2),
    }
    for name, (Q, degree) in tried.items():
        F = np.linalg.qr(np.hstack([Q, equations.A]))[0]
        terms = gain_terms(setting.scenario.photograph_shape, 1, degree)

        def recover(case: Case, F: Array = F, terms: Array = terms) -> Array:
            y = flat(case)
            first = bench.variation.minimize(bench.measured[case.name].problem(WEIGHT))
            light = np.tensordot(equations.A, first / equations.unit, 1).swapaxes(0, 1)
            found = [plain_gain(*seen, F, terms) for seen in zip(y, light, strict=True)]
            even = equations.measured(y / np.stack(found)[..., None])
            return bench.images(bench.variation.minimize(even.problem(WEIGHT)))

        yield bench.row(name, f"{WEIGHT}", recover, "2")


def gains_found(bench: Bench) -> Iterator[Claim]:
    """Count the photographs in which the package's test finds a gain over the wall."""
    method = bench.fitted()
    kinds: dict[str, list[Case]] = {}
    for case in bench.cases:
        light = "realistic light" if case.common else "adversarial light or other noise"
        kinds.setdefault(REAL if case.real else f"rendered, {light}", []).append(case)
    for kind, members in kinds.items():
        solved = [method.solve(y) for case in members for y in case.photographs]
        found = [solution.gain for solution in solved if solution.has_gain]
        between = f", between {np.min(found):.2f} and {np.max(found):.2f}" if found else ""
        yield Claim(
            f"photographs in which the noise-aware method finds a gain over the wall: {kind}",
            "",
            f"{len(found)} of {len(solved)}{between}",
            Verdict.MEASURED,
        )


if __name__ == "__main__":
    alone(run)
