"""The world: a scene file's shapes and lights, and how its parameters move them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.numerics import Array

MONITOR, HIDDEN = "monitor", "hidden"
"""Id of a scene file's hidden surface, and how the ids of others begin."""

WALL, CAMERA = "wall", "camera"
"""How the ids of relay walls begin, and the id of the sensor that photographs by default."""

RULER_ERROR = "_error"
"""Ends the name of a ``<default>`` that says how well the one before that ending is known."""

CALIBRATED = "calibrated_covariance"
"""Names the ``<default>`` in which a calibration says how well it knows the parameters."""


@dataclass(frozen=True)
class EmissionProfile:
    """Angular emission of an LCD: radiance relative to the normal's, after [15].

    The exponents are those of the cosines of the vertical and the horizontal angle; 0 and 0 is
    Lambertian.
    """

    vertical: float = 0.0
    horizontal: float = 0.0

    def __call__(self, across: Array, up: Array, normal: Array) -> Array:
        """Evaluate the profile for directions given by their components along the monitor's axes.

        They are broadcastable, of any positive scale; the result is 1 along the normal, 0 behind
        the monitor.
        """
        lit = normal > 0
        ahead = np.where(lit, normal, 1.0)
        cos_vertical = ahead / np.hypot(ahead, up)
        cos_horizontal = ahead / np.hypot(ahead, across)
        return np.where(lit, cos_vertical**self.vertical * cos_horizontal**self.horizontal, 0.0)


@dataclass(frozen=True, eq=False)
class Occluder:
    """A shape that may block light; `name` is its id in the scene file.

    A triangle mesh has `vertices`, (V, 3) positions in metres, and `faces`, (F, 3) vertex indices;
    a cylinder or a disk has those of a fine polygon; any other shape has None for both. `bounds`,
    (2, 3), are the lower and the upper corner of the box about it, where they are known.
    """

    name: str
    vertices: Array | None
    faces: NDArray[np.int64] | None
    bounds: Array | None = None


@dataclass(frozen=True)
class SceneDocument:
    """What a scene file and those that it includes declare, and the values given instead.

    `defaults` maps the name of each ``<default>`` to its value, the first of that name, whatever
    was `given`. `files` are the scene and every file that exists and belongs to it, each once, in
    the order of the text.
    """

    path: Path
    given: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, str] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    folders: tuple[Path, ...] = ()  # where the files of plugins are searched, in this order
    missing: tuple[str, ...] = ()  # names of includes, spectra and folders that are nowhere
    units: Mapping[str, str] = field(default_factory=dict)
    """m or degrees, of the ``<default>``s that move or turn something"""

    @property
    def values(self) -> dict[str, str]:
        """The values in force: those given, else the defaults."""
        return {**self.defaults, **self.given}

    @property
    def errors(self) -> dict[str, str]:
        """The ``<default>``s that are standard errors, each with the one that it is of."""
        ends = {name: name.removesuffix(RULER_ERROR) for name in self.defaults}
        return {name: of for name, of in ends.items() if of != name and of in self.defaults}

    def undeclared(self, name: str) -> SceneError:
        """Return the error of a parameter that is not declared, with what may be meant."""
        known = [each for each in self.defaults if each != CALIBRATED and each not in self.errors]
        meant = did_you_mean(name, self.defaults) or f"it declares {', '.join(known) or 'none'}"
        return SceneError(f"scene '{self.path}' declares no parameter '{name}'; {meant}")


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene file at some values of its parameters, loaded once; it knows no pixels or patches.

    Attributes
    ----------
    document
        The Mitsuba scene file: its place, what it declares, and values given for that.
    places
        Matrices, (4, 4), from the coordinates of each shape and sensor to the scene's, by id.
    plugins
        Mitsuba's kind of each of these, such as ``rectangle``; by id.
    boxes
        (8, 3) corners of a box about each shape, by id.
    occluders
        Every shape but the relay walls and the hidden surfaces.
    surfaces
        The shapes of the hidden surfaces, which hide each other.
    transparent
        Ids of those that hide nothing: light passes their BSDF, which is ``null``.
    emission
        Angular profile of each hidden surface where a closed form is known, else None; by id.
    lights
        Names of the emitters beside the hidden surfaces, whose light is not in A.
    reflecting
        The hidden surfaces without an emitter, whose images are radiance that they reflect, by id
        the names of their materials.
    walls
        The shapes of the relay walls: all but the one that a camera sees are occluders to it.
    source
        What loaded the scene: it traces the rays of views, and loads the scene at other values.
    motions
        Matrices, (4, 4), of the shapes and sensors that have moved since the source loaded them;
        by id.
    """

    document: SceneDocument = field(repr=False)
    places: Mapping[str, Array] = field(repr=False)
    plugins: Mapping[str, str] = field(repr=False)
    boxes: Mapping[str, Array] = field(repr=False)
    occluders: tuple[Occluder, ...] = field(repr=False)
    surfaces: tuple[Occluder, ...] = field(repr=False)
    emission: Mapping[str, EmissionProfile | None]
    lights: tuple[str, ...] = ()
    reflecting: Mapping[str, str] = field(default_factory=dict)
    transparent: tuple[str, ...] = ()
    walls: tuple[Occluder, ...] = field(default=(), repr=False)
    source: Any = field(default=None, repr=False)
    motions: Mapping[str, Array] = field(default_factory=dict, repr=False)

    @property
    def path(self) -> Path:
        """The Mitsuba scene file."""
        return self.document.path

    @property
    def parameters(self) -> Mapping[str, str]:
        """Values given for the file's ``<default>``s."""
        return self.document.given

    def at(self, **values: str | float) -> "Scene":
        """Return the same scene with other values for its file's ``<default>``s.

        Values that are not named stay. Where they move, turn or stretch cameras, hidden surfaces,
        meshes or plain rectangular walls, these move in a few milliseconds, without rays; anything
        else loads the file anew.

        Raises
        ------
        SceneError
            If the file declares no such parameter, or there is no such scene, see `load_scenario`.
        """
        if self.source is None:
            raise ValueError("this scene was made of arrays; only a file has parameters")
        given = {name: str(value) for name, value in values.items()}
        scene: Scene = self.source.at(self, {**self.parameters, **given})
        return scene

    def has_same_places(self, names: Iterable[str], other: "Scene") -> bool:
        """Return whether shapes and sensors have the same places in another scene, by their ids."""
        return all(np.array_equal(self.places[name], other.places[name]) for name in names)

    def without(self, name: str) -> "Scene":
        """Return the scene without one of its occluders, for closed forms: `at` brings it back."""
        return replace(self, occluders=tuple(o for o in self.occluders if o.name != name))


def is_hidden(name: str) -> bool:
    """Return whether the id of a shape makes it a hidden surface."""
    return name == MONITOR or name.startswith(HIDDEN)


def corners(bounds: Array) -> Array:
    """Return the corners, (8, 3), of a box given by its lower and its upper corner, (2, 3)."""
    return np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
