"""The search from a coarse level to a fine one, and whether to believe what it finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import Explanation
from periscopy_sim.calibration.level import ResolutionLevel, Values
from periscopy_sim.calibration.prior import Prior, UncertainParameters
from periscopy_sim.calibration.result import Calibration, Parameter, Visited
from periscopy_sim.calibration.search import BOX, Descent, Log, descend, places
from periscopy_sim.calibration.trust import bounded, doubts, is_significant, learned
from periscopy_sim.calibration.whitening import STRUCTURED
from periscopy_sim.errors import PeriscopyError, PhotographError, SceneError
from periscopy_sim.scenario import Array

STEP, SPREAD = 0.05, 0.4
"""Relative changes of the transport matrix: by a parameter's scale, and over the half width that is
searched where no ruler knows it, where shadows have moved by about their own size."""

PLACES, MOST_PLACES, UNRULED_PLACES = 8, 24, 128
"""Drawn for each parameter, at most, and in all where no ruler knows one."""

DESCENTS, COARSE_ITERATIONS, FINE_ITERATIONS = 2, 4, 15
"""From the best of the places and the start, and iterations at most."""

ATTEMPTS = 3
"""Times that places are drawn, at most, while the result is in doubt or no noise is left."""

MARGIN = 1.3
"""Of standard errors over those of the linear theory: valleys of the evidence are curved. Measured
with hundreds of simulated plates before a monitor."""

UNEVEN = 2.0
"""Overdispersion from which a residual varies more over the wall than noise does."""

SHOWN = 100.0
"""Gain in evidence over a black monitor below which a photograph shows nothing of the scene."""

MIRRORED = 50.0
"""Gain in evidence by which a flipped photograph suits the scene better."""

FLIPPED: dict[str, tuple[slice, slice]] = {
    "mirrored": (slice(None), slice(None, None, -1)),
    "upside down": (slice(None, None, -1), slice(None)),
    "rotated by 180 degrees": (slice(None, None, -1), slice(None, None, -1)),
}


@dataclass(frozen=True, eq=False)
class _Found:
    """Where a descent on the fine level ended, and how far to believe it.

    `point` is the start where the descent gained no more than chance. `doubts` say why not to
    believe it.
    """

    descent: Descent
    point: Array
    seen: Explanation
    gained: bool
    doubts: tuple[str, ...]

    @property
    def may_be_wrong(self) -> bool:
        """Whether it is in doubt, or its residual is no noise, as at a wrong place."""
        level = self.descent.level
        uneven = level.overdispersion > UNEVEN
        return bool(self.doubts) or level.discrepancy > STRUCTURED or uneven


def search(
    coarse: ResolutionLevel,
    fine: ResolutionLevel,
    shifting: NDArray[np.bool_],
    held: UncertainParameters,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the parameters of two levels of the same photograph, parameters and prior.

    Those that are `shifting`, (P,), shift the hidden image alone. For the rest see `calibrate`.
    """
    return _Search(coarse, fine, shifting, held, Log(progress)).calibration()


