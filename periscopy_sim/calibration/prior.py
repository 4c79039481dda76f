"""What is known of a scene's parameters before the photograph: values, errors, what is physical."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import RULER_ERROR, read_document, undeclared
from periscopy_sim.scenario import Occluder, Scenario

Array = NDArray[np.float64]
Free = Sequence[str] | Mapping[str, float | None]
"""Names of parameters that are free, or names with a ruler's errors; see `free_parameters`."""

OUT_OF_PLANE = 0.25
"""Fraction of a shift of the monitor, at most, that leads out of its plane: 14 degrees."""

SAME = 1e-6
"""Fraction of the largest coordinate within which points are the same, in single precision."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal distributions of some parameters before the photograph is looked at.

    An infinite error says that nothing is known.
    """

    centers: Array  # (P,)
    errors: Array  # (P,) standard deviations

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(P,) whether a ruler knows a parameter."""
        return np.isfinite(self.errors)

    @property
    def precision(self) -> Array:
        """(P,) reciprocals of the variances."""
        return self.errors**-2.0

    def distance(self, values: Array) -> Array:
        """Return how far values, (P,), are from the centres, in errors."""
        return np.asarray((values - self.centers) / self.errors)

    def penalty(self, values: Array) -> float:
        """Return twice the negative logarithm of the density at values, (P,), less a constant."""
        return float(np.sum(self.distance(values) ** 2))

    def slope(self, values: Array) -> Array:
        """Return the derivatives, (P,), of half the penalty."""
        return np.asarray(self.distance(values) / self.errors)


class InFront:
    """Check that occluders stay before the wall that stood before it at first.

    In the scene at first, one that reaches through the part of the wall that the camera sees is a
    SceneError.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._names = set()
        extent = float(np.linalg.norm(np.ptp(scenario.wall_points, axis=0)))
        spacing = extent / float(np.sqrt(len(scenario.wall_points)))
        for name, depth, aside in _before_wall(scenario):
            through = (depth < 0) & (aside < 2 * spacing)
            if through.any() and (depth > 0).any():
                raise _through(scenario, name, float(-depth[through].min()))
            if (depth > 0).all():
                self._names.add(name)

    def check(self, scenario: Scenario) -> None:
        """Raise a SceneError if one of them reaches through the wall."""
        for name, depth, _ in _before_wall(scenario):
            if name in self._names and (depth < 0).any():
                raise _through(scenario, name, float(-depth.min()))


def _before_wall(scenario: Scenario) -> Iterator[tuple[str, Array, Array]]:
    """Yield each mesh's name, and its vertices' distances, (V,), before the wall and along it."""
    from scipy.spatial import KDTree

    wall = KDTree(scenario.wall_points)
    for occluder in scenario.occluders:
        if (vertices := occluder.vertices) is None:
            continue
        _, nearest = wall.query(vertices)
        offset, normals = vertices - scenario.wall_points[nearest], scenario.wall_normals[nearest]
        depth = np.einsum("vi,vi->v", offset, normals)
        yield occluder.name, depth, np.linalg.norm(offset - depth[:, None] * normals, axis=1)


def _through(scenario: Scenario, name: str, depth: float) -> SceneError:
    values = ", ".join(f"{key} = {value:.9}" for key, value in scenario.parameters.items())
    return SceneError(
        f"scene '{scenario.path}': occluder '{name}' reaches {1e3 * depth:.3g} mm through the wall"
        + (f" at {values}" if values else "")
        + "; start elsewhere by -D"
    )


@dataclass(frozen=True, eq=False)
class UncertainParameters:
    """``<default>``s of a scene that are held at values, (U,), known to standard errors, (U,)."""

    names: tuple[str, ...]
    values: Array
    standard_errors: Array


def uncertain_parameters(
    path: Path, free: Sequence[str], given: Mapping[str, str], errors: Mapping[str, float]
) -> UncertainParameters:
    """Return uncertain parameters by their standard errors; the others are `free` or `given`.

    A SceneError says that one is not declared, no finite number, free, or its error not positive.
    """
    names = tuple(errors)
    for name in names:
        if name in free:
            raise SceneError(
                f"'{name}' is both free and uncertain: name it in --free or --uncertain"
            )
        if not (np.isfinite(errors[name]) and errors[name] > 0):
            raise SceneError(f"standard error {errors[name]:g} of '{name}': give a positive number")
    values = start_values(path, names, given) if names else np.empty(0)
    return UncertainParameters(names, values, np.array(list(errors.values()), np.float64))


