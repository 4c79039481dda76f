"""The worlds of a sweep: what each needs is rendered once, and kept in its folder."""

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.calibration.prior import free_parameters, read_by_ruler, start_values
from periscopy_sim.cli.light import Light, check_memory
from periscopy_sim.cli.options import FOR_STILLS, RANGES, Model, in_range, settings_for
from periscopy_sim.cli.output import fixable, output_files, part_of_command, progress
from periscopy_sim.cli.render import write_transport
from periscopy_sim.cli.session import WallSession
from periscopy_sim.cli.study.forecast import Parts, SweepForecast
from periscopy_sim.errors import PeriscopyError, SceneError, did_you_mean
from periscopy_sim.evaluation.workers import thread_count
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.limits import number_of, size_of
from periscopy_sim.photograph import Photograph, seen_in
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.storage.ambient_library import (
    ambient_photographs,
    cached_light,
    find_condition,
)
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.provenance import as_text, image_sha256

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from periscopy_sim.calibration.scene_covariance import SceneCovariance
    from periscopy_sim.evaluation.calibrating import Calibrator
    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.rendering.transport.plan import TransportPlan

KNOWN = "assumed"
ASSUMED = f"{KNOWN}."
"""Before the name of a <default>: of the scene that methods are fitted to, not the true one."""

DRAW = "ruler"
TRUE, RULER, CALIBRATED = "true", "ruler", "calibrated"
"""What methods know of the numbers that declare an error: the true ones, those that a ruler reads,
or what a calibration by each photograph makes of these."""

KEPT = 8
"""Scenes that are held in memory."""

OF_LIGHT: Mapping[str, Callable[[Any], Any]] = {"samples": int, "model": Model}
OF_SCENE = "scene", "hidden"
"""Axes beside the scene's <default>s: of A, with their types, and of the scene as a whole."""


