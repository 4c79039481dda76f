"""The worlds of a sweep: what each needs is rendered once, and kept in its folder."""

import hashlib
import json
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from periscopy_sim.calibration.prior import free_parameters, read_by_ruler, start_values
from periscopy_sim.errors import PeriscopyError, SceneError, did_you_mean
from periscopy_sim.evaluation.calibrating import Calibrated, Calibrator, measures_of
from periscopy_sim.evaluation.world import World, flipped_names, flips
from periscopy_sim.hidden import Hidden
from periscopy_sim.judgement import check_memory
from periscopy_sim.memo import Memo
from periscopy_sim.methods import Name, entry_of
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.numerics.limits import RANGES, in_range, number_of, size_of
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.numerics.words import WAYS
from periscopy_sim.photograph import Photograph, seen_in
from periscopy_sim.reconstruction.registry import Option
from periscopy_sim.rendering.photograph import rendering_of
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.scenario import Light, Scenario, load_scenario
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.ambient_library import (
    Progress,
    ambient_photographs,
    missing_photographs,
    silent,
)
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.provenance import as_text, image_sha256, provenance
from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.photographs import read_photograph

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Method, Note
    from periscopy_sim.rendering.ambient.background import Background
    from periscopy_sim.rendering.transport.plan import TransportPlan

Given = ParamSpec("Given")
Made = TypeVar("Made")

KNOWN = "assumed"
ASSUMED = f"{KNOWN}."
"""Before the name of a <default>: of the scene that methods are fitted to, not the true one."""

DRAW = "ruler"
TRUE, RULER, CALIBRATED = "true", "ruler", "calibrated"
"""What methods know of the numbers that declare an error: the true ones, those that a ruler reads,
or what a calibration by each photograph makes of these."""

KEPT = 8
"""Scenes that are held in memory."""

OF_LIGHT = "samples", "model"
OF_SCENE = "scene", "hidden"
"""Axes beside the scene's <default>s: of A, and of the scene as a whole."""


class Watcher:
    """What follows a sweep as it goes on; this one does nothing but run it."""

    progress: Progress = staticmethod(silent)

    def begin(self, sweep: Any, missing: Sequence[Mapping[str, Any]]) -> None:
        """Follow a `Sweep` of `Worlds` from its begin, with the cells that are missing."""

    def timed(
        self, part: str, make: Callable[Given, Made], *given: Given.args, **named: Given.kwargs
    ) -> Made:
        """Return what a function makes, a part of the sweep."""
        del part
        return make(*given, **named)

    def made(self, part: Any) -> None:
        """Follow a photograph, by its file, or matrices, by `Worlds.key`, that were made."""

    def see(self, world: "WorldParts") -> None:
        """Follow a world whose methods are fitted, before its ambient light is rendered."""

    def took(self, method: str, seconds: float) -> None:
        """Follow how long a thread took for a photograph by a method."""

    def note(self, notes: "Sequence[Note | str]") -> None:
        """Follow notes on a scene, or lines; this one warns of them."""
        for each in notes:
            warnings.warn(str(each), RuntimeWarning, stacklevel=3)


@dataclass(frozen=True, eq=False)
class WorldParts:
    """A world in the making: how to fit its methods again, to light it evenly, and its places."""

    fit: Callable[[], Any]
    evenly_lit: Callable[[Collection[str]], World]  # in even light of some names
    lights: Mapping[Path, str]  # conditions that are not rendered yet, by files in the cache
    trace: Callable[[str], Any]  # renders one of them