def shifts_image(here: Scenario, moved: Scenario) -> bool:
    """Return whether a scene differs from another only by a shift of its monitor in its plane.

    The image moved the other way by whole patches then gives the same photograph.
    """
    shifts = moved.patch_centers - here.patch_centers
    shift = shifts.mean(axis=0)
    if np.abs(here.patch_normals @ shift).max() >= OUT_OF_PLANE * np.linalg.norm(shift):
        return False
    still = [
        (shifts, np.broadcast_to(shift, shifts.shape)),
        (here.patch_normals, moved.patch_normals),
        (here.patch_across, moved.patch_across),
        (here.patch_up, moved.patch_up),
        (here.wall_points, moved.wall_points),
        *((_outline(a), _outline(b)) for a, b in zip(here.occluders, moved.occluders, strict=True)),
    ]
    same = SAME * max(np.abs(points).max() for points in (here.wall_points, here.patch_centers))
    return all(a.shape == b.shape and np.abs(a - b).max(initial=0) <= same for a, b in still)


def _outline(occluder: Occluder) -> Array:
    """Return points that tell where an occluder stands: a mesh's own, of others the box's."""
    points = occluder.bounds if occluder.vertices is None else occluder.vertices
    return np.empty((0, 3)) if points is None else points


def start_values(path: Path, free: Sequence[str], given: Mapping[str, str]) -> Array:
    """Return where parameters of a scene file start, (P,): as given, or at their defaults.

    A SceneError says that none is free, one is not declared, named twice, or no finite number.
    """
    document = read_document(path)
    declared = {n: text for n, text in document.defaults.items() if n not in document.errors}
    numbers = {name: text for name, text in declared.items() if _number(text) is not None}
    known = ", ".join(f"{name} ({value})" for name, value in numbers.items()) or "none"
    if not free:
        raise SceneError(
            f"no parameter is free; name some by --free, or declare how well the ruler knows them, "
            f'such as <default name="NAME{RULER_ERROR}" value="0.005"/>; scene \'{path}\' declares '
            f"{known}"
        )
    for name in free:
        if name in document.errors:
            raise SceneError(
                f"'{name}' is how well the ruler knows '{document.errors[name]}', which scene "
                f"'{path}' declares; free that one"
            )
        if name not in declared:
            raise undeclared(path, name, declared)
        if name not in numbers:
            raise SceneError(
                f"parameter '{name}' is no number in scene '{path}'; it declares {known}"
            )
        if free.count(name) > 1:
            raise SceneError(f"parameter '{name}' is free twice")
        if _number(given.get(name, "0")) is None:
            raise SceneError(f"-D {name}={given[name]}: give a finite number to start from")
    return np.array([float(given.get(name, numbers[name])) for name in free])


def declared_errors(path: Path, given: Mapping[str, str]) -> dict[str, float]:
    """Return the ruler's errors that a scene file declares, or that are given instead, by name.

    A SceneError says that one is no number from 0 on, or of nothing that the scene declares.
    """
    document = read_document(path)
    errors = {}
    for name, text in document.defaults.items():
        if not name.endswith(RULER_ERROR):
            continue
        if name not in document.errors:
            raise SceneError(
                f"scene '{path}' declares '{name}', but no '{name.removesuffix(RULER_ERROR)}' that "
                "it were the error of; correct its name"
            )
        error = _number(given.get(name, text))
        if error is None or error < 0:
            raise SceneError(
                f"scene '{path}': '{name}' is {given.get(name, text)}; give a standard deviation "
                f"in the unit of '{document.errors[name]}', or 0 where it stays"
            )
        errors[document.errors[name]] = error
    return errors


def free_parameters(
    path: Path, free: Free | None, given: Mapping[str, str], held: Collection[str] = ()
) -> dict[str, float]:
    """Return the names of the parameters that are free, each with its ruler's error.

    Those named have the error that is named with them, else the one that the scene declares, else
    an infinite one. If `free` is None, all are free whose error the scene declares, but for those
    in `held` and those of an error of 0. A SceneError says that an error is not positive.
    """
    declared = declared_errors(path, given)
    if free is None:
        return {name: e for name, e in declared.items() if e > 0 and name not in held}
    if isinstance(free, str):
        raise SceneError(f"free is the text '{free}'; give a list of names, such as ['{free}']")
    named = free if isinstance(free, Mapping) else dict.fromkeys(free)
    if len(named) < len(free):
        raise SceneError(
            f"parameter '{next(n for n in free if list(free).count(n) > 1)}' is free twice"
        )
    errors = {}
    for name, error in named.items():
        errors[name] = declared.get(name, np.inf) if error is None else float(error)
        if not errors[name] > 0:
            raise SceneError(f"ruler's error {errors[name]:g} of '{name}': give a positive number")
    return errors


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None
