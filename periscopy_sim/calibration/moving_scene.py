"""A scene whose parameters move: its A by areas, A's derivatives, and what errors do to light."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from periscopy_sim.analytic.area_transport import (
    Outlines,
    area_derivatives,
    area_transport,
    has_areas,
    ways_to,
)
from periscopy_sim.calibration import prior
from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.reconstruction.method import Note
from periscopy_sim.view import Geometry, View

Matrix = NDArray[np.float32]

STEP = 0.02
"""Fraction of a parameter's standard error by which the scene moves for a derivative: far enough
for single precision, and so short that vertices move in proportion."""

LARGEST = 126
"""Most rows and columns of a photograph for which derivatives are computed, where light of larger
ones is interpolated; a search uses half as many more at most."""

LARGEST_CLIPPED = 63
"""The same for derivatives of an A that faces clip: those of a doorway take 4 s instead of 17."""

KEPT = 4
"""Matrices of a moving scene that are kept: two descents' ends and what was tried last."""

MOST_BYTES = 400_000_000
"""Memory of the derivatives of A that are held at once: less takes more time, for each band moves
the scene anew."""


@dataclass(frozen=True, eq=False)
class MovingScene:
    """A scene, P of whose parameters vary, seen by M of its camera's pixels.

    The last 3 S of P + 3 S values place each of the S hidden surfaces within itself, see
    `Surface.placed`.
    """

    scenario: Geometry  # as loaded, with the pixels used
    names: tuple[str, ...]  # of the P parameters
    errors: Array  # (P,) or (P + 3 S,) scales: a derivative moves a value by a fraction of its own
    logarithmic: tuple[str, ...] = ()  # parameters whose values are logarithms
    _kept: dict[bytes, Matrix] = field(default_factory=dict, init=False, repr=False)  # A by values

    @property
    def pixels(self) -> Mask:
        """(rows, columns) which pixels of the photograph are used."""
        view = self.scenario.view
        return np.ones(view.shape, bool) if view.pixels is None else view.pixels

    @property
    def across(self) -> int:
        """Points along each side of a pixel, over which light is averaged."""
        return self.scenario.view.across

    def at(self, values: Array) -> Geometry:
        """Return the scene at some values, (P,).

        A SceneError says that the values make no scene.
        """
        count = len(self.names)
        moved = self.scenario.at(**plain_values(self.names, values[:count], self.logarithmic))
        places = values[count:].reshape(-1, 3)
        if not len(places):
            return moved
        pairs = zip(moved.hidden.items(), places, strict=True)
        return Geometry(moved.view, Hidden({n: each.placed(*place) for (n, each), place in pairs}))

    def is_physical(self, values: Array) -> bool:
        """Return whether some values make a scene."""
        try:
            self.at(values)
        except SceneError:
            return False
        return True

    def transport(self, values: Array) -> Matrix:
        """Return A, (M, N); a SceneError says that the values make no scene with a closed form.

        The last few are kept: the same scene is compared by several kinds of images.
        """
        key = values.tobytes()
        if key not in self._kept:
            A = area_transport(self.at(values))
            while len(self._kept) >= KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = A
        return self._kept[key]

    def linearized(self, values: Array) -> tuple[Matrix, Matrix]:
        """Return A, (M, N), and its derivatives by the parameters, (P, M, N)."""
        scenario = self.at(values)
        return area_derivatives(scenario, [self._beside(values, k) for k in range(len(values))])

    def _beside(self, values: Array, k: int) -> tuple[Geometry, float]:
        """Return the scene with a parameter moved a little to either side, and how far."""
        for step in (STEP * self.errors[k], -STEP * self.errors[k]):
            moved = values.copy()
            moved[k] += step
            try:
                beside = self.at(moved)
                ways_to(beside)
                return beside, step
            except SceneError as error:
                unphysical = error
        raise unphysical


def plain_values(
    names: Sequence[str], values: Array, logarithmic: Sequence[str]
) -> dict[str, float]:
    """Return parameters' values by name, those that are logarithms as the scene has them."""
    pairs = zip(names, values.tolist(), strict=True)
    return {name: float(np.exp(v)) if name in logarithmic else v for name, v in pairs}


def limit_size(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (rows, columns) shrunk in proportion, the longer to at most `longest`."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns


def limit_sizes(hidden: Hidden, longest: int) -> dict[str, Size]:
    """Return the (rows, columns) of each hidden surface, each shrunk as by `limit_size`."""
    return {name: limit_size(shape, longest) for name, shape in hidden.shapes.items()}


def uncertain_transport(
    scenario: Geometry, errors: Mapping[str, float] | prior.SceneCovariance
) -> UncertainTransport:
    """Return how errors of a scene's parameters change the light of images, for `NoiseAware`.

    Parameters
    ----------
    scenario
        The scene at its measured values. It has a closed form, see `area_transport`.
    errors
        Standard errors of ``<default>``s, independent of each other, by name; or the covariance
        that a calibration wrote.

    Returns
    -------
    UncertainTransport
        For ``NoiseAware.for_scene(scenario, A, B, uncertain=...)``.
    """
    if isinstance(errors, prior.SceneCovariance):
        names, values, directions = errors.names, errors.values, errors.directions
    else:
        names = tuple(errors)
        values = prior.start_values(scenario.document, names)
        for name, error in errors.items():
            prior.check_error(name, error)
        directions = np.diag(list(errors.values()))
    by_outlines = all(isinstance(way, Outlines) for way in ways_to(scenario).values())
    shape, largest = scenario.photograph_shape, LARGEST if by_outlines else LARGEST_CLIPPED
    coarse = limit_size(shape, max(largest, *map(max, scenario.hidden.shapes.values())))
    deviations = np.sqrt(np.sum(directions**2, axis=1))
    view = View.of(scenario.scene, coarse, camera=scenario.view.camera)
    size = 4 * len(names) * coarse[0] * coarse[1] * scenario.hidden.patches
    bands = np.array_split(np.arange(coarse[0]), min(coarse[0], -(-size // MOST_BYTES)))

    def slopes(image: Image | Mapping[str, Image]) -> NDArray[np.float32]:
        f, parts = scenario.hidden.vector(image).astype(np.float32), []
        for band in bands:
            pixels = np.zeros(coarse, bool)
            pixels[band] = True
            part = Geometry(view.of_pixels(pixels), scenario.hidden)
            parts.append(MovingScene(part, names, deviations).linearized(values)[1] @ f)
        light = np.concatenate(parts, axis=1).reshape(len(names), *coarse, -1)
        finer = 1, *np.divide(shape, coarse), 1
        smooth = ndimage.zoom(light, finer, order=1, mode="nearest", grid_mode=True)
        return np.asarray(smooth.reshape(len(names), np.prod(shape), -1))

    return UncertainTransport(names, directions, slopes)


def scene_uncertainty(scenario: Geometry) -> tuple[UncertainTransport | None, list[Note]]:
    """Return what the errors that a scene states do to light, for `NoiseAware`, and notes on them.

    They are its calibration's, else the declared ones. None: it states none, calibrated values have
    changed since, or the scene has no closed form; a note says which of the latter two.
    """
    document, of = scenario.document, {"scene": scenario.path.name}
    known, notes = prior.scene_covariance(document), list[Note]()
    if known and (changed := ", ".join(known.changed(document))):
        return None, [*notes, Note("uncounted", {**of, "names": changed})]
    errors = known or prior.free_parameters(document)
    if not (known.names if known else errors):
        return None, notes
    if not has_areas(scenario):
        return None, [*notes, Note("no_derivatives", of)]
    return uncertain_transport(scenario, errors), notes