@dataclass(frozen=True, eq=False)
class Worlds:
    """Makes the world of values of some axes, from parts that a folder keeps.

    Worlds of other values have folders of their own in it. Of `conditions` and `conditions_of` see
    `periscopy_sim.evaluation.world.WorldMaker`.
    """

    scenario: Scenario  # where no axis changes it
    out: Path
    shown: Mapping[str, Any]  # hidden images by name: pictures' names, see `Scenario.image`
    photographs: Mapping[str, Photograph]  # those given, by the same names; others are rendered
    ambient: Mapping[str, Array | None]  # None: a shipped condition, which is path traced
    flips: bool  # whether each ambient light is also flipped about each axis
    methods: Mapping[str, Name]  # by what the sweep calls them
    noise: float  # of the photographs, over the mean of the monitor's light, at its least
    conditions: Mapping[str, Any]
    conditions_of: Mapping[str, Mapping[str, Any]]
    mask: Mask | None = None
    monitor_off: Mapping[str, Array] = field(default_factory=dict)
    calibrates: bool = False  # whether an axis says what methods know, so that they may calibrate
    watcher: Watcher = field(default_factory=Watcher)
    command: Sequence[str] = ()  # for provenance
    keep: Callable[[], None] = lambda: None  # called when a world's parts are in its folder
    _scenarios: dict[Any, Scenario] = field(default_factory=dict, init=False)
    _calibrators: dict[Any, Calibrator] = field(default_factory=dict, init=False)

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
        true, assumed = self.at(values), self.at(values, ASSUMED)
        at, timed = self._folder(values), self.watcher.timed
        self.watcher.note(true.check(""))
        signals = {n: timed("photograph", self._signal, true, at, n, snr) for n in self.shown}
        errors = {name: each.relative_error or 0.0 for name, each in signals.items()}
        wall = next(iter(signals.values()))
        plans: dict[str, TransportPlan] = {}
        if values.get(KNOWN) == CALIBRATED:
            fitted = self._calibrated(true, assumed, values, wall)
        else:
            fitted, plans = timed("fit", self._fitted, assumed, values, wall)
        world = partial(
            World,
            signals=signals,
            truths={name: true.image(names) for name, names in self.shown.items()},
            methods=fitted,
            transport={name: plan.origin for name, plan in plans.items()},
            draw=int(values.get(DRAW, 0)),
            measures=self.measures,
        )
        if plans:
            light = np.ones_like(wall.values)
            again = partial(self._fitted, replace(assumed, memo=Memo()), values, wall)
            self.watcher.see(WorldParts(
                again, lambda names: world(backgrounds=dict.fromkeys(names, light)),
                self.missing_lights(values), lambda name: self._traced(values, [name]),
            ))  # fmt: skip
        traced = self._traced(values, self._rendered)
        seen = {
            name: seen_in(traced[name].photograph if light is None else light, wall.channels)
            for name, light in self.ambient.items()
        }
        self.keep()
        errors |= {
            each: light.relative_error
            for name, light in traced.items()
            for each in flipped_names(name, self.flips)
        }
        return world(backgrounds=flips(seen) if self.flips else seen, errors=errors)

    @property
    def _rendered(self) -> list[str]:
        """Names of the ambient light that is path traced."""
        return [name for name, light in self.ambient.items() if light is None]

    def _traced(self, values: Mapping[str, Any], names: Sequence[str]) -> "dict[str, Background]":
        """Return ambient light at values of axes, path traced."""
        true, folder = self.at(values), self.ambient_folder(values)
        progress = self.watcher.progress
        return ambient_photographs(names, true, folder, true.seed, progress=progress)

    def ambient_folder(self, values: Mapping[str, Any]) -> Path:
        """Return the folder of ambient light, which patches do not change."""
        return self._folder({n: v for n, v in values.items() if n != "hidden"}) / "ambient"

    def missing_lights(self, values: Mapping[str, Any]) -> dict[Path, str]:
        """Return the names of ambient light that is not rendered yet, by the cache's files."""
        true, folder = self.at(values), self.ambient_folder(values)
        return missing_photographs(self._rendered, true, folder, true.seed)

    def matrices(self, values: Mapping[str, Any]) -> int:
        """Return how many matrices the methods need at values of axes; none if they calibrate."""
        light = self.light(values)
        entries = map(entry_of, self.methods.values())
        ways = {entry is not None and entry.rays for entry in entries}
        if values.get(KNOWN) == CALIBRATED:
            return 0
        return 1 if light.samples or light.by else len(ways)

    def missing_signals(self, snr: float, values: Mapping[str, Any]) -> set[Path]:
        """Return the files of photographs that are to be rendered for an SNR and values of axes."""
        folder, rendered = self._folder(values), self.shown.keys() - self.photographs.keys()
        files = (_photograph_file(folder, name, snr) for name in rendered)
        return {file for file in files if not file.is_file()}

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
            words = [each for each in values if not np.isfinite(number_of(str(each)))]
            unit = document.units.get(axis.removeprefix(ASSUMED), "")
            for value in words or values:
                _check_value(axis, value, options.get(axis), unit)
            if axis in (KNOWN, *OF_SCENE, *numbers, *assumed):
                self._check_scene(axis, values[0])
                self._check_scene(axis, values[-1])
        if sizes := [*map(str, axes.get("hidden", ()))]:  # before hours of rendering others
            largest = max(sizes, key=lambda size: int(np.prod(size_of(size))))
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

    def at(self, values: Mapping[str, Any], of: str = "") -> Scenario:
        """Return the true scenario at values of axes, or the ``assumed.`` one."""
        base, numbers = self.scenario, self.scenario.document.defaults
        defined = {n: v for n, v in values.items() if n in numbers}
        defined |= {n.removeprefix(of): v for n, v in values.items() if of and n.startswith(of)}
        if of and not _is_known(values):
            draw = [base.seed, 1 + int(values.get(DRAW, 0))]  # not the stream of the seed alone
            defined |= read_by_ruler(self.at(values), draw)
        whole = {n: values[n] for n in OF_SCENE if n in values}
        if not defined and not whole:
            return base
        key = (*defined.items(), *whole.items())
        if key not in self._scenarios:
            texts = {n: f"{value:.9g}" for n, value in defined.items()}
            made = base
            if whole:
                (surface, size), *others = base.hidden.shapes.items()
                sizes = {surface: size_of(str(whole["hidden"]))} if "hidden" in whole else {}
                made = load_scenario(
                    whole.get("scene", base.path), {surface: size, **dict(others), **sizes},
                    {**base.parameters, **texts}, camera=base.view.camera,
                )  # fmt: skip
                made = replace(made, light=base.light, seed=base.seed, memo=base.memo)
            elif texts:
                made = base.at(**texts)
            while len(self._scenarios) >= KEPT:
                del self._scenarios[next(iter(self._scenarios))]
            self._scenarios[key] = made
        return self._scenarios[key]

    def _folder(self, values: Mapping[str, Any], of: str = "") -> Path:
        """Return the folder of what is rendered of the true scene, or of the ``assumed.`` one."""
        numbers = self.scenario.document.defaults
        names = *numbers, *OF_SCENE
        own = {n: v for n, v in values.items() if n in names or (of and n.startswith(of))}
        if of and not _is_known(values):
            own[DRAW] = values.get(DRAW, 0.0)
        texts = {n: f"{v:.9g}" if isinstance(v, float) else Path(v).stem for n, v in own.items()}
        return self.out / ",".join(f"{name}={text}" for name, text in texts.items())

    def key(self, values: Mapping[str, Any]) -> tuple[Any, ...]:
        """Return what the matrices at values of axes depend on."""
        light = self.light(values)
        return self._folder(values, ASSUMED), light.samples, light.by

    def _signal(self, scenario: Scenario, folder: Path, name: str, snr: float) -> Photograph:
        """Return the photograph of a hidden image, with its own error.

        It is given, then of no known error, or rendered for the SNR, from its file if any: a cell
        has the same photograph in whichever run it is computed.
        """
        if name in self.photographs:
            return self.photographs[name]
        file = _photograph_file(folder, name, snr)
        picture, seed = scenario.image(self.shown[name]), scenario.seed
        origin = provenance(scenario.document, seed, self.command)
        made = {n: origin[n] for n in ("scene_sha256", "parameters", "seed")}
        made |= {"camera": scenario.view.camera, "bounces": str(scenario.light.bounces)}
        made |= {"image_sha256": image_sha256(picture)}
        held = read_exr(file)[1] if file.is_file() else {}
        # A picture or a scene of this name may have been another.
        if not as_text(made).items() <= held.items():
            with staged_file(file) as staged, self.watcher.progress(f"photograph: {name}") as done:
                rendered = rendering_of(
                    scenario, picture, snr=snr, bounces=scenario.light.bounces,
                    seed=_seed_of(scenario, name), progress=done,
                )  # fmt: skip
                held = {
                    **as_text({**origin, **made, "image": name}),
                    "relative_error": rendered.relative_error,
                    "made_for_snr": snr,
                }
                write_exr(staged, rendered.photograph, held)
            self.watcher.made(file)
        wall = read_photograph(file, scenario.photograph_shape, self.mask)
        error = float(held["relative_error"])
        return replace(wall, monitor_off=self.monitor_off, relative_error=error)

    def light(self, values: Mapping[str, Any]) -> Light:
        """Return the light that is modelled at values of axes."""
        varied: dict[str, Any] = {}
        if "samples" in values:
            varied["samples"] = int(values["samples"])
        if "model" in values:
            varied["by"] = WAYS[values["model"]]
        return replace(self.scenario.light, **varied)

    def _settings(self, values: Mapping[str, Any], method: str) -> dict[str, float]:
        """Return a method's options at values of axes."""
        own = f"{method}."
        return {n.removeprefix(own): value for n, value in values.items() if n.startswith(own)}

    def _fitted(
        self, scenario: Scenario, values: Mapping[str, Any], wall: Photograph
    ) -> "tuple[dict[str, Method], dict[str, TransportPlan]]":
        """Return the methods, each fitted to an A as fine as its photographs need, and its plan."""
        scenario = replace(scenario, light=self.light(values))
        plans = {n: scenario.plan(self.noise, method) for n, method in self.methods.items()}
        for plan, name in {plan: name for name, plan in plans.items()}.items():
            verb = "rendering" if plan.by == "rays" else "computing"
            with self.watcher.progress(f"{verb} the transport matrix") as done:
                make = partial(scenario.transport, progress=done)
                self.watcher.timed("matrix", make, self.noise, self.methods[name])
        self.watcher.made(self.key(values))
        errors: dict[str, float] | None = {} if _is_known(values) else None
        with self.watcher.progress("fitting the methods"):
            fit = partial(self._fit, scenario, values, wall, errors)
            return {name: fit(name) for name in self.methods}, plans

    def _fit(
        self,
        scenario: Scenario,
        values: Mapping[str, Any],
        wall: Photograph,
        errors: Mapping[str, float] | None,
        name: str,
    ) -> "Method":
        """Fit a method to a scene, of which some errors are known."""
        settings, method = self._settings(values, name), self.methods[name]
        try:
            return scenario.method(method, wall, noise=self.noise, errors=errors, **settings)
        except InputError as error:
            raise PeriscopyError(f"scene '{scenario.path}': {error}") from error

    def _calibrated(
        self, true: Scenario, ruler: Scenario, values: Mapping[str, Any], wall: Photograph
    ) -> "dict[str, Method]":
        """Return the methods, each of which calibrates the ruler's scene by the photograph."""
        names = tuple(free_parameters(true.document))
        numbers = start_values(true.document, names).tolist()
        key, light = (self._folder(values), self._folder(values, ASSUMED)), self.light(values)
        if key not in self._calibrators:
            while len(self._calibrators) >= KEPT:
                del self._calibrators[next(iter(self._calibrators))]
            truth = dict(zip(names, numbers, strict=True))
            self._calibrators[key] = Calibrator(ruler, truth, wall)
        calibrator = self._calibrators[key]

        def fit(name: str, scenario: Scenario) -> "Method":
            return self._fit(replace(scenario, light=light), values, wall, None, name)

        return {name: Calibrated(calibrator, partial(fit, name)) for name in self.methods}


