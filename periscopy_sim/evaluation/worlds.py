"""The worlds of a sweep: a map over `Scenario.at`, whose memo keeps what several have in common.

A world's methods may calibrate their scene by each photograph before they reconstruct it.
"""

import hashlib
import json
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from periscopy_sim.calibration.prior import free_parameters, read_by_ruler, start_values
from periscopy_sim.calibration.result import Calibration
from periscopy_sim.errors import PeriscopyError, SceneError, did_you_mean
from periscopy_sim.evaluation.sweep import LIGHT, Unfitted, World, flipped_names, flips
from periscopy_sim.hidden import Hidden
from periscopy_sim.judgement import check_memory
from periscopy_sim.light import Light
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.memo import Memo
from periscopy_sim.methods import Name, OwnAxis, entry_of, without_addresses
from periscopy_sim.numerics import Array, Image, Mask, validation
from periscopy_sim.numerics.machine import Stage, silent
from periscopy_sim.photograph import Photograph, seen_in
from periscopy_sim.reconstruction.method import Method
from periscopy_sim.reconstruction.registry import RAYS, Option
from periscopy_sim.rendering.ambient import Background
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import Scenario, load_scenario
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.provenance import array_sha256, as_text, provenance
from periscopy_sim.storage.rasters import write_exr

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Note

_SHARE = {"units": "1", "valid_range": [0, 1]}
MEASURES = {
    "trusted": {
        "long_name": "whether nothing speaks against the calibration: 1, else 0", **_SHARE
    },
    "within_1": {
        "long_name": "share of calibrated numbers within a standard error of the true ones",
        **_SHARE,
    },
    "within_3": {
        "long_name": "share of calibrated numbers within three standard errors of the true ones",
        **_SHARE,
    },
}  # fmt: skip
"""What a sweep measures of calibrations, beside each number."""