@dataclass(frozen=True, eq=False)
class Worlds:
    """Makes the world of values of some axes, from parts that a folder keeps.

    Worlds of other values have folders of their own in it. Of `conditions` and `conditions_of` see
    `periscopy_sim.evaluation.world.WorldMaker`.
    """

    session: WallSession  # the scene, where no axis changes it
    light: Light  # modelled, where no axis changes it
    out: Path
    shown: Mapping[str, Mapping[str, str]]  # hidden images: each surface's picture, by id
    photographs: Mapping[str, Photograph]  # those given, by the same names; others are rendered
    ambient: Mapping[str, Array | None]  # None: a shipped condition, which is path traced
    flips: bool  # whether each ambient light is also flipped about each axis
    methods: Sequence[str]
    noise: float  # of the photographs, over the mean of the monitor's light, at its least
    conditions: Mapping[str, Any]
    conditions_of: Mapping[str, Mapping[str, Any]]
    calibrates: bool = False  # whether an axis says what methods know, so that they may calibrate
    scheduler: str | None = None  # whose workers reconstruct
    keep: Callable[[], None] = lambda: None  # called when a world's parts are in its folder
    _sessions: dict[Any, WallSession] = field(default_factory=dict, init=False)
    _calibrators: "dict[Any, Calibrator]" = field(default_factory=dict, init=False)
    _plans: "dict[Any, dict[str, TransportPlan]]" = field(default_factory=dict, init=False)
    forecast: SweepForecast = field(default_factory=SweepForecast, init=False)

    @property
    def axes(self) -> dict[str, list[str]]:
        """The names of methods, images and ambient light, by the names of a sweep's axes."""
        from periscopy_sim.evaluation.world import flipped_names

        lights = [name for light in self.ambient for name in flipped_names(light, self.flips)]
        return {"algorithm": [*self.methods], "image": [*self.shown], "background": lights}

    @property
    def hidden(self) -> ps.Hidden:
        """The hidden surfaces of the session."""
        return self.session.scenario.hidden

    @property
    def channels(self) -> int:
        """Channels of the images: those of the photographs given, else three."""
        return next((each.channels for each in self.photographs.values()), 3)

    def __call__(self, **values: Any) -> "ps.World":
        """Return the world of values of some axes."""
        from periscopy_sim.evaluation.world import flipped_names

        true, assumed = self._session(values), self._session(values, ASSUMED)
        true.check_scene()
        at, timed = self._folder(values), self.forecast.timed
        rendered = {n: timed("photograph", self._signal, true, at, n) for n in self.shown}
        signals = {name: photograph for name, (photograph, _) in rendered.items()}
        errors = {name: error for name, (_, error) in rendered.items()}
        wall = next(iter(signals.values()))
        plans: dict[str, TransportPlan] = {}
        if values.get(KNOWN) == CALIBRATED:
            fitted = self._calibrated(true, assumed, values, wall)
        else:
            fit = partial(self._fitted, assumed, values, wall)
            fitted, plans = timed("fit", fit)
        world = partial(
            ps.World,
            signals=signals,
            truths={name: true.hidden_image(names) for name, names in self.shown.items()},
            methods=fitted,
            transport={name: plan.origin for name, plan in plans.items()},
            draw=int(values.get(DRAW, 0)),
            measures=self.measures,
        )
        if plans and not self.forecast.is_shown:
            light = np.ones_like(wall.values)
            self.forecast.measure(
                fit, lambda names: world(backgrounds=dict.fromkeys(names, light)),
                self._cached_lights(values), lambda name: self._traced(values, [name]),
                thread_count(self.scheduler),
            )  # fmt: skip
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
        return world(backgrounds=ps.flips(seen) if self.flips else seen, errors=errors)

    @property
    def _rendered(self) -> list[str]:
        """Names of the ambient light that is path traced."""
        return [name for name, light in self.ambient.items() if light is None]

    def _traced(
        self, values: Mapping[str, Any], names: Sequence[str]
    ) -> "dict[str, ps.Background]":
        """Return ambient light at values of axes, path traced."""
        true, folder = self._session(values), self._ambient_folder(values)
        return ambient_photographs(names, true.scenario, folder, true.seed, progress=progress)

    def _ambient_folder(self, values: Mapping[str, Any]) -> Path:
        """Return the folder of ambient light, which patches do not change."""
        return self._folder({n: v for n, v in values.items() if n != "hidden"}) / "ambient"

    def _cached_lights(self, values: Mapping[str, Any]) -> dict[Path, str]:
        """Return the names of ambient light that is path traced, by the user's files of it."""
        true = self._session(values)
        paths = {name: find_condition(name) for name in self._rendered}
        return {cached_light(path, true.scenario, true.seed): n for n, path in paths.items()}

    def parts(self, values: Mapping[str, Any]) -> Parts:
        """Return what the world of values of axes is made of."""
        light, folder = self._light(values), self._folder(values, ASSUMED)
        ways = {name in METHODS and METHODS[name].rays for name in self.methods}
        matrices = f"A_{light.samples}_rays*.npy" if light.samples else "A*.npy"
        count = 1 if light.samples or light.model else len(ways)
        is_calibrated = values.get(KNOWN) == CALIBRATED
        return Parts(
            photographs={
                file
                for name in self.shown.keys() - self.photographs.keys()
                if self._has_noise(file := self._photograph_file(self._folder(values), name))
            },
            matrices=None if is_calibrated else (folder, matrices, count),
            place=self._ambient_folder(values),
            lights=partial(self._cached_lights, values),
        )

    def check(self, axes: Mapping[str, Sequence[Any]]) -> None:
        """Reject axes that no world knows, and values that they cannot have.

        A PeriscopyError names the axis, with the one that was perhaps meant.
        """
        document = self.session.scenario.document
        paths = [ps.find_scene(str(scene)) for scene in axes.get("scene", ())]
        if len({path.stem for path in paths}) < len(paths):
            names = ",".join(map(str, paths))
            raise PeriscopyError(f"--vary scene={names}: two scenes have one name; rename one")
        declared = [document, *map(read_document, paths)]
        errors_of = {error for each in declared for error in each.errors}
        common = set.intersection(*({*each.defaults} for each in declared)) - errors_of
        numbers = [name for name in document.defaults if name in common]
        taken = ((name, each) for name in self.methods for each in FOR_STILLS.get(name, ()))
        options = {f"{name}.{each.name}": (name, each.name) for name, each in taken}
        is_known = not {*axes.get(KNOWN, ())} - {TRUE}
        if is_known and DRAW in axes:
            raise PeriscopyError(f"--vary {DRAW}: also --vary {KNOWN}={TRUE},{RULER},{CALIBRATED}")
        errors = () if is_known else document.errors.values()
        assumed = [ASSUMED + name for name in numbers if name not in errors]
        known = ["sbr", "snr", KNOWN, DRAW, *OF_SCENE, *OF_LIGHT, *numbers, *assumed, *options]
        for axis, values in axes.items():
            if axis not in known:
                guess = did_you_mean(axis, known) or f"there are {', '.join(known)}"
                raise PeriscopyError(f"--vary {axis}: no such axis; {guess}")
            if self.photographs and axis in (*numbers, "scene"):
                raise PeriscopyError(
                    f"--vary {axis}: --photograph is of one scene; give --hidden-image, or vary "
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
            for method in self.methods:
                check_memory(self._session({"hidden": largest}).scenario, method)

    def _check_scene(self, axis: str, value: Any) -> None:
        """Load the true and the assumed scene; reject what no sweep can compare."""
        try:
            true, assumed = (self._session({axis: value}, of).scenario for of in ("", ASSUMED))
        except SceneError as error:
            raise SceneError(f"--vary {axis}={value}: {error}") from error
        if [*true.hidden] != [*self.hidden]:
            raise PeriscopyError(
                f"--vary {axis}={value}: its hidden surfaces are {', '.join(true.hidden)}, not "
                f"{', '.join(self.hidden)}; give scenes whose surfaces have the same ids"
            )
        if assumed.photograph_shape != true.photograph_shape:
            raise PeriscopyError(
                f"--vary {axis}={value}: the scene has photographs of {true.photograph_shape} "
                f"pixels, the assumed one of {assumed.photograph_shape}; leave the film as it is"
            )

    @property
    def measures(self) -> "Mapping[str, Mapping[str, Any]]":
        """What calibrations say of themselves, if the sweep has some."""
        if not self.calibrates:
            return {}
        from periscopy_sim.evaluation.calibrating import measures_of

        own = self.session.scenario.document
        scenes = self.conditions_of.get("scene", ())
        others = (read_document(ps.find_scene(name)) for name in scenes)
        units = {n: d.units.get(n, "1") for d in (own, *others) for n in free_parameters(d)}
        return measures_of(units)

    def units(self, axes: Collection[str]) -> dict[str, str]:
        """Return the units of axes, of those that have some."""
        units = self.session.scenario.document.units
        of = {axis: units.get(axis.removeprefix(ASSUMED)) for axis in axes}
        return {axis: unit for axis, unit in of.items() if unit}

    def _session(self, values: Mapping[str, Any], of: str = "") -> WallSession:
        """Return the session of the true scene at values of axes, or of the ``assumed.`` one."""
        base, numbers = self.session, self.session.scenario.document.defaults
        defined = {n: v for n, v in values.items() if n in numbers}
        defined |= {n.removeprefix(of): v for n, v in values.items() if of and n.startswith(of)}
        if of and not _is_known(values):
            draw = [base.seed, 1 + int(values.get(DRAW, 0))]  # not the stream of the seed alone
            defined |= read_by_ruler(self._session(values).scenario, draw)
        whole = {n: values[n] for n in OF_SCENE if n in values}
        if not defined and not whole:
            return base
        key = (*defined.items(), *whole.items())
        if key not in self._sessions:
            texts = {**base.definitions, **{n: f"{value:.9g}" for n, value in defined.items()}}
            define = [f"{name}={text}" for name, text in texts.items()]
            hidden = [whole["hidden"]] if "hidden" in whole else base.hidden
            made = replace(base, scene=whole.get("scene", base.scene), hidden=hidden, define=define)
            made.warnings, made.seconds = base.warnings, base.seconds
            while len(self._sessions) >= KEPT:
                del self._sessions[next(iter(self._sessions))]
            self._sessions[key] = made
        return self._sessions[key]

    def _folder(self, values: Mapping[str, Any], of: str = "") -> Path:
        """Return the folder of what is rendered of the true scene, or of the ``assumed.`` one."""
        numbers = self.session.scenario.document.defaults
        names = *numbers, *OF_SCENE
        own = {n: v for n, v in values.items() if n in names or (of and n.startswith(of))}
        if of and not _is_known(values):
            own[DRAW] = values.get(DRAW, 0.0)
        texts = {n: f"{v:.9g}" if isinstance(v, float) else Path(v).stem for n, v in own.items()}
        return self.out / ",".join(f"{name}={text}" for name, text in texts.items())

    def _photograph_file(self, folder: Path, name: str) -> Path:
        """Return the file of a hidden image's photograph."""
        return folder / f"photograph_{name}.exr"

    @property
    def _snr(self) -> float:
        """What photographs are rendered for, in dB; ambient light's error has its part."""
        return float(-20 * np.log10(self.noise) + 3)

    def _has_noise(self, file: Path) -> bool:
        """Return whether a photograph is missing, or was rendered for more noise."""
        held = read_exr(file)[1] if file.is_file() else {}
        return not float(held.get("made_for_snr", "nan")) >= self._snr

    def _signal(self, session: WallSession, folder: Path, name: str) -> tuple[Photograph, float]:
        """Return the photograph of a hidden image and its own error over its root mean square.

        It is given, then of no known error, or rendered, from its file if any. As A it serves the
        sweep's least noise.
        """
        from periscopy_sim.rendering.photograph import rendering_of

        if name in self.photographs:
            return self.photographs[name], 0.0
        file = self._photograph_file(folder, name)
        picture = session.hidden_image(self.shown[name])
        made = {n: session.provenance[n] for n in ("scene_sha256", "parameters", "seed")}
        made |= {"camera": session.sensor, "bounces": self.light.bounces}
        made |= {"image_sha256": image_sha256(picture)}
        held = read_exr(file)[1] if file.is_file() else {}
        # A picture or a scene of this name may have been another, or the noise larger.
        if not as_text(made).items() <= held.items() or self._has_noise(file):
            with output_files(file) as (staged,), progress(f"photograph: {name}") as report:
                rendered = rendering_of(
                    session.scenario, picture, snr=self._snr, bounces=self.light.most_bounces,
                    seed=_seed_of(session, name), progress=report,
                )  # fmt: skip
                held = {
                    **as_text({**session.provenance, **made, "image": self.shown[name]}),
                    "relative_error": rendered.relative_error,
                    "made_for_snr": self._snr,
                }
                write_exr(staged, rendered.photograph, held)
            self.forecast.photographs.discard(file)
        mask, monitor_off = session.companions()
        wall = replace(session.photograph(file), mask=mask, monitor_off=monitor_off)
        return wall, float(held["relative_error"])

    def _light(self, values: Mapping[str, Any]) -> Light:
        """Return the light that is modelled at values of axes."""
        varied = {name: of(values[name]) for name, of in OF_LIGHT.items() if name in values}
        return replace(self.light, **varied)

    def _settings(self, values: Mapping[str, Any], method: str) -> dict[str, float]:
        """Return a method's options at values of axes."""
        own = f"{method}."
        return {n.removeprefix(own): value for n, value in values.items() if n.startswith(own)}

    def _fitted(
        self, session: WallSession, values: Mapping[str, Any], wall: Photograph
    ) -> "tuple[dict[str, Method], dict[str, TransportPlan]]":
        """Return the methods, each fitted to A as planned for it, and these plans."""
        from periscopy_sim.evaluation.methods import fit_method

        scenario, light = session.scenario, self._light(values)
        folder = self._folder(values, ASSUMED)
        key = folder, light.samples, light.model
        if key not in self._plans:
            plan = partial(light.plan, scenario, self.noise, session.seed)
            self._plans[key] = {name: plan(name) for name in self.methods}
        plans = self._plans[key]
        timed, made = self.forecast.timed, partial(self._transport, session, light, folder=folder)
        matrices = {plan: timed("matrix", made, plan) for plan in {*plans.values()}}
        B = light.backgrounds(scenario)
        errors = {} if _is_known(values) else free_parameters(scenario.document)
        with fixable(f"scene '{scenario.path}'"), progress("fitting the methods"):
            fitted: dict[str, Method] = {
                name: fit_method(
                    name, scenario, matrices[plan], B, wall, _uncertain(name, scenario, errors),
                    **self._settings(values, name),
                )
                for name, plan in plans.items()
            }  # fmt: skip
        return fitted, plans

    def _calibrated(
        self, true: WallSession, ruler: WallSession, values: Mapping[str, Any], wall: Photograph
    ) -> "dict[str, Method]":
        """Return the methods, each of which calibrates the ruler's scene by the photograph."""
        from periscopy_sim.evaluation.calibrating import Calibrated, Calibrator

        names = tuple(free_parameters(true.scenario.document))
        numbers = start_values(true.scenario.document, names).tolist()
        key = self._folder(values), self._folder(values, ASSUMED)
        if key not in self._calibrators:
            while len(self._calibrators) >= KEPT:
                del self._calibrators[next(iter(self._calibrators))]
            truth = dict(zip(names, numbers, strict=True))
            self._calibrators[key] = Calibrator(ruler.scenario, truth, wall)
        calibrator = self._calibrators[key]
        rest = self._light(values), self.noise, true.seed, wall
        return {
            name: Calibrated(calibrator, partial(_fit, name, self._settings(values, name), *rest))
            for name in self.methods
        }

    def _transport(
        self, session: WallSession, light: Light, plan: "TransportPlan", folder: Path
    ) -> "NDArray[np.float32]":
        """Return A as planned: of the folder's file, which is made anew if its plan was another."""
        from periscopy_sim.storage.transport_matrix import read_record

        rays = "" if plan.samples is None else f"_{plan.samples}_rays"
        rays += f"_{plan.across}_across" if rays and plan.across > 1 else ""
        file = folder / f"A{rays}.npy"
        if not (file.is_file() and plan.origin.items() <= read_record(file).items()):
            with part_of_command():
                write_transport(session, light, plan, file)
        return session.transport(light, matrix=file)


def _seed_of(session: WallSession, name: str) -> int:
    """Return the seed of a photograph: each image at each place has rays of its own."""
    labels = [session.seed, name, *sorted(session.scenario.parameters.items())]
    digest = hashlib.sha256(json.dumps(labels).encode()).digest()
    return int.from_bytes(digest[:4])


def _is_known(values: Mapping[str, Any]) -> bool:
    """Return whether methods know the true scene, at values of axes."""
    return bool(values.get(KNOWN, TRUE) == TRUE)


def _fit(
    name: str,
    settings: Mapping[str, float],
    light: Light,
    noise: float,
    seed: int,
    wall: Photograph,
    scenario: ps.Scenario,
    errors: "SceneCovariance",
) -> "Method":
    """Fit a method to a scene, and to what a calibration knows of its errors."""
    from periscopy_sim.evaluation.methods import fit_method
    from periscopy_sim.rendering.transport.bounced import channels_mean

    A = channels_mean(light.transport(scenario, light.plan(scenario, noise, seed, name), seed))
    uncertain = _uncertain(name, scenario, errors)
    return fit_method(
        name, scenario, np.asarray(A), light.backgrounds(scenario), wall, uncertain, **settings
    )


def _uncertain(
    name: str, scenario: ps.Scenario, errors: "Mapping[str, float] | SceneCovariance"
) -> "ps.UncertainTransport | None":
    """Return what errors of a scene do to light, for a method that counts them by default."""
    from periscopy_sim.analytic.area_transport import has_areas

    if not (errors and name in METHODS and METHODS[name].uncertain and has_areas(scenario)):
        return None
    return ps.uncertain_transport(scenario, errors)


def _check_value(axis: str, value: Any, option: tuple[str, str] | None, unit: str) -> None:
    """Raise a PeriscopyError for a value that an axis cannot have."""
    words: dict[str, Sequence[str]] = {KNOWN: (TRUE, RULER, CALIBRATED), "model": [*Model]}
    if axis == "scene":
        return
    if axis == "hidden":
        if min(size_of(str(value))) < 1:
            raise PeriscopyError(f"--vary hidden={value}: give at least one patch")
    elif axis in words:
        if value not in words[axis]:
            raise PeriscopyError(f"--vary {axis}={value}: there are {', '.join(words[axis])}")
    elif not isinstance(value, float):
        form = f"numbers in {unit}" if unit else "numbers"
        raise PeriscopyError(f"--vary {axis}={value}: write {form} without units, or 0:1:5")
    elif kind := {DRAW: "seed", "samples": "rays"}.get(axis):
        if not (value.is_integer() and in_range(kind, value)):
            limits = "{} to {}".format(*RANGES[kind])
            raise PeriscopyError(f"--vary {axis}={value:g}: write whole numbers from {limits}")
    elif option is not None:
        settings_for(option[0], {option[1]: value}, FOR_STILLS)