def _photograph_file(folder: Path, name: str, snr: float) -> Path:
    """Return the file of a hidden image's photograph, rendered for an SNR."""
    return folder / f"photograph_{name}_{snr:.9g}dB.exr"


def _seed_of(scenario: Scenario, name: str) -> int:
    """Return the seed of a photograph: each image at each place has rays of its own."""
    labels = [scenario.seed, name, *sorted(scenario.parameters.items())]
    digest = hashlib.sha256(json.dumps(labels).encode()).digest()
    return int.from_bytes(digest[:4])


def _is_known(values: Mapping[str, Any]) -> bool:
    """Return whether methods know the true scene, at values of axes."""
    return bool(values.get(KNOWN, TRUE) == TRUE)


def _check_value(axis: str, value: Any, option: Option | None, unit: str) -> None:
    """Raise a PeriscopyError for a value that an axis cannot have."""
    words: dict[str, Sequence[str]] = {KNOWN: (TRUE, RULER, CALIBRATED), "model": [*WAYS]}
    if axis in OF_SCENE:
        return
    if axis in words:
        if value not in words[axis]:
            raise PeriscopyError(f"vary {axis}={value}: there are {', '.join(words[axis])}")
    elif not isinstance(value, float):
        form = f"numbers in {unit}" if unit else "numbers"
        raise PeriscopyError(f"vary {axis}={value}: write {form} without units, or 0:1:5")
    elif kind := {DRAW: "seed", "samples": "rays"}.get(axis):
        if not (value.is_integer() and in_range(kind, value)):
            limits = "{} to {}".format(*RANGES[kind])
            raise PeriscopyError(f"vary {axis}={value:g}: write whole numbers from {limits}")
    elif option is not None and not option.least <= value <= option.most:
        limits = f"{option.least:g} to {option.most:g}"
        raise PeriscopyError(f"vary {axis}={value:g}: write numbers from {limits}")
