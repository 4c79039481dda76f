"""The one door: from a scene's scenario come A, B, photographs, methods and judgements."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.hidden import Sizes
from periscopy_sim.light import Light
from periscopy_sim.measurement import (
    TARGET,
    add_noise,
    composite,
    composite_error,
    noise_to_signal,
)
from periscopy_sim.memo import Memo, light_cache
from periscopy_sim.numerics import Array, Image, validation
from periscopy_sim.numerics.machine import Stage, silent
from periscopy_sim.photograph import ColourMatrix, Photograph
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS, RAYS
from periscopy_sim.scene import CALIBRATED, CAMERA, Scene
from periscopy_sim.shipped import DARK, find_condition, find_image, is_photograph
from periscopy_sim.view import Geometry

if TYPE_CHECKING:
    from periscopy_sim.calibration.occluder import OccluderEstimate
    from periscopy_sim.calibration.result import Calibration
    from periscopy_sim.calibration.silhouette import Silhouette
    from periscopy_sim.methods import Name
    from periscopy_sim.model.uncertainty import UncertainTransport
    from periscopy_sim.reconstruction.method import Note, Report, StillMethod
    from periscopy_sim.rendering.ambient import Background
    from periscopy_sim.rendering.bounced import BouncedTransport
    from periscopy_sim.rendering.photograph import Rendering
    from periscopy_sim.rendering.transport import TransportPlan

Progress = Callable[[float], None]
"""Called with the fraction done."""

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Geometry):
    """A scene, what a camera sees of its wall, and hidden patches: everything is made from it.

    What is made is kept by all that it depends on (see `Memo`), and made as finely as it serves.
    `at` returns the same scenario with other values of the scene's parameters; both share what they
    keep.

    Attributes
    ----------
    view, hidden
        As of `Geometry`, which has the errors, too.
    light
        How A and B are computed.
    seed
        Seed of whatever is rendered.
    memo
        Keeps what was made.
    """

    light: Light = field(default_factory=Light)
    seed: int = 0
    memo: Memo = field(default_factory=Memo, repr=False)

    def at(self, **values: str | float) -> Self:
        """Return the same with other values for its file's ``<default>``s: `Scene.at`.

        Where things merely move, and no shape comes near the camera's view, this takes a few
        milliseconds. A PeriscopyError says that the light has an A of its own, of these values.
        """
        if self.light.matrix is not None:
            raise PeriscopyError(
                "A of your own is of one scene; to move it, leave out Light.matrix"
            )
        moved, carried = super().at(**values), self.document.defaults.get(CALIBRATED)
        return moved if carried is None else moved._carrying(carried)

    def _carrying(self, covariance: str) -> Self:
        """Return the scenario with what a calibration knows of it, as its text."""
        defaults = {**self.document.defaults, CALIBRATED: covariance}
        scene = replace(self.scene, document=replace(self.document, defaults=defaults))
        return replace(self, view=replace(self.view, scene=scene))

    @property
    def A(self) -> Any:  # noqa: N802  the symbol
        """(M, N) the light transport matrix, as fine as photographs of 60 dB need.

        It is kept, and read-only: copy it before you write into it.
        """
        return self.transport()

    @property
    def B(self) -> Any:  # noqa: N802  the symbol
        """(M, L) the light of lamps on the wall: Eq. 4 on the paper's grid, or `Light.ambient`."""
        from periscopy_sim.analytic.point_light import point_light_backgrounds

        def make() -> Any:
            eq4, pixels = partial(point_light_backgrounds, self), self.transport_shape[0]
            for own in self.light.ambient:
                if own is not None and own.shape[:1] != (pixels,):
                    raise PeriscopyError(f"B has shape {own.shape}; give it {pixels} rows")
            return np.hstack([eq4() if B is None else B for B in self.light.ambient])

        size = 4 * 512 * self.transport_shape[0]
        return self.memo.get(("B", self._wall_digest, self._light_key), make, size)

    def plan(self, noise: float | None = None, method: "Name" = DEFAULT) -> "TransportPlan":
        """Return how A is made for photographs of some noise over their mean, and its own error.

        A method whose entry asks for rays gets them. A noise of None is that of 60 dB.
        """
        from periscopy_sim.methods import entry_of
        from periscopy_sim.rendering.transport import NOISE, TransportPlan, planned

        light = self.light
        if light.matrix is not None:
            error = light.record.get("transport_error")
            return TransportPlan(np.nan if error is None else error, is_given=True)
        entry = entry_of(method)
        wants_rays = entry is not None and entry.rays and light.by is None
        samples = light.samples or (RAYS if wants_rays else None)
        noise = NOISE if noise is None else noise
        make = partial(planned, self, noise, by=light.by, samples=samples, seed=self.seed)
        key = "plan", self.digest, self.seed, noise, light.by, samples
        return self.memo.get(key, make, self._bytes, TransportPlan)

    def _direct(self, plan: "TransportPlan", progress: Progress | None) -> "NDArray[np.float32]":
        """Return A of direct light, made as planned unless it is kept."""
        strata, seed = self.light.strata, self.seed
        make = partial(plan.transport, self, strata=strata, seed=seed, progress=progress)
        key = "A", self.digest, seed, replace(plan, made=None), strata
        return self.memo.get(key, make, self._bytes, np.ndarray)

    def transport(
        self,
        noise: float | None = None,
        method: "Name" = DEFAULT,
        *,
        progress: Progress | None = None,
    ) -> "NDArray[np.float32] | BouncedTransport":
        """Return A, (M, N) float32, made by `plan`; with bounces, the matrices of all channels.

        Raises
        ------
        SceneError
            If no light of the monitor reaches the wall, or areas are asked for and the scene has
            none.
        VariantError
            If rays are needed in a scalar variant.
        """
        from periscopy_sim.rendering.bounced import DIRECT, BouncedLight, render_bounced_light

        light = self.light
        if light.matrix is not None:
            if np.shape(light.matrix) != self.transport_shape:
                given, own = np.shape(light.matrix), self.transport_shape
                raise PeriscopyError(
                    f"A has shape {given}; the scene's camera and patches need {own}"
                )
            return light.matrix
        plan = self.plan(noise, method)
        if light.bounces == DIRECT:
            return self._direct(plan, progress)

        def make() -> "BouncedTransport":
            A = self._direct(plan, progress).copy()
            render = partial(render_bounced_light, self, bounces=light.bounces, seed=self.seed)
            key = "bounces", self.digest, self.seed, light.bounces
            bounced = self.memo.get(key, render, self._bytes // 8, BouncedLight)
            return bounced.added_to(A, light.bounces)

        bare = replace(plan, made=None)
        key = "bounced", self.digest, self.seed, bare, light.strata, light.bounces
        return self.memo.get(key, make, self._bytes)

    def transport_of(
        self, images: Array, noise: float
    ) -> "tuple[float, NDArray[np.float32] | BouncedTransport]":
        """Return the error of the light of some images, (K, N, C), and an A as fine as they need.

        Small bright details err more than the white light that `plan` looks at.
        """
        from periscopy_sim.rendering.bounced import DIRECT, add_bounces
        from periscopy_sim.rendering.transport import planned_for

        light, seed = self.light, self.seed
        error, A = planned_for(images, self, noise, by=light.by, samples=light.samples, seed=seed)
        if light.bounces == DIRECT:
            return error, A
        return error, add_bounces(self, A, light.bounces, seed=seed)

    def image(self, image: Any) -> Any:
        """Return the hidden image, (R, C, 3), of a picture in these patches.

        The picture is a file, a shipped one's name or an array, see `read_hidden_image`. Of several
        surfaces it is a mapping by id; one picture is shown by all of them.
        """
        from periscopy_sim.storage.pictures import read_hidden_image

        hidden = self.hidden
        by_id = image if isinstance(image, Mapping) else dict.fromkeys(hidden, image)
        pictures = {
            name: read_hidden_image(
                find_image(each) if validation.is_name(each) else each, hidden[name].shape
            )
            for name, each in hidden.by_id(by_id).items()
        }
        return hidden.unwrapped(pictures)

    def ambient(
        self, light: Any, *, target: float = TARGET, progress: Stage = silent
    ) -> "Background":
        """Return ambient light on the wall, of a shipped condition or a scene file, and its error.

        It is rendered once for a wall, and kept in the user's cache. A photograph, (rows, columns,
        C) in any unit or its file, has no known error; ``none`` is black. `target` is the relative
        error of a pixel to reach.
        """
        from periscopy_sim.rendering.ambient import Background, render_background
        from periscopy_sim.storage.photographs import read_photograph

        if validation.is_name(light) and str(light) == DARK:
            black = np.zeros((*self.photograph_shape, self.channel_gain.shape[-1]))
            return Background(black, 0.0, 0.0)
        if is_photograph(light):
            read: Any = read_photograph if validation.is_name(light) else Photograph.of
            photograph = read(light, self.photograph_shape)
            channels = self.channel_gain.shape[-1] if photograph.channels == 1 else 1
            values = np.repeat(photograph.values, channels, axis=2)
            return Background(values, 0.0, 0.0, warnings=photograph.warnings)
        path, seed = find_condition(str(light)), self.seed

        def make() -> Background:
            with progress(f"ambient light: {path.stem}") as report:
                made = render_background(path, self, target=target, seed=seed, progress=report)
                report(1.0)  # an interrupt may have stopped Mitsuba in the midst of it
            # To six digits: beyond those, results depend on the order in which BLAS adds.
            both = made.relative_error, made.brightness_error
            errors = (float(f"{each:.6g}") for each in both)
            return Background(made.photograph.astype(np.float32), *errors)

        key, size = self._ambient_key(path, target), 12 * int(np.prod(self.photograph_shape))
        return self.memo.get(key, make, size, Background, light_cache())

    def missing_ambient(self, names: Iterable[str], target: float = TARGET) -> dict[Any, str]:
        """Return the names of ambient light that is not rendered yet, by what it depends on."""
        keys = {self._ambient_key(find_condition(name), target): name for name in names}
        return {key: n for key, n in keys.items() if not self.memo.holds(key, light_cache())}

    def _ambient_key(self, path: Path, target: float) -> tuple[Any, ...]:
        from periscopy_sim.storage.provenance import scene_sha256

        wall = self.photograph_shape, self._wall_digest
        return "ambient", scene_sha256(path), *wall, self.seed, target

    def rendered(
        self,
        image: Any,
        *,
        snr: float,
        bounces: int | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
    ) -> "Rendering":
        """Return the light of an image on the wall, without noise, as fine as an SNR in dB needs.

        It is kept; see `photograph`, which adds ambient light and noise.
        """
        from periscopy_sim.rendering.photograph import Rendering, rendering_of
        from periscopy_sim.storage.provenance import image_sha256

        render = partial(
            rendering_of, self, image, snr=snr, samples=samples, bounces=bounces, seed=self.seed,
            progress=progress,
        )  # fmt: skip
        shown = repr(image_sha256(self.hidden.images(image)))
        key = "photograph", self.digest, self.seed, shown, snr, bounces, samples
        size = 24 * int(np.prod(self.photograph_shape))
        return self.memo.get(key, render, size, Rendering)

    def photograph(
        self,
        image: Any,
        *,
        ambient: Any = None,
        sbr: float | None = None,
        snr: float | None = None,
        bounces: int | None = None,
        samples: int | None = None,
        target: float = TARGET,
        colour_matrix: ColourMatrix | Array | None = None,
        progress: Progress | None = None,
    ) -> Photograph:
        """Render the photograph of the wall while the hidden surfaces show an image.

        Parameters
        ----------
        image
            (R, C, 3) linear radiance along the normal, of any R and C, or a name as of `image`; of
            several surfaces a mapping of such by id.
        ambient, sbr, target
            Ambient light as of `ambient`, the signal-to-background ratio, and the light's error.
        snr
            Signal-to-noise ratio, in dB, of the noise that is added. The photograph's own error is
            at most a third of it, within a budget. None adds none, and renders for 60 dB.
        bounces
            Reflections that a path may have: 1 is direct light, None any number.
        samples
            Camera samples a pixel of Mitsuba's path tracer; None lets `snr` decide.
        colour_matrix
            From the scene's channels, in which light is rendered, to the camera's.
        progress
            Called with the fraction done.

        Returns
        -------
        Photograph
            Its `relative_error` is its own error before noise, over its root mean square; one of
            its `warnings` says where this exceeds a third of the noise.

        Raises
        ------
        PeriscopyError
            If `ambient` and `sbr` do not go together, or there is no such light.
        """
        from periscopy_sim.rendering.photograph import SNR, excess_of

        if validation.is_name(ambient) and str(ambient) == DARK:
            if sbr is not None:
                raise PeriscopyError(f"sbr: ambient {DARK} has no SBR; leave one of them out")
            ambient = None
        if (ambient is None) != (sbr is None):
            raise PeriscopyError("ambient light and an SBR go together; give both or neither")
        if any(map(validation.is_name, image.values() if isinstance(image, Mapping) else [image])):
            image = self.image(image)
        for name, value, kind in (("snr", snr, "decibels"), ("sbr", sbr, "ratio")):
            if value is not None:
                validation.checked(name, [value], kind)
        colours = ColourMatrix.of(colour_matrix)
        mixed = np.array if colours is None else colours.mix
        light = None if ambient is None else self.ambient(ambient, target=target)
        purpose = SNR if snr is None else snr
        noise = noise_to_signal(purpose, np.inf)
        if sbr is not None:
            # Light that ambient light outshines may err more; both together have a third.
            noise = noise_to_signal(purpose, sbr) / np.sqrt(2)
        rendered = self.rendered(
            image, snr=-20 * np.log10(noise), samples=samples, bounces=bounces, progress=progress
        )
        y, error = mixed(rendered.photograph), rendered.relative_error
        if light is not None and sbr is not None:
            is_seen = is_photograph(ambient)  # in the camera's channels
            behind = light.photograph if is_seen else mixed(light.photograph)
            error = composite_error(y, behind, sbr, error, light.relative_error)
            y = composite(y, behind, sbr)
        y = y if snr is None else add_noise(y, snr, self.seed)
        lines = excess_of(error, purpose) if samples is None or snr is not None else ()
        lines = (*(light.warnings if light else ()), *lines)
        return Photograph(y, colour_matrix=colours, warnings=lines, relative_error=error)

    def method(
        self,
        name: "Name" = DEFAULT,
        photograph: Photograph | Image | None = None,
        *,
        noise: float | None = None,
        errors: Mapping[str, float] | None = None,
        **settings: float,
    ) -> "StillMethod[Any]":
        """Return a method fitted to this scene and to the conditions of a photograph.

        Parameters
        ----------
        name
            A method of the package, or your own as ``file.py:callable`` or a callable of
            (scenario, A, B); see `find_method`.
        photograph
            What the method is for: its noise says how fine A has to be, and the method uses its
            mask, its photographs with the monitor off and its colour matrix.
        noise
            Noise of the photographs over their mean, in place of the photograph's.
        errors
            Standard errors of the scene's parameters, for methods that count them. None: those
            that the scene declares or a calibration wrote; an empty mapping: none.
        settings
            The method's options, by their names.

        Raises
        ------
        PeriscopyError
            If there is no such method, it does not support these surfaces, or its A is of too few
            rays to have a rank.
        ValueError
            If it cannot be fitted.
        """
        from periscopy_sim import judgement
        from periscopy_sim.methods import entry_of, fit_method, label_of, source_sha256
        from periscopy_sim.rendering.bounced import channels_mean

        source = source_sha256(name)  # rejects what is no method before anything is rendered
        photograph = None if photograph is None else self._checked(photograph)
        if noise is None and photograph is not None:
            noise = self.noise(photograph)
        plan = replace(self.plan(noise, name), made=None)
        conditions = photograph and photograph.conditions
        A, B = np.asarray(channels_mean(self.transport(noise, name))), self.B

        def make() -> "StillMethod[Any]":
            uncertain, _ = self.uncertainty(name, errors)
            fitted = fit_method(name, self, A, B, photograph, uncertain, **settings)
            fitted.name, fitted.plan = label_of(name), plan
            judgement.check_rank(self, fitted, None if photograph is None else photograph.pixels)
            return fitted

        known = None if errors is None else tuple(sorted(errors.items()))
        key = (
            # A factory may have no hash; what is kept of it keeps its id.
            *("method", name if isinstance(name, str) else id(name), source, self.digest),
            *(self.seed, plan, conditions),
            *(self._light_key, known, *sorted(settings.items())),
        )
        entry = entry_of(name) or METHODS[DEFAULT]
        return self.memo.get(key, make, entry.bytes_per_entry * self._bytes // 4)

    @staticmethod
    def noise(photograph: Photograph) -> float | None:
        """Return the noise of a photograph over its mean, as its pixels show; None if they do not.

        It is that of the channel with the least.
        """
        from periscopy_sim.model.fit import relative_noise

        return relative_noise(photograph)

    def uncertainty(
        self,
        method: "Name" = DEFAULT,
        errors: Mapping[str, float] | None = None,
    ) -> "tuple[UncertainTransport | None, list[Note]]":
        """Return what errors of the scene do to light, for methods that count them, and notes.

        None where there are none, the method counts none, or the scene has no closed form. The
        errors are those of `method`.
        """
        from periscopy_sim.analytic.area_transport import has_areas
        from periscopy_sim.calibration import moving_scene
        from periscopy_sim.methods import entry_of, label_of

        entry = entry_of(method)
        if entry is None or not entry.uncertain:
            if errors:
                name = label_of(method)
                raise PeriscopyError(f"errors: {name} does not count them; leave them out")
            return None, []
        if errors is None:
            return moving_scene.scene_uncertainty(self)
        is_counted = bool(errors) and has_areas(self)
        return (moving_scene.uncertain_transport(self, errors) if is_counted else None), []

    def calibrate(self, photograph: Any, **options: Any) -> "Calibration":
        """Correct the measured values of the scene's parameters by photographs of its wall.

        The options are the keywords of `periscopy_sim.calibrate`. The result's `scenario` has the
        calibrated values, and methods fitted to it count what the calibration knows of them.
        """
        from periscopy_sim.calibration.calibrate import calibrate

        found = self._searched(calibrate, photograph, **options)
        computed = replace(self, light=self.light.computed)
        moved = computed.at(**{name: f"{value:.9g}" for name, value in found.values.items()})
        return replace(found, scenario=moved._carrying(found.scene_covariance.text()))

    def find_occluder(self, photograph: Any, out: str | Path, **options: Any) -> "OccluderEstimate":
        """Find one convex piece that this scene lacks, and write the scene that has it.

        The options are the keywords of `periscopy_sim.find_occluder`. The calibration's `scenario`
        is of the scene that was written.
        """
        from periscopy_sim.calibration.occluder import find_occluder

        found = self._searched(find_occluder, photograph, out=out, **options)
        seen = load_scenario(out, self.hidden.shapes, camera=self.view.camera)
        whole = replace(seen, light=self.light.computed, seed=self.seed)
        return replace(found, calibration=replace(found.calibration, scenario=whole))

    def recover_silhouette(self, photograph: Any, shape: str, **options: Any) -> "Silhouette":
        """Find the silhouette of a flat occluder, which nobody measured, by its shape's id.

        The options are the keywords of `periscopy_sim.recover_silhouette`.
        """
        from periscopy_sim.calibration.silhouette import recover_silhouette

        return self._searched(recover_silhouette, photograph, shape=shape, **options)

    def _searched(self, search: Callable[..., Found], photograph: Any, **options: Any) -> Found:
        """Return what a search over scenes finds from this one."""
        options = {"camera": self.view.camera, "seed": self.seed, **options}
        return search(photograph, self.scene, self.hidden.shapes, **options)

    def check(self, method: "Name | None" = None) -> "list[Note]":
        """Return notes on what the scene and its A lack, before anything is rendered.

        The method is the one that A is for; ``""`` stands for A alone, None for no A.

        Raises
        ------
        PeriscopyError
            If the method does not support these surfaces, a library is missing, or A, and the
            method fitted to it, need more memory than there is.
        """
        from periscopy_sim import judgement

        return judgement.check(self, method)

    def check_light(self, noise: float | None, method: "Name" = DEFAULT) -> "list[Note]":
        """Return notes on A beside photographs of some noise: its error, surfaces hardly seen."""
        from periscopy_sim import judgement
        from periscopy_sim.rendering.bounced import channels_mean

        A = channels_mean(self.transport(noise, method))
        light, origin = self.light, self.plan(noise, method).origin
        by_default = light.matrix is None and not (light.samples or light.by)
        return judgement.check_light(self, origin, A, noise, method, by_default=by_default)

    def judge(
        self,
        photograph: Photograph | Image,
        solution: Any,
        method: "StillMethod[Any] | Name" = DEFAULT,
        report: "Report | None" = None,
    ) -> "Report":
        """Return what can be known of a solution, and whether to trust it.

        Parameters
        ----------
        photograph
            The photograph that the solution is of.
        solution
            The method's `solve` of it.
        method
            The method, as `method` returned it, or its name if it had no settings.
        report
            The method's own report, if it was made already, as for several views.

        Returns
        -------
        Report
            Its `verdict` says whether the scene fits, its `remedies` what would help: each has
            lowered the residual of this photograph when tried.
        """
        from periscopy_sim import judgement
        from periscopy_sim.reconstruction.method import Solution, StillMethod
        from periscopy_sim.rendering.bounced import BouncedTransport

        photograph = self._checked(photograph)
        fitted: StillMethod[Any] = (
            method if isinstance(method, StillMethod) else self.method(method, photograph)
        )
        made: Any = signature(fitted.solve).return_annotation
        is_known = isinstance(made, type) and issubclass(made, Solution)
        if not isinstance(solution, made if is_known else Solution):
            raise PeriscopyError(
                f"the solution is of type {type(solution).__name__}: give what solve(photograph) "
                f"of the method {fitted.name} returns, or name the method that returned it"
            )
        report = fitted.report(photograph, solution) if report is None else report
        images = self.hidden.split(fitted.fit.mixed(solution.image))
        report, warnings = judgement.with_patches_tried(self, report, fitted, images), []
        if self.light.bounces == 1 and not isinstance(self.light.matrix, BouncedTransport):
            warnings = judgement.check_bounces(self, fitted, images, photograph, self.seed)
        remedies = judgement.remedies_of(self, report, fitted, photograph)
        return replace(report, warnings=[*report.warnings, *warnings], remedies=remedies)

    def _checked(self, photograph: Photograph | Image) -> Photograph:
        """Return a photograph of this camera's shape, from an array too."""
        if isinstance(photograph, Photograph):
            return photograph
        return Photograph.of(photograph, self.photograph_shape)

    @property
    def _bytes(self) -> int:
        """Bytes of an A."""
        return 4 * int(np.prod(self.transport_shape))

    @cached_property
    def _wall_digest(self) -> tuple[str, ...]:
        """What B depends on."""
        return _sha256(_members(self.view))

    @cached_property
    def digest(self) -> tuple[Any, ...]:
        """What direct light depends on: the scene's files and values, the view and the patches."""
        from periscopy_sim.storage.provenance import scene_sha256

        view, surfaces = self.view, self.hidden.items()
        document = scene_sha256(self.document) if self.document.files else ""
        return (
            *(document, *sorted(self.document.values.items()), view.camera, view.shape),
            *((name, *_sha256(_members(surface))) for name, surface in surfaces),
            *((each.name, *_sha256(_members(each))) for each in view.occluders),
            *self._wall_digest,
        )

    @property
    def _light_key(self) -> tuple[Any, ...]:
        """What A and B depend on beside the scene."""
        light = self.light
        own = _sha256(light.ambient)
        return light.bounces, light.strata, own, None if light.matrix is None else light


def _members(value: Any) -> list[Any]:
    """Return the fields' values of a dataclass, without what it has computed of them."""
    return [getattr(value, each.name) for each in fields(value)]


def _sha256(values: Iterable[Any]) -> tuple[str, ...]:
    """Return the digests of those of some values that are arrays, and "" of others."""
    from periscopy_sim.storage.provenance import array_sha256

    return tuple(array_sha256(v) if isinstance(v, np.ndarray) else "" for v in values)


def load_scenario(
    scene: str | Path | Scene,
    hidden: Sizes,
    parameters: Mapping[str, str | float] | None = None,
    *,
    photograph: tuple[int, int] | str | None = None,
    camera: str = CAMERA,
    light: Light | None = None,
    seed: int = 0,
) -> Scenario:
    """Return the scenario of a scene that keeps the id contract.

    It has a relay wall, the shape ``wall``, a sensor ``camera``, and hidden surfaces: the shape
    ``monitor``, and every shape whose id begins with ``hidden``. A scene may have several walls,
    whose ids begin with ``wall``: a camera's is the one in the middle of its picture; the others
    are occluders to it. The view's points are where the camera's own rays
    through the pixels' centres meet the wall, so any sensor serves; the patches are an R x C grid
    in a surface's UV square, so any shape with a UV parametrization serves. A surface without an
    emitter is Lambertian: its image is the radiance that it reflects.

    Every pixel is averaged over its own area: a box of one pixel takes the place of the film's
    reconstruction filter, in A and in photographs. Mitsuba's own ``mi.render`` of the file blurs by
    a Gaussian unless its film asks for ``<rfilter type="box"/>``.

    Parameters
    ----------
    scene
        A Mitsuba XML file, the name of a shipped scene, or a scene that was loaded.
    hidden
        (R, C), rows and columns of the hidden image, or text such as ``29x36``; of several surfaces
        a mapping of such by id.
    parameters
        Values for the file's ``<default>``s.
    photograph
        (rows, columns), or such text, into which the camera's field of view is cut; None for the
        film's own pixels. Another cut serves transport matrices and closed forms; pictures have
        the film's.
    camera
        Id of the sensor.
    light
        How A and B are computed.
    seed
        Seed of whatever is rendered.

    Raises
    ------
    SceneError
        If the contract is broken, a pixel misses the wall, the hidden sizes are not possible or
        lack a surface, one lies in another or faces away, or A cannot treat a material, a medium,
        or a surface's place or UV.
    """
    from periscopy_sim.rendering.load import load_geometry

    for name, value, kind in (("parameters", parameters, Mapping), ("light", light, Light)):
        if not isinstance(value, kind | None):
            what = "a dictionary" if kind is Mapping else "a ps.Light"
            raise PeriscopyError(f"{name} is of type {type(value).__name__}: give {what}")
    validation.checked("seed", [seed], "seed")
    seen = load_geometry(scene, hidden, parameters, photograph=photograph, camera=camera)
    return Scenario(seen.view, seen.hidden, light or Light(), seed)
