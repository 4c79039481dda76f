"""A world: photographs without ambient light, ambient light, and methods fitted to both."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.hidden import Hidden
from periscopy_sim.measurement import add_noise, composite, composite_error
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, plain_array
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.reconstruction.method import Method
from periscopy_sim.scene import MONITOR
from periscopy_sim.storage.outputs.provenance import array_sha256, image_sha256


@dataclass(frozen=True, eq=False)
class World:
    """A laboratory whose photographs methods reconstruct.

    Attributes
    ----------
    signals
        Name of a hidden image to its `Photograph` without ambient light, or such an array, (rows,
        columns, channels), in any unit. One mask, the same for all, says where the wall is used:
        only there must photographs be finite, and only there count the SBR, the exposure and the
        noise; elsewhere a measurement is zero.
    truths
        Name to (R, C, channels) hidden image in [0, 1]; of several surfaces a mapping by id.
    backgrounds
        Name to `Photograph` or array of ambient light, like the signals, in any unit. Their masks
        exclude more pixels.
    methods
        Name to method; anything with ``reconstruct(photograph) -> (R, C, channels)`` that pickle
        takes. The package's methods are fitted to the photographs' conditions; a method of your own
        must have been fitted with the mask.
    transport
        How each method's A was made, by the method's name: `TransportPlan.origin`.
    draw
        A world that differs from others by chance, as by what a ruler reads, has noise of its own.
    measures
        Further numbers that some methods return by ``measures(photograph)``: long names and units.

    Raises
    ------
    PeriscopyError
        If something is missing, or shapes differ.
    """

    signals: Mapping[str, Any]
    truths: Mapping[str, Any]
    backgrounds: Mapping[str, Any]
    methods: Mapping[str, Method]
    transport: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    draw: int = 0
    measures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fit the methods to all of the photographs; reject what no sweep can have."""
        for name in ("signals", "truths", "backgrounds", "methods"):
            if not isinstance(given := getattr(self, name), Mapping):
                kind = type(given).__name__
                raise PeriscopyError(f"{name} of the sweep are of type {kind}: give a dictionary")
        for name, method in self.methods.items():
            if isinstance(method, type) or not callable(getattr(method, "reconstruct", None)):
                raise PeriscopyError(
                    f"method '{name}' is {method!r}: give an object with reconstruct(photograph), "
                    "such as ps.NoiseAware.for_scene(scene, A, B)"
                )
        if self.signals.keys() != self.truths.keys():
            raise PeriscopyError(
                f"photographs of {', '.join(self.signals)}, but hidden images "
                f"{', '.join(self.truths)}; give both of each"
            )
        for name in ("signals", "backgrounds", "methods"):
            if not getattr(self, name):
                raise PeriscopyError(f"{name} of the sweep: give at least one")
        for image in self.truths:
            for surface, truth in self.truth(image).items():
                plain_array(truth, f"the hidden image '{image}' of '{surface}'")
        given = {**self.signals, **{f"ambient {n}": b for n, b in self.backgrounds.items()}}
        photographs = of_one_wall([*given.values()], names=given)
        signals, ambient = photographs[: len(self.signals)], photographs[len(self.signals) :]
        first = signals[0]
        own = [each for each in self.methods.values() if not hasattr(each, "fitted_to")]
        if own and (first.monitor_off or first.colour_matrix is not None):
            raise PeriscopyError(
                "the sweep's photographs have some with the monitor off, or a colour matrix; leave "
                "these out, and fit your own methods with them"
            )
        for name, each in zip(given, photographs, strict=True):
            if each.values.shape != first.values.shape or not each.used.sum() > 0:
                raise PeriscopyError(
                    f"'{name}': give finite values of shape {first.values.shape} and positive mean"
                )
        vars(self).update(  # the fields are frozen
            signals=dict(zip(self.signals, signals, strict=True)),
            backgrounds=dict(zip(self.backgrounds, ambient, strict=True)),
            methods={
                name: each.fitted_to(first) if hasattr(each, "fitted_to") else each
                for name, each in self.methods.items()
            },
        )

    @property
    def wall(self) -> Photograph:
        """The first photograph without ambient light, with the conditions of all."""
        first: Photograph = next(iter(self.signals.values()))
        return first

    @property
    def hidden(self) -> Hidden:
        """The hidden surfaces, by their sizes alone."""
        truth = self.truth(next(iter(self.truths)))
        return Hidden.of({name: each.shape[:2] for name, each in truth.items()})

    @property
    def channels(self) -> int:
        """Channels of the images, in the monitor's primaries."""
        matrix = self.wall.colour_matrix
        return self.wall.channels if matrix is None else int(matrix.matrix.shape[1])

    def truth(self, image: str) -> Mapping[str, Image]:
        """Return the hidden image of each surface, (R, C, channels), by its id."""
        truth = self.truths[image]
        return truth if isinstance(truth, Mapping) else {MONITOR: truth}

    def photograph(
        self, image: str, background: str, sbr: float, snr: float, seed: int, base: int = 0
    ) -> Array:
        """Return a measurement (Sec. 4.1), (rows, columns, channels), of mean 1, plus noise.

        It is zero where the wall is not used. Its noise follows from `base`, image, background,
        SBR, seed and `draw`: the same whatever else is swept, but for its strength.
        """
        signal, ambient = self.signals[image], self.backgrounds[background]
        exposed = composite(signal.used, ambient.used, sbr)
        labels = [base, image, background, float(sbr), int(seed), *filter(None, [self.draw])]
        entropy = int.from_bytes(hashlib.sha256(json.dumps(labels).encode()).digest()[:16])
        photograph = np.zeros(signal.values.shape)
        photograph[signal.pixels] = add_noise(exposed, snr, entropy)
        return photograph

    def own_error(self, image: str, background: str, sbr: float) -> float | None:
        """Return the own error of a `photograph` before noise, over its root mean square.

        None where nothing is known of it.
        """
        signal, ambient = self.signals[image], self.backgrounds[background]
        errors = signal.relative_error, ambient.relative_error
        if errors == (None, None):
            return None
        own = (each or 0.0 for each in errors)
        return composite_error(signal.used, ambient.used, sbr, *own)

    def scale(self, image: str, sbr: float) -> float:
        """Return what `photograph` multiplies a signal by."""
        return float(1 / (self.signals[image].used.mean() * (1 + 1 / sbr)))

    def __call__(self, snr: float, **values: Any) -> Self:  # noqa: ARG002  of all SNRs
        """Return the world, of a sweep that varies nothing in it."""
        if values:
            raise PeriscopyError(f"a world has no {', '.join(values)}; give what makes worlds")
        return self

    @property
    def axes(self) -> dict[str, list[str]]:
        """The names of methods, images and ambient light, by the names of a sweep's axes."""
        return {
            "algorithm": list(self.methods),
            "image": list(self.signals),
            "background": list(self.backgrounds),
        }

    @property
    def conditions(self) -> dict[str, Any]:
        """What all photographs depend on, of JSON's types; arrays by their digests."""
        off, mask, matrix = self.wall.monitor_off, self.wall.mask, self.wall.colour_matrix
        return {
            "monitor_off_sha256": {name: array_sha256(each) for name, each in off.items()},
            "mask_sha256": None if mask is None else array_sha256(mask),
            "colour_matrix": None if matrix is None else matrix.matrix.tolist(),
        }

    @property
    def conditions_of(self) -> dict[str, dict[str, Any]]:
        """The digests of what the photographs of one image or ambient light depend on."""
        return {
            "image": {
                name: {
                    "photograph": array_sha256(each.values),
                    "truth": image_sha256(self.truths[name]),
                }
                for name, each in self.signals.items()
            },
            "background": {n: array_sha256(each.values) for n, each in self.backgrounds.items()},
        }


TURNS = {"": (1, 1), " up-down": (-1, 1), " left-right": (1, -1), " both": (-1, -1)}
"""What the names of flipped backgrounds end in, with the step along rows and columns."""


def flipped_names(name: str, is_flipped: bool) -> list[str]:
    """Return the names of a background and of its flips, if there are any."""
    return [f"{name}{turn}" for turn in (TURNS if is_flipped else [""])]


def flips(backgrounds: Mapping[str, Image]) -> dict[str, Image]:
    """Flip each background about each axis and about both: four times as many (Sec. 4.1).

    They are (rows, columns, channels) each, by name. Return each under its own name, then with
    the endings of `TURNS`.
    """
    if not isinstance(backgrounds, Mapping):
        raise InputError("flips: give backgrounds by name, such as {'overcast': array}")
    return {
        f"{name}{turn}": image[::down, ::right]
        for name, image in backgrounds.items()
        for turn, (down, right) in TURNS.items()
    }
