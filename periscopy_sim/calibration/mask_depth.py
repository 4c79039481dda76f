"""How far from the monitor a flat occluder stands, where a ruler leaves that open.

A plane that is s times as far from the monitor as measured casts the shadows of another mask, of a
larger image the nearer it is to the wall: a depth is wrong if the image would reach beyond the
monitor. Along the plane it moves as the errors of the scene's numbers do together.

    J(s) = min_{o, a} J(o, a; s) + log(s)² / 2 σ²,

σ the error of the measured distance over the distance. Cells, patches and unfinished descents make
J uneven. So the standard error of log s is √(max(1, r) / J″), of the parabola through J about its
least value; r is the root mean square of J less the parabola.

A picture with dark margins may be at another depth, too. How much smaller than the monitor an
unknown one may be adds to the error: its width grows with s as s / (1 − s t), t the measured
fraction of the way from the monitor to the wall.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np

from periscopy_sim.calibration import prior
from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.calibration.result import Parameter
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.nodes import SceneNodes, only_motions
from periscopy_sim.view import Geometry

KNOWN = 0.02
"""Error of the scale up to which a search keeps the measured one: it errs as much itself."""

DIGITS = 6
"""Decimals of a scale that count; the rest is rounding of places."""

FAR, SPACING = 2.0, 0.2
"""Errors from the measured distance within which a search begins, and its steps of log s."""

WAY = 0.1, 0.9
"""Fractions of the way from the monitor to the wall between which a mask may stand."""

MARGINS = 0.2
"""Standard error of the logarithm of an unknown picture's width, over the monitor's. By this value
the depths of twelve letters and signs, behind pictures with margins of 0 to 4 patches of 24, have
a root mean square z of 1.0; without it 8."""

STEPS = 4, 2, 1
"""Steps that refine log s, in units of `KNOWN`."""

NEIGHBOURS = 5
"""Places nearest to the best, through whose objectives the parabola goes."""


class Placed(Protocol):
    """What explains a photograph at a scale s, as well as its objective is low."""

    @property
    def scale(self) -> float:
        """Distance over the measured one."""

    @property
    def objective(self) -> float:
        """Negative logarithm of the posterior density, without the prior of s."""


End = TypeVar("End", bound=Placed)


@dataclass(frozen=True, eq=False)
class Depth:
    """The distance of a plane from the middle of the monitor, over the measured one.

    Attributes
    ----------
    measured
        The plane as measured.
    monitor
        (3,) the middle.
    way
        Fraction of the way from the monitor to the wall at which the plane was measured.
    motion
        (3,) of the plane by a change of the scale by 1.
    values, slopes
        The scene's numbers that move this shape alone and declare an error, as measured, and how
        they change with the scale.
    ruler_error
        Standard error of the scale by these.
    scale, error
        The estimate, with its standard error.
    """

    measured: MaskPlane
    monitor: Array
    way: float
    motion: Array
    values: Mapping[str, float]
    slopes: Mapping[str, float]
    ruler_error: float
    scale: float = 1.0
    error: float = 0.0

    @classmethod
    def of(cls, scenario: Geometry, shape: str, plane: MaskPlane) -> Self:
        """Return the measured depth of a shape's plane; a SceneError says that errors are none."""
        document, monitor = scenario.scene.document, scenario.hidden.centers.mean(axis=0)
        middle = plane.points(np.array([0.5, 0.5]))
        normal = np.cross(plane.across, plane.down)
        normal /= normal @ (middle - monitor)
        errors = {n: e for n, e in prior.declared_errors(document).items() if e > 0}
        values = prior.start_values(document, list(errors)).tolist() if errors else []
        layout, motions = SceneNodes(document.path, document.given).layout(), {}
        for (name, error), value in zip(errors.items(), values, strict=True):
            parameters = {**document.given, name: f"{value + error:.9g}"}
            moved = only_motions(layout, SceneNodes(document.path, parameters).layout(), [shape])
            if moved:
                motions[name] = (moved[shape] @ np.append(middle, 1))[:3] - middle
        J = np.array([*motions.values()]).reshape(-1, 3)
        deeper = np.round(J @ normal, DIGITS)
        variance = max(float(deeper @ deeper), 10.0 ** (-2 * DIGITS))
        steps = zip(motions, deeper / variance, strict=True)
        error = float(np.linalg.norm(deeper))
        return cls(
            plane,
            monitor,
            1 - plane.fraction(scenario),
            deeper @ J / variance,
            {n: v for n, v in zip(errors, values, strict=True) if n in motions},
            {name: float(errors[name] * step) for name, step in steps},
            error,
            error=error,
        )

    def plane(self, scale: float) -> MaskPlane:
        """Return the plane at a scale."""
        return self.measured.moved((scale - 1) * self.motion)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The numbers that move the plane to or from the monitor."""
        return tuple(
            Parameter(
                name,
                start := self.values[name],
                start + (self.scale - 1) * slope,
                *(abs(slope) * each for each in (self.error, self.error, self.ruler_error)),
            )
            for name, slope in self.slopes.items()
            if slope
        )

    @property
    def is_free(self) -> bool:
        """Whether a search may change the scale."""
        return self.ruler_error > KNOWN

    @property
    def scales(self) -> list[float]:
        """The scales at which a search begins."""
        far = FAR * self.ruler_error if self.is_free else 0.0
        count = 2 * int(np.ceil(far / SPACING)) + 1
        each = np.exp(np.linspace(-far, far, count)).tolist()
        return [s for s in each if np.isfinite(self.penalty(s))]

    def penalty(self, scale: float) -> float:
        """Return the negative logarithm of the prior's density; infinite where there is no room."""
        if not WAY[0] <= scale * self.way <= WAY[1] and scale != 1:
            return np.inf
        return float(np.log(scale) ** 2 / 2 / self.ruler_error**2) if self.is_free else 0.0

    def objective(self, end: End) -> float:
        """Return J."""
        return end.objective + self.penalty(end.scale)

    def scanned(self, at: Callable[[float], Iterable[End]]) -> list[End]:
        """Return the ends at the scales where a search begins, the best one first.

        A SceneError says that the mask casts no shadow into view at any of them.
        """
        ends, errors = list[End](), []
        for scale in self.scales:
            try:
                ends += at(scale)
            except SceneError as error:
                errors.append(error)
        if not ends:
            raise errors[0]
        return sorted(ends, key=self.objective)

    def refined(
        self,
        first: End,
        at: Callable[[float, End], End],
        report: Callable[[float], None],
        margins: float = 0.0,
    ) -> tuple[End, Self]:
        """Return the likeliest end near the first one, and the depth with its error.

        `at` returns the end at a scale, from an end at another. `margins` is the standard error of
        the logarithm of the image's width.
        """
        if not self.is_free:
            return first, self
        ends, best = {0: first}, 0
        for number, step in enumerate(STEPS):
            while True:
                for k in (best - step, best + step):
                    scale = first.scale * np.exp(KNOWN * k)
                    if k not in ends and np.isfinite(self.penalty(scale)):
                        with suppress(SceneError):  # it casts no shadow into view there
                            ends[k] = at(scale, ends[best])
                report((number + 1) / len(STEPS))
                before, best = best, min(ends, key=lambda k: self.objective(ends[k]))
                if best == before:
                    break
        nearest = sorted(ends, key=lambda k: abs(k - best))[:NEIGHBOURS]
        objectives = np.array([self.objective(ends[k]) for k in nearest])
        end = ends[best]
        larger = margins * (1 - end.scale * self.way)
        error = np.hypot(_error(KNOWN * np.array(nearest), objectives), larger)
        error = min(float(error), self.ruler_error)
        return end, replace(self, scale=end.scale, error=end.scale * error)


def _error(logs: Array, objectives: Array) -> float:
    """Return the standard error of log s; infinite where no parabola has a least value."""
    if len(logs) <= 3:
        return np.inf
    parabola = np.polynomial.Polynomial.fit(logs, objectives, 2)
    rest = objectives - parabola(logs)
    curvature = float(parabola.deriv(2)(0.0))
    roughness = np.sqrt(np.sum(rest**2) / (len(logs) - 3))
    return float(np.sqrt(max(1.0, roughness) / curvature)) if curvature > 0 else np.inf