def measures_of(units: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return `MEASURES`, then each number's error and its claimed one, in the number's unit."""
    each = {
        f"{of}.{name}": {"long_name": f"{words} of {name}", "units": unit}
        for name, unit in units.items()
        for of, words in (("error", "calibrated minus true value"), ("claimed", "standard error"))
    }
    return {**MEASURES, **each}


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A method whose scene is calibrated by the photograph that it reconstructs.

    Attributes
    ----------
    scenario
        The scene by the ruler; its memo keeps a calibration for all methods.
    truth
        The true values of the numbers that declare an error, by name.
    wall
        The conditions of the photographs.
    fit
        Returns the method, fitted to a calibrated scenario.
    """

    scenario: Scenario
    truth: Mapping[str, float]
    wall: Photograph
    fit: Callable[[Scenario], Method]

    def fitted_to(self, photograph: Photograph) -> Self:
        """Return this: it knows the photographs' conditions."""
        del photograph
        return self

    def calibration(self, values: Image) -> Calibration:
        """Calibrate by a photograph, (rows, columns, channels)."""
        wall = replace(self.wall, values=np.asarray(values, np.float64))
        key = "calibration", self.scenario.digest, array_sha256(wall.values), wall.conditions
        make = partial(self.scenario.calibrate, wall, seed=0)
        return self.scenario.memo.get(key, make, 16 * self.scenario.view.points.nbytes)

    def reconstruct(self, photograph: Image) -> Any:
        """Recover the hidden image, (R, C, channels), by the method that `fitted_by` returns.

        Of several surfaces it is a mapping by id.
        """
        return self.fitted_by(photograph).reconstruct(photograph)

    def fitted_by(self, photograph: Image) -> Method:
        """Calibrate by a photograph, and return the method fitted to the calibrated scene.

        A PhotographError or a SceneError says that this photograph determines no number.
        """
        calibrated = self.calibration(photograph).scenario
        return self.fit(replace(calibrated, light=self.scenario.light))

    def measures(self, photograph: Image) -> dict[str, float]:
        """Return the measures of the calibration by a photograph, see `measures_of`."""
        found = self.calibration(photograph)
        errors = {p.name: p.value - self.truth[p.name] for p in found.parameters}
        claimed = {p.name: float(p.standard_error) for p in found.parameters}
        off = [abs(errors[name]) / claimed[name] for name in errors]
        within = {f"within_{k}": float(np.mean(np.less(off, k))) for k in (1, 3)}
        each = {"error": errors, "claimed": claimed}
        numbers = {f"{of}.{n}": v for of, values in each.items() for n, v in values.items()}
        return {"trusted": float(found.trusted), **within, **numbers}


KNOWN = "assumed"
ASSUMED = f"{KNOWN}."
"""Before the name of a <default>: of the scene that methods are fitted to, not the true one."""

DRAW = "ruler"
TRUE, RULER, CALIBRATED = "true", "ruler", "calibrated"
"""What methods know of the numbers that declare an error: the true ones, those that a ruler reads,
or what a calibration by each photograph makes of these."""

OF_RESULTS = "algorithm", *LIGHT, "row", "column", "channel"
OF_LIGHT = "samples", "model"
OF_SCENE = "scene", "hidden"
"""Dimensions of results, and axes beside the scene's <default>s: of A, of the whole scene."""


def warn_of(notes: "Sequence[Note | str]") -> None:
    """Warn of notes on a scene, or of lines."""
    for each in notes:
        warnings.warn(str(each), RuntimeWarning, stacklevel=3)


@dataclass(frozen=True, eq=False)
class Worlds:
    """Makes the world of an SNR and of values of some axes.

    Of `conditions` and `conditions_of` see `World`; methods, images and ambient light have the same
    names in all worlds.
    """

    scenario: Scenario  # where no axis changes it
    shown: Mapping[str, Any]  # hidden images by name: pictures' names, see `Scenario.image`
    photographs: Mapping[str, Photograph]  # those given, by the same names; others are rendered
    ambient: Mapping[str, Any]  # arrays, or conditions by name, which are path traced
    flips: bool  # whether each ambient light is also flipped about each axis
    methods: Mapping[str, Name]  # by what the sweep calls them
    conditions: Mapping[str, Any]
    conditions_of: Mapping[str, Mapping[str, Any]]
    mask: Mask | None = None
    monitor_off: Mapping[str, Array] = field(default_factory=dict)
    own_axes: Mapping[str, OwnAxis] = field(default_factory=dict)  # by their labels
    calibrates: bool = False  # whether an axis says what methods know, so that they may calibrate
    out: Path | None = None  # gets rendered photographs as EXR files
    command: Sequence[str] = ()  # for their metadata
    progress: Stage = silent
    noted: "Callable[[Sequence[Note | str]], None]" = warn_of  # of scenes
    _scenarios: Memo = field(default_factory=Memo, init=False)
    _written: set[Path] = field(default_factory=set, init=False)

    @property
    def axes(self) -> dict[str, list[str]]:
        """The names of methods, images and ambient light, by the names of a sweep's axes."""
        lights = [name for light in self.ambient for name in flipped_names(light, self.flips)]
        return {"algorithm": [*self.methods], "image": [*self.shown], "background": lights}

    @property
    def hidden(self) -> Hidden:
        """The hidden surfaces of the scenario."""
        return self.scenario.hidden

    @property
    def channels(self) -> int:
        """Channels of the images: those of the photographs given, else three."""
        return next((each.channels for each in self.photographs.values()), 3)

    def __call__(self, snr: float, **values: Any) -> World:
        """Return the world of an SNR and of values of some axes."""
        self.noted(self.at(values).check(""))
        return self.world(snr, values)

    def world(
        self, snr: float, values: Mapping[str, Any], lights: Mapping[str, Background] | None = None
    ) -> World:
        """Return the world, in its own light or another; its methods are fitted first."""
        true, signals = self.at(values), {n: self.signal(n, snr, values) for n in self.shown}
        wall, calibrates = next(iter(signals.values())), values.get(KNOWN) == CALIBRATED
        fit = self._calibrated if calibrates else self.fitted
        fitted = fit(snr, values, wall)
        if lights is None:
            lights = {name: self._light(true, name) for name in self.ambient}
        backgrounds = dict[str, Photograph]()
        for name, light in lights.items():
            seen = {name: seen_in(light.photograph, wall.channels)}
            for turned, image in (flips(seen) if self.flips else seen).items():
                picture, error = np.asarray(image, np.float64), light.relative_error or None
                backgrounds[turned] = Photograph(picture, relative_error=error)
        return World(
            signals=signals,
            truths={name: true.image(names) for name, names in self.shown.items()},
            backgrounds=backgrounds,
            methods=fitted,
            transport={n: each.plan.origin for n, each in fitted.items() if hasattr(each, "plan")},
            draw=int(values.get(DRAW, 0)),
            measures=self.measures,
            response=self.response(values),
        )

    def response(self, values: Mapping[str, Any]) -> "Callable[[Image], Image] | None":
        """Return what the camera makes of photographs, by the axes of the user's own."""
        steps = [partial(self.own_axes[n], v) for n, v in values.items() if n in self.own_axes]
        return partial(reduce, lambda y, step: step(y), steps) if steps else None

    @property
    def traced(self) -> list[str]:
        """The conditions of ambient light that is path traced."""
        return [str(light) for light in self.ambient.values() if validation.is_name(light)]

    def _light(self, true: Scenario, name: str) -> Background:
        """Return ambient light on the wall, path traced unless it is given."""
        light = self.ambient[name]
        if validation.is_name(light):
            return true.ambient(light, progress=self.progress)
        return Background(light, 0.0, 0.0)

    def signal(self, name: str, snr: float, values: Mapping[str, Any]) -> Photograph:
        """Return the photograph of a hidden image: given, or rendered as fine as an SNR needs.

        A cell has the same photograph in whichever run it is computed.
        """
        if name in self.photographs:
            return self.photographs[name]
        true = self.at(values)
        own, bounces = replace(true, seed=_seed_of(true, name)), true.light.bounces
        with self.progress(f"photograph: {name}") as done:
            picture = true.image(self.shown[name])
            light = own.rendered(picture, snr=snr, bounces=bounces, progress=done)
        if self.out is not None:
            places = filter(None, [self.place(values)])
            file = self.out.joinpath(*places, f"photograph_{name}_{snr:.9g}dB.exr")
            if file not in self._written:
                made: dict[str, Any] = {"camera": true.view.camera, "image": name}
                made |= {"bounces": bounces, **provenance(true.document, true.seed, self.command)}
                numbers = {"relative_error": light.relative_error, "made_for_snr": snr}
                write_exr(file, light.photograph, {**as_text(made), **numbers})
                self._written.add(file)
        y = Photograph.of(light.photograph, mask=self.mask, monitor_off=self.monitor_off)
        return replace(y, relative_error=light.relative_error)

    def fitted(self, snr: float, values: Mapping[str, Any], wall: Photograph) -> dict[str, Any]:
        """Return the methods, each fitted to an A as fine as an SNR needs, whatever the SBR.

        A cell has the same A in whichever run it is computed.
        """
        scenario, methods = self.assumed(values), dict[str, Any]()
        for name, fit in self._fits(snr, values, wall).items():
            with self.progress(f"fitting {name}") as done:
                scenario.transport(noise_to_signal(snr, np.inf), self.methods[name], progress=done)
                methods[name] = fit(scenario)
        return methods

    def _calibrated(
        self, snr: float, values: Mapping[str, Any], wall: Photograph
    ) -> dict[str, Any]:
        """Return the methods, each of which calibrates the ruler's scene by the photograph."""
        document, ruler = self.at(values).document, self.assumed(values)
        names = tuple(free_parameters(document))
        truth = dict(zip(names, start_values(document, names).tolist(), strict=True))
        fits = self._fits(snr, values, wall).items()
        return {name: Calibrated(ruler, truth, wall, fit) for name, fit in fits}

    def _fits(
        self, snr: float, values: Mapping[str, Any], wall: Photograph
    ) -> "dict[str, Callable[[Scenario], Method]]":
        """Return what fits each method to a scene; true values have no errors."""
        errors: dict[str, float] | None = {} if _is_known(values) else None

        def options(own: str) -> dict[str, float]:
            return {n.removeprefix(own): v for n, v in values.items() if n.startswith(own)}

        return {
            name: partial(
                _fit, method, wall, noise_to_signal(snr, np.inf), errors, options(f"{name}.")
            )
            for name, method in self.methods.items()
        }

    def matrices(self, values: Mapping[str, Any], snr: float) -> set[Any]:
        """Return what tells apart the matrices of the methods, of which none calibrates.

        An A of a given number of rays serves any SNR.
        """
        if values.get(KNOWN) == CALIBRATED:
            return set()
        light, entries = self.light(values), map(entry_of, self.methods.values())
        by_rays = {light.by is None and entry is not None and entry.rays for entry in entries}
        counts = {light.samples or (RAYS if each else None) for each in by_rays}
        place = self.place(values, ASSUMED)
        return {(place, light.by, count, None if count else snr) for count in counts}

    def check(self, axes: Mapping[str, Sequence[Any]]) -> None:
        """Reject axes that no world knows, and values that they cannot have.

        A PeriscopyError names the axis, with the one that was perhaps meant.
        """
        document = self.scenario.document
        paths = [find_scene(str(scene)) for scene in axes.get("scene", ())]
        if len({path.stem for path in paths}) < len(paths):
            names = ",".join(map(str, paths))
            raise PeriscopyError(f"vary scene={names}: two scenes have one name; rename one")
        declared = [document, *map(read_document, paths)]
        errors_of = {error for each in declared for error in each.errors}
        common = set.intersection(*({*each.defaults} for each in declared)) - errors_of
        numbers = [name for name in document.defaults if name in common]
        entries = {name: entry_of(method) for name, method in self.methods.items()}
        own = {name: entry.options for name, entry in entries.items() if entry is not None}
        options = {f"{n}.{each.name}": each for n, offered in own.items() for each in offered}
        is_known = not {*axes.get(KNOWN, ())} - {TRUE}
        if is_known and DRAW in axes:
            raise PeriscopyError(f"vary {DRAW}: also vary {KNOWN}={TRUE},{RULER},{CALIBRATED}")
        errors = () if is_known else document.errors.values()
        assumed = [ASSUMED + name for name in numbers if name not in errors]
        known = ["sbr", "snr", KNOWN, DRAW, *OF_SCENE, *OF_LIGHT, *numbers, *assumed, *options]
        if taken := self.own_axes.keys() & {*known, *OF_RESULTS}:
            raise PeriscopyError(f"vary {min(taken)}: the sweep has such an axis; rename yours")
        known += self.own_axes
        if self.scenario.light.matrix is not None and (of_A := axes.keys() - options):
            raise PeriscopyError(
                f"vary {', '.join(sorted(of_A))}: A of your own is of one scene; leave out "
                "Light.matrix"
            )
        for axis, values in axes.items():
            if axis not in known:
                guess = did_you_mean(axis, known) or f"there are {', '.join(known)}"
                raise PeriscopyError(f"vary {axis}: no such axis; {guess}")
            if self.photographs and axis in (*numbers, "scene"):
                raise PeriscopyError(
                    f"vary {axis}: a photograph is of one scene; give hidden images alone, or vary "
                    f"{ASSUMED}NAME"
                )
            words = [each for each in values if not np.isfinite(validation.number_of(str(each)))]
            unit = document.units.get(axis.removeprefix(ASSUMED), "")
            for value in words or values:
                if axis not in self.own_axes:
                    _check_value(axis, value, options.get(axis), unit)
            if axis in (KNOWN, *OF_SCENE, *numbers, *assumed):
                self._check_scene(axis, values[0])
                self._check_scene(axis, values[-1])
        if sizes := [*map(str, axes.get("hidden", ()))]:  # before hours of rendering others
            largest = max(sizes, key=lambda size: int(np.prod(validation.size_of(size))))
            for method in self.methods.values():
                check_memory(self.at({"hidden": largest}), method)

    def _check_scene(self, axis: str, value: Any) -> None:
        """Load the true and the assumed scene; reject what no sweep can compare."""
        try:
            true, assumed = (self.at({axis: value}, of) for of in ("", ASSUMED))
        except SceneError as error:
            raise SceneError(f"vary {axis}={value}: {error}") from error
        if [*true.hidden] != [*self.hidden]:
            raise PeriscopyError(
                f"vary {axis}={value}: its hidden surfaces are {', '.join(true.hidden)}, not "
                f"{', '.join(self.hidden)}; give scenes whose surfaces have the same ids"
            )
        if assumed.photograph_shape != true.photograph_shape:
            raise PeriscopyError(
                f"vary {axis}={value}: the scene has photographs of {true.photograph_shape} "
                f"pixels, the assumed one of {assumed.photograph_shape}; leave the film as it is"
            )

    @property
    def measures(self) -> Mapping[str, Mapping[str, Any]]:
        """What calibrations say of themselves, if the sweep has some."""
        if not self.calibrates:
            return {}
        own = self.scenario.document
        scenes = self.conditions_of.get("scene", ())
        others = (read_document(find_scene(name)) for name in scenes)
        units = {n: d.units.get(n, "1") for d in (own, *others) for n in free_parameters(d)}
        return measures_of(units)

    def units(self, axes: Collection[str]) -> dict[str, str]:
        """Return the units of axes, of those that have some."""
        units = self.scenario.document.units
        of = {axis: units.get(axis.removeprefix(ASSUMED)) for axis in axes}
        return {axis: unit for axis, unit in of.items() if unit}

    def assumed(self, values: Mapping[str, Any]) -> Scenario:
        """Return the scenario that methods are fitted to, with the light that is modelled."""
        return replace(self.at(values, ASSUMED), light=self.light(values))

    def at(self, values: Mapping[str, Any], of: str = "") -> Scenario:
        """Return the true scenario at values of axes, or the ``assumed.`` one."""
        base, numbers = self.scenario, self.scenario.document.defaults
        defined = {n: v for n, v in values.items() if n in numbers}
        defined |= {n.removeprefix(of): v for n, v in values.items() if of and n.startswith(of)}
        if of and not _is_known(values):
            draw = [base.seed, 1 + int(values.get(DRAW, 0))]  # not the stream of the seed alone
            defined |= read_by_ruler(self.at(values), draw)
        whole = {n: values[n] for n in OF_SCENE if n in values}
        texts = {n: f"{value:.9g}" for n, value in defined.items()}

        def make() -> Scenario:
            if not whole:
                return base.at(**texts) if texts else base
            (surface, size), *others = base.hidden.shapes.items()
            sizes = {surface: validation.size_of(str(whole["hidden"]))} if "hidden" in whole else {}
            made = load_scenario(
                whole.get("scene", base.path), {surface: size, **dict(others), **sizes},
                {**base.parameters, **texts}, camera=base.view.camera, light=base.light,
                seed=base.seed,
            )  # fmt: skip
            return replace(made, memo=base.memo)

        key = (*texts.items(), *whole.items())
        return self._scenarios.get(key, make, 8 * base.view.points.nbytes)

    def place(self, values: Mapping[str, Any], of: str = "") -> str:
        """Return the name of the true scene, or of the ``assumed.`` one, at values of axes."""
        names = *self.scenario.document.defaults, *OF_SCENE
        own = {n: v for n, v in values.items() if n in names or (of and n.startswith(of))}
        if of and not _is_known(values):
            own[DRAW] = values.get(DRAW, 0.0)
        texts = {n: f"{v:.9g}" if isinstance(v, float) else Path(v).stem for n, v in own.items()}
        return ",".join(f"{name}={text}" for name, text in texts.items())

    def light(self, values: Mapping[str, Any]) -> Light:
        """Return the light that is modelled at values of axes."""
        light = self.scenario.light
        by = validation.WAYS[values["model"]] if "model" in values else light.by
        return replace(light, by=by, samples=int(values.get("samples", 0)) or light.samples)


def _fit(
    method: Name,
    wall: Photograph,
    noise: float,
    errors: Mapping[str, float] | None,
    settings: Mapping[str, float],
    scenario: Scenario,
) -> "Method":
    """Fit a method to a scene, of which some errors are known; `Unfitted` if that fails."""
    try:
        return scenario.method(method, wall, noise=noise, errors=errors, **settings)
    except PeriscopyError as error:
        return Unfitted(without_addresses(str(error)))


def _seed_of(scenario: Scenario, name: str) -> int:
    """Return the seed of a photograph: each image at each place of a scene has its own rays."""
    labels = [scenario.seed, name, *sorted(scenario.parameters.items())]
    digest = hashlib.sha256(json.dumps(labels).encode()).digest()
    return int.from_bytes(digest[:4])


def _is_known(values: Mapping[str, Any]) -> bool:
    """Return whether methods know the true scene, at values of axes."""
    return bool(values.get(KNOWN, TRUE) == TRUE)


def _check_value(axis: str, value: Any, option: Option | None, unit: str) -> None:
    """Raise a PeriscopyError for a value that an axis cannot have."""
    words: dict[str, Sequence[str]] = {
        KNOWN: (TRUE, RULER, CALIBRATED),
        "model": [*validation.WAYS],
    }
    kind, name = {DRAW: "seed", "samples": "rays"}.get(axis), f"vary {axis}="
    if axis in words and value not in words[axis]:
        raise PeriscopyError(f"{name}{value}: there are {', '.join(words[axis])}")
    if axis not in (*words, *OF_SCENE) and not isinstance(value, float):
        form = f"numbers in {unit}" if unit else "numbers"
        raise PeriscopyError(f"{name}{value}: write {form} without units, or 0:1:5")
    if kind is not None:
        validation.checked(name, value, kind)
    if option is not None:
        option.checked(value, name)