@dataclass(frozen=True, eq=False)
class _Search:
    coarse: ResolutionLevel
    fine: ResolutionLevel
    shifting: NDArray[np.bool_]
    held: UncertainParameters
    log: Log

    @property
    def prior(self) -> Prior:
        return self.fine.prior

    @cached_property
    def start(self) -> Array:
        return self.fine.start(self.prior.centers)

    @cached_property
    def scales(self) -> Values:
        """(P,) how far each parameter moves to change the coarse matrix by `STEP`.

        A SceneError says that the photograph does not show one that no ruler knows.
        """
        matrices, values = self.coarse.matrices, self.prior.centers
        A, (changes, *_) = matrices.linearized(values)
        reach = np.array([np.linalg.norm(change) for change in changes]) / np.linalg.norm(A)
        for name, change, known in zip(matrices.names, reach, self.prior.is_known, strict=True):
            if not known and not change > 0:
                raise SceneError(
                    f"the photograph does not show '{name}'; leave it out of --free, or start it "
                    "elsewhere by -D"
                )
        return np.asarray(STEP / np.where(reach > 0, reach, 1e-300))

    @cached_property
    def spreads(self) -> Values:
        """(P,) how far from the start places are sought."""
        known = self.prior.is_known
        return np.where(known, BOX * self.prior.errors, self.scales * (SPREAD / STEP))

    def calibration(self) -> Calibration:
        """Search, and return what was found."""
        self._require_effect()
        best = self.best()
        level, descent = best.descent.level, best.descent
        values, white, gain = level.values(best.point), level.white, best.descent.point
        count = len(values)
        before = np.append(self.prior.centers, gain[count:])
        seen_before, seen = white.explain(before), white.explain(np.append(values, gain[count:]))
        # The ruler's error bounds how far another's may drag a parameter.
        moves = self._moves(descent)
        moves = np.clip(moves, -self.prior.errors[:, None], self.prior.errors[:, None])
        alone, covariance = self._covariances(best, moves)
        deviations = np.sqrt(np.diag(covariance))
        self.log.finish()
        averaged, names = level.averaged, level.matrices.names
        columns = (
            self.prior.centers, values, np.sqrt(np.diag(alone)), deviations,
            self.scales, self.spreads, self.prior.errors,
        )  # fmt: skip
        levels = (self.coarse, self.fine)
        return Calibration(
            parameters=tuple(
                Parameter(name, *(float(n) for n in numbers), trusted=not best.doubts)
                for name, *numbers in zip(names, *columns, strict=True)
            ),
            uncertain=self.held,
            moves=moves,
            correlation=covariance / np.outer(deviations, deviations),
            path=tuple(
                Visited(
                    (each.averaged.used.shape[0], each.averaged.used.shape[1]),
                    each.matrices.hidden_shape,
                    np.array([each.values(point) for point, _ in visited]),
                    np.array([evidence for _, evidence in visited]),
                )
                for each, visited in zip(levels, self.log.visited.values(), strict=True)
            ),
            noise_before=seen_before.noise / averaged.scale,
            noise=seen.noise / averaged.scale,
            residual_before=averaged.picture(seen_before.residual / averaged.scale),
            residual=averaged.picture(seen.residual / averaged.scale),
            gain=averaged.picture(level.gain(gain), outside=1.0),
            discrepancy=level.discrepancy,
            overdispersion=level.overdispersion,
            moved=best.gained,
            doubts=best.doubts,
        )

    def best(self) -> _Found:
        """Return the best that draws and descents lead to; where it may be wrong, draw again.

        Where a search fails, the next best coarse end is tried; if all fail, the first error is
        raised.
        """
        coarse, fine = self.coarse.comparing(self.start), self.fine.comparing(self.start)
        found: _Found | None = None
        failed: list[PeriscopyError] = []
        for attempt in range(ATTEMPTS):
            share = 1 - 0.5**attempt
            ends = self._ends(coarse, attempt, share)
            if found is not None:
                least = coarse.judgement(found.descent.point)
                ends = [end for end in ends if coarse.judgement(end) < least][:1]
            self.log.expect(FINE_ITERATIONS, 1 - 0.5 ** (attempt + 1))
            for end in ends:
                try:
                    other = self._followed(end)
                except (SceneError, PhotographError) as error:
                    failed.append(error)
                    continue
                found = other if found is None else _better(fine, found, other)
                break
            if found is None:
                raise failed[0]
            if not found.may_be_wrong:
                break
        assert found is not None
        return found

    def _ends(self, coarse: ResolutionLevel, attempt: int, share: float) -> list[Array]:
        """Return where coarse descents end, the best first; the start is the last resort."""
        known, count = self.prior.is_known, len(self.scales)
        number = min(PLACES * count, MOST_PLACES) if known.all() else UNRULED_PLACES
        self.log.expect(DESCENTS * COARSE_ITERATIONS, share + 0.25 * (1 - share))
        widths = np.where(known, self.prior.errors, self.spreads / 2)
        drawn = places(coarse, self.start, widths, number, self.fine.seed + attempt)
        begin = [self.start, *drawn] if attempt == 0 else drawn
        begin = sorted(begin[:DESCENTS], key=coarse.judgement)
        steps = np.minimum(self.scales, self.prior.errors)
        ends, visit = [], self.log.at(0)
        for place in begin:
            try:
                end = descend(coarse, place, steps, COARSE_ITERATIONS, visit)
            except SceneError:
                continue
            ends.append(end.point)
        ends = sorted([*ends, self.start], key=coarse.judgement)
        return ends if attempt == 0 else ends[:1]

    def _followed(self, point: Array) -> _Found:
        """Return what the fine level finds from a point, and whether to believe it.

        A SceneError says that the search left the physical, a PhotographError that nothing is seen.
        """
        seen = self.coarse.explain(point)
        shown = seen.darkness - (seen.evidence - self.coarse.penalty(point))
        if not shown >= SHOWN:  # nor where nothing is a number
            raise PhotographError(
                "the photograph shows no shadows of this scene, wherever its parameters are; "
                "nothing can be learned from it"
            )
        steps = np.minimum(self.scales, self.prior.errors)
        end = descend(self.fine, point, steps, FINE_ITERATIONS, self.log.at(1))
        level, names = end.level, self.fine.matrices.names
        if end.unphysical is not None:
            values = zip(names, level.values(end.point), strict=True)
            place = ", ".join(f"{name} = {value:.4g}" for name, value in values)
            raise SceneError(
                f"the search left the physical, past {place}: {end.unphysical}; free less, or fix "
                "the one that went too far by -D"
            )
        seen, point = level.judge(end.point), end.point
        without = [self.start, np.append(self.prior.centers, point[len(names) :])]
        before = min((level.judge(each) for each in without), key=lambda each: each.evidence)
        known = learned(end.curvature.of(np.arange(len(point)) < len(names)))
        gained = is_significant(before.evidence - seen.evidence, known)
        if self.prior.is_known.all() and not gained:
            point, seen = without[1], before
        misfit, negative = 0.0, 0.0
        if level.discrepancy > STRUCTURED:
            misfit = level.white.explain(point).unexplained
            negative = seen.darker_than_black
        why = doubts(
            names, level.values(point), self.spreads, self.prior, gained, known, misfit, negative
        )
        return _Found(end, point, seen, gained, why + self._doubted_orientation(point))

    def _doubted_orientation(self, point: Array) -> tuple[str, ...]:
        """Return a doubt if the photograph, flipped, is explained better than as it is."""
        white, averaged = self.coarse.white, self.coarse.averaged
        if not averaged.used.all():
            return ()
        as_it_is = white.explain(point).evidence
        light = averaged.picture(averaged.light)
        for name, flip in FLIPPED.items():
            flipped = replace(averaged, light=light[flip].reshape(-1, 3))
            level = replace(white, averaged=flipped)
            if min(level.explain(at).evidence for at in (self.start, point)) < as_it_is - MIRRORED:
                return (f"the photograph may be {name}: so it is explained better than as it is",)
        return ()

    def _require_effect(self) -> None:
        """Check that the photograph shows errors of uncertain parameters; else a SceneError."""
        if not len(self.held.names):
            return
        changes = self._held_derivatives(self.coarse, self.prior.centers)
        for name, error, change in zip(
            self.held.names, self.held.standard_errors, changes, strict=True
        ):
            if not change.any():
                raise SceneError(
                    f"--uncertain {name}={error:g}: the photograph does not show such an error; "
                    "leave it out"
                )

    def _held_derivatives(self, level: ResolutionLevel, values: Values) -> NDArray[np.float32]:
        """Return derivatives of the matrix by the uncertain parameters, (U, M, N)."""
        matrices = level.matrices
        given = {n: f"{value:.17g}" for n, value in zip(matrices.names, values, strict=True)}
        other = replace(
            matrices,
            fixed={**matrices.fixed, **given},
            names=self.held.names,
            steps=self.held.standard_errors,
        )
        _, (changes, *_) = other.linearized(self.held.values)
        return np.asarray(changes[:, level.averaged.used.ravel()])

    def _moves(self, end: Descent) -> Array:
        """Return how far a standard error of each uncertain parameter moves the values, (P, U).

        Were such a parameter p wrong by δ, the photograph would be explained best elsewhere, by
        δθ = −(I_θθ + Λ)⁻¹ I_θp δ.
        """
        count, errors = len(self.prior.centers), self.held.standard_errors
        if not len(errors):
            return np.zeros((count, 0))
        level, seen, about = end.level, end.explanation, end.curvature
        changes = self._held_derivatives(level, level.values(end.point))
        gain, images = level.gain(end.point)[:, None], seen.images.astype(np.float32)
        motions = np.array([seen.motion(gain * (change @ images)) for change in changes])
        shared = np.einsum("imc,jmc->ij", about.beyond, motions)
        return np.asarray(-np.linalg.solve(about.damped(), shared) * errors)[:count]

    def _covariances(self, best: _Found, moves: Array) -> tuple[Array, Array]:
        """Return the parameters' covariances, (P, P): alone, and with the uncertain ones' errors.

        Parameters that shift the image alone are known by the ruler, and the others, which move as
        they do, no better: a room that is moved as a whole looks the same.
        """
        end, count = best.descent, len(self.prior.centers)
        # A shift of the image that no ruler knows is anywhere that was searched.
        unknown = self.shifting & ~self.prior.is_known
        values = best.descent.level.values(best.point)
        ruler = np.hypot(
            np.where(unknown, self.spreads, self.prior.errors), values - self.prior.centers
        )
        if self.prior.is_known.all() and not best.gained:
            alone = np.diag(ruler**2)
        else:
            shifting = np.append(self.shifting, np.zeros(len(end.point) - count, bool))
            about, others = end.curvature, ~shifting
            errors = end.explanation.residual / end.explanation.deviations
            scores = about.of(others).block_scores(errors, end.level.averaged.used)
            alone = np.zeros(2 * (len(shifting),))
            alone[np.ix_(others, others)] = MARGIN**2 * about.of(others).covariance(scores)
            following = np.zeros((len(shifting), int(shifting.sum())))
            crossed = about.damped()[np.ix_(others, shifting)]
            following[others] = -np.linalg.solve(about.of(others).damped(), crossed)
            following[shifting] = np.eye(int(shifting.sum()))
            alone += (following * ruler[self.shifting] ** 2) @ following.T
            alone = alone[:count, :count]
        return bounded(alone, ruler), bounded(alone + moves @ moves.T, ruler)


def _better(level: ResolutionLevel, found: _Found, other: _Found) -> _Found:
    """Return the one of two that explains more, each by its own residual."""
    κ = min(each.descent.level.overdispersion for each in (found, other))
    level = replace(level, overdispersion=κ)
    return other if level.judgement(other.point) < level.judgement(found.point) else found
