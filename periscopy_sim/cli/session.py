"""One run of a command on a scene: it reads, checks, times, fits and writes."""

import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.calibration.prior import distant_parameters
from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.cli import messages, options
from periscopy_sim.cli.light import Light, check_memory
from periscopy_sim.cli.messages import colour, sentence
from periscopy_sim.cli.output import fixable, progress, warn, write_json
from periscopy_sim.model.noise import relative_noise
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photograph import blackened
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS, RAYS
from periscopy_sim.rendering.survey import shadow_doubt
from periscopy_sim.rendering.transport.kernel import Strata
from periscopy_sim.scene import CAMERA
from periscopy_sim.storage.ambient_library import (
    TARGET,
    ambient_light,
    find_condition,
    is_photograph,
)
from periscopy_sim.storage.outputs.provenance import as_text, provenance

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Report, StillMethod

DIFFUSE = "diffuse", "null"
"""Materials whose reflected light, if any, is the same in all directions."""

SIGNIFICANT = 3.0
"""Standard deviations of the noise of all pixels' mean that a white surface's light exceeds."""


def check_file_names(path: Path, what: str, names: Iterable[str]) -> None:
    """Reject ids of a scene's hidden surfaces or cameras that cannot be parts of files' names."""
    for name in names:
        if not re.fullmatch(r"[\w.-]+", name):
            form = "letters, digits, '_', '-' and '.'"
            raise ps.PeriscopyError(f"scene '{path}': {what} '{name}': give it an id of {form}")


@dataclass(eq=False)
class Session(options.OptionGroup):
    """A run of a command on a scene, by the options that name it.

    `seconds` holds those that each stage took, `warnings` the lines that a summary repeats,
    `settings` its entries about the method and the light, `record` those about what was read.
    """

    pixels: ClassVar[tuple[int, int] | None] = None  # those of the scene's film
    patches: ClassVar[tuple[int, int]] = 1, 1  # of each surface, where no image is recovered
    scene: options.SceneArgument
    hidden: options.Hidden
    define: options.Define = None
    seed: options.Seed = 0
    camera: options.Cameras = None

    def __post_init__(self) -> None:
        self.sizes, self.path = options.parse_sizes(self.hidden), ps.find_scene(self.scene)
        self.definitions = options.parse_definitions(self.define)
        self.seconds: dict[str, float] = {}
        self.warnings: list[str] = []
        self.settings: dict[str, Any] = {}
        self.record: dict[str, Any] = {}

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time a block, together with others of the same name."""
        start = time.perf_counter()
        yield
        seconds = self.seconds.get(stage, 0.0) + time.perf_counter() - start
        self.seconds[stage] = round(seconds, 4)

    @cached_property
    def scenario(self) -> ps.Scenario:
        """The scene, loaded at first use."""
        with self.timed("load the scene"), progress("loading the scene"):
            scene = ps.load_scene(self.path, self.definitions)
            if len(scene.emission) > 1:
                check_file_names(self.path, "hidden surface", scene.emission)
            sizes = self.sizes or dict.fromkeys(scene.emission, self.patches)
            scenario = ps.load_scenario(scene, sizes, photograph=self.pixels, camera=self.sensor)
        for name, surface in scenario.hidden.items() if self.sizes else ():
            (rows, columns), sides = surface.shape, (surface.across, surface.up)
            across, up = (np.median(np.linalg.norm(each, axis=1)) for each in sides)
            given, other = across / up, across / up * (columns / rows) ** 2
            if 2 * abs(np.log(other)) < abs(np.log(given)):
                swapped = {"given": f"{rows}x{columns}", "other": f"{columns}x{rows}"}
                self.warn(sentence("swapped", name=name, ratio=given, **swapped))
        return scenario

    @property
    def sensor(self) -> str:
        """The id of the sensor that photographs; one alone."""
        first, *others = self.camera or [CAMERA]
        if others:
            raise ps.PeriscopyError(f"--camera {others[0]}: this command takes one view; give one")
        return first

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Versions, scene, variant, seed and command line."""
        return self.provenance_of(self.scenario)

    def provenance_of(self, scenario: ps.Scenario) -> dict[str, Any]:
        """Return the provenance of what this command makes of a scene, moved or not."""
        return provenance(scenario.document, self.seed, ["periscopy", *sys.argv[1:]])

    @property
    def hidden_shape(self) -> Any:
        """[R, C] of the hidden image, of several surfaces by id, for a record."""
        return self.scenario.hidden.unwrapped(self.scenario.hidden.shapes)

    @property
    def metadata(self) -> dict[str, str]:
        """The provenance as text, for the metadata of pictures."""
        return as_text(self.provenance)

    def check_scene(self, method: str = "", *libraries: str) -> None:
        """Reject a scene that a method, or the memory, cannot take; warn of what A lacks."""
        from periscopy_sim.evaluation.methods import check_able

        check_able(method, self.scenario.hidden, *libraries)
        check_memory(self.scenario, method)
        self.check_lights()
        self.check_shadows()

    def check_lights(self) -> None:
        """Name the lights that are not in A, and surfaces that are not diffuse; a line each."""
        if lights := self.scenario.scene.lights:
            names = ", ".join(f"'{name}'" for name in lights)
            self.warn(sentence("other_lights", scene=self.scene, names=names))
        reflecting = self.scenario.scene.reflecting.items()
        if glossy := {name: each for name, each in reflecting if each not in DIFFUSE}:
            names, materials = ", ".join(glossy), ", ".join(dict.fromkeys(glossy.values()))
            self.warn(sentence("glossy", scene=self.scene, names=names, materials=materials))

    def check_shadows(self) -> None:
        """Warn where no occluder casts a shadow into the camera's view."""
        with self.timed("check the scene"), progress("checking the scene"):
            if doubt := shadow_doubt(self.scenario):
                self.warn(f"{self.scene}: {doubt}")

    def warn(self, line: str) -> None:
        """Print a warning, and keep it for the summary; views of one scene have some in common."""
        if line not in self.warnings:
            warn(line)
            self.warnings.append(line)

    def by_surface(self, entries: Sequence[str], flag: str) -> dict[str, str]:
        """Read ``VALUE`` of the only hidden surface, or ``ID=VALUE`` of each, by the ids."""
        first, *others = hidden = self.scenario.hidden
        if len(entries) == 1 and not (others or entries[0].startswith(f"{first}=")):
            return {first: entries[0]}
        pairs = dict(entry.split("=", 1) for entry in entries if "=" in entry)
        if len(pairs) < len(entries) or pairs.keys() != hidden.keys():
            form = ", ".join(f"{name}=..." for name in hidden)
            wrong = "".join(f" {name}=..." for name in pairs if name not in hidden)
            raise ps.PeriscopyError(f"{flag}{wrong}: name each hidden surface once: {form}")
        return pairs

    def hidden_image(self, names: str | Mapping[str, str]) -> Any:
        """Read the hidden image, (R, C, 3), of the session's patches: a file, or a shipped one.

        Of several surfaces it is a mapping by id; a name alone is shown by all of them.
        """
        hidden = self.scenario.hidden
        by_id = dict.fromkeys(hidden, names) if isinstance(names, str) else names
        images = {n: ps.read_hidden_image(ps.find_image(by_id[n]), hidden[n].shape) for n in hidden}
        return hidden.unwrapped(images)

    def ambient_light(self, name: str, target: float = TARGET) -> "ps.Background":
        """Return ambient light: of a photograph, of no known error, or of a condition."""
        if is_photograph(name):
            return ps.Background(self.photograph(Path(name)).values, 0.0, 0.0)
        return ambient_light(
            find_condition(name), self.scenario, self.seed, target=target, progress=progress
        )

    def photograph(self, path: Path, mask: Mask | None = None) -> ps.Photograph:
        """Read a photograph of the size that the scene's camera has."""
        photograph = ps.read_photograph(path, self.scenario.photograph_shape, mask)
        for warning in photograph.warnings:
            self.warn(warning)
        return photograph

    def check_photograph(self, error: float, snr: float) -> None:
        """Warn where the own error of a photograph exceeds a third of its noise, of an SNR."""
        from periscopy_sim.rendering.photograph import allowed_error

        if error > allowed_error(snr):
            own = {"percent": 100 * error, "own": -20 * np.log10(error)}
            self.warn(sentence("photograph_error", **own, snr=snr))

    def transport(
        self,
        light: Light,
        noise: float | None = None,
        *,
        matrix: Path | None = None,
        method: str = DEFAULT,
        strata: Strata = "jittered",
    ) -> NDArray[np.float32]:
        """Return the mean of A over the channels, (M, N): of a file, or as `Light.plan` chooses.

        The noise is that of the photographs that A is fitted to, over their mean; None of none. A
        warning says where the error of A exceeds it.
        """
        from periscopy_sim.rendering.transport.bounced import channels_mean
        from periscopy_sim.storage import transport_matrix as files

        if matrix is None:
            plan = light.plan(self.scenario, noise, self.seed, method)
            A, origin = light.transport(self.scenario, plan, self.seed, strata), plan.origin
        else:
            A = files.read_transport(matrix, self.scenario, light.most_bounces)
            if not (record := files.read_record(matrix)):
                self.warn(sentence("no_record", file=matrix))
            origin = {**record, "model": "file", "samples": None}
        origin = {name: origin.get(name) for name in ("model", "samples", "transport_error")}
        self.record |= {**origin, "transport": matrix}
        self.settings |= light.origin
        if noise is not None:
            self.record["relative_noise"] = noise
            wants_grain = method in METHODS and METHODS[method].rays  # a ridge for P
            if matrix or light.samples or light.model or not wants_grain:
                self.check_error(origin, noise)
        A = np.asarray(channels_mean(A))
        white = A.sum(axis=0, dtype=np.float64) / (A.sum(dtype=np.float64) or 1.0)
        least = SIGNIFICANT * (noise or 0) / np.sqrt(len(A))
        for name, part in self.scenario.hidden.slices.items():
            if (share := float(white[part].sum())) < least:
                self.warn(sentence("hardly_seen", name=name, percent=100 * share))
        return A

    def check_error(self, origin: Mapping[str, Any], noise: float, name: str = "A") -> None:
        """Warn where the error of an A exceeds the photographs' noise, both over their mean."""
        if better := self.better_transport(origin, noise):
            percent = {"error": 100 * origin["transport_error"], "noise": 100 * noise}
            model = "areas" if origin["model"] == "analytic" else "rays"
            excess = sentence("transport_error", name=name, model=model, **percent)
            self.warn(f"{excess}: pass {better}")

    def better_transport(self, origin: Mapping[str, Any], noise: float | None) -> str:
        """Return the options that lower the error of an A; empty where it is below the noise."""
        from periscopy_sim.analytic.area_transport import has_areas
        from periscopy_sim.model.fit import PRECISION

        error = origin.get("transport_error")
        if error is None or noise is None or error <= max(noise, PRECISION):
            return ""
        if origin["model"] == "file":
            return "a --transport of more rays"
        if origin["model"] == "analytic":
            return "a --hidden of more patches, or a film of more pixels"
        if has_areas(self.scenario):
            return "--model analytic"
        return f"--samples {4 * (origin['samples'] or RAYS)}"

    def write_summary(self, file: Path, values: Mapping[str, Any]) -> None:
        """Write a command's numbers as JSON, with sizes, warnings, seconds and provenance."""
        summary = {
            "photograph_shape": self.scenario.photograph_shape,
            "hidden_shape": self.hidden_shape,
            **self.settings,
            **self.record,
            **values,
            "warnings": self.warnings,
            "seconds": self.seconds,
            "provenance": self.provenance,
        }
        write_json(file, summary)


@dataclass(eq=False)
class WallSession(Session):
    """A session of a command that leaves out pixels, and light other than the monitor's."""

    monitor_off: options.MonitorOffOption = None
    mask: options.MaskOption = None

    def files(self) -> tuple[Path | None, list[Path]]:
        """Return the files of the mask, of which the last counts, and with the monitor off."""
        flags = {"--mask": self.mask, "--monitor-off": self.monitor_off}
        masks, monitor_off = (
            options.files_of_view(flag, entries, [self.sensor])[self.sensor]
            for flag, entries in flags.items()
        )
        return next(reversed(masks), None), monitor_off

    def companions(self) -> tuple[Mask | None, dict[str, Array]]:
        """Read the mask, (rows, columns), and photographs with the monitor off, by file name."""
        file, off = self.files()
        mask = ps.read_mask(file, self.scenario.photograph_shape) if file else None
        monitor_off = {str(each): self.photograph(each, mask).values for each in off}
        self.record |= {"mask": file, "backgrounds": list(monitor_off)}
        self.record["pixels_left_out"] = 0 if mask is None else np.count_nonzero(~mask)
        return mask, monitor_off

    def wall(self, path: Path) -> ps.Photograph:
        """Read a photograph, its mask and its monitor-off photographs; see `without_defects`."""
        mask, monitor_off = self.companions()
        photograph = replace(self.photograph(path, mask), monitor_off=monitor_off)
        return self.without_defects(photograph, str(path))

    def without_defects(self, photograph: ps.Photograph, name: str) -> ps.Photograph:
        """Return a photograph whose mask leaves out its defects, with a warning; black outside."""
        defects = ps.defective_pixels(photograph)
        if defects.any_kind.any():
            self.warn(sentence("defects", name=name, defects=defects))
            photograph = replace(photograph, mask=photograph.pixels & ~defects.any_kind)
            self.record["pixels_left_out"] = np.count_nonzero(~photograph.pixels)
        return replace(photograph, values=blackened(photograph.values, photograph.mask))


@dataclass(eq=False)
class PhotoSession(WallSession):
    """A session of a command whose argument is a photograph: ``--scene`` names the scene."""

    scene: options.SceneOption
    colour_matrix: options.ColourMatrixOption = None

    @cached_property
    def colours(self) -> ps.ColourMatrix | None:
        """The colour matrix, read at first use."""
        return None if self.colour_matrix is None else ps.read_colour_matrix(self.colour_matrix)

    def wall(self, path: Path) -> ps.Photograph:
        """Read a photograph with its conditions, the colour matrix among them."""
        return replace(super().wall(path), colour_matrix=self.colours)

    def fit(
        self,
        method: str,
        settings: Mapping[str, float],
        light: Light,
        matrix: Path | None,
        wall: ps.Photograph,
        uncertain: "ps.UncertainTransport | None" = None,
    ) -> "StillMethod[Any]":
        """Return a method fitted to the scene's A, of a file if one is given, B and the wall."""
        from periscopy_sim.evaluation.methods import check_rank, fit_method

        colours = wall.colour_matrix and wall.colour_matrix.matrix
        self.settings |= {"method": method, **settings, "colour_matrix": colours}
        with self.timed("transport matrix"):
            noise = relative_noise(wall)
            A = self.transport(light, noise, matrix=matrix, method=method)
        with self.timed("prototype backgrounds"), progress("computing the prototype backgrounds"):
            B = light.backgrounds(self.scenario)
        place = fixable(str(matrix or f"scene '{self.path}'"))
        with self.timed("fit the method"), progress(f"fitting {method}"), place:
            fitted = fit_method(method, self.scenario, A, B, wall, uncertain, **settings)
            check_rank(fitted, self.scenario, self.record["samples"], wall.pixels, self.seed)
            return fitted

    def examined(
        self, report: "Report", fitted: "StillMethod[Any]", image: Any, wall: ps.Photograph
    ) -> "Report":
        """Return a report with what smaller patches would explain; warn of light that bounces."""
        images = self.scenario.hidden.split(fitted.fit.mixed(image))
        self._check_bounces(fitted, images, wall)
        return self._with_patches_tried(report, fitted, images)

    def _check_bounces(
        self, fitted: "StillMethod[Any]", images: Mapping[str, Array], wall: ps.Photograph
    ) -> None:
        """Warn where light of the images that bounces, and no ambient light of B, exceeds noise.

        A direct A lacks it. Images are in the channels of the fit's planes.
        """
        from periscopy_sim.rendering.photograph import bounced_light
        from periscopy_sim.rendering.variant import is_vectorized

        noise, scene, fit = self.record.get("relative_noise"), self.scenario.scene, fitted.fit
        if self.settings.get("bounces") != "direct" or not (noise and is_vectorized()):
            return
        if scene.transparent:
            return
        with self.timed("light that bounces"), progress("estimating light that bounces"):
            planes = fit.used(bounced_light(self.scenario, images, self.seed)).T
        rest = np.sqrt(np.mean(fit.project_out(planes) ** 2, axis=1))
        mean = fit.vectors(wall.values).mean(axis=0)
        if (ratio := float((rest / mean).max()) / noise) > 1:
            self.warn(sentence("bounces", scene=self.scene, ratio=ratio))

    def _with_patches_tried(
        self, report: "Report", fitted: "StillMethod[Any]", images: Mapping[str, Array]
    ) -> "Report":
        """Return a doubted report with what smaller patches would explain, by areas."""
        from periscopy_sim.analytic.area_transport import has_areas
        from periscopy_sim.rendering.photograph import detail_light

        residual, fit = report.residual, fitted.fit
        if residual is None or residual.unexplained_by_any is None or not report.is_doubted:
            return report
        if not has_areas(self.scenario):
            return report
        light = np.asarray(fit.used(detail_light(self.scenario, images)).T[None], np.float64)
        residual = residual.tried("patches", light, fit)
        numbers = {**report.numbers, **residual.numbers()}
        return replace(report, residual=residual, numbers=numbers)

    def views(self, photos: Sequence[Path]) -> "dict[str, PhotoSession]":
        """Return the session of each photograph's view, by its camera; what they share is one's."""
        cameras = self.camera or [CAMERA]
        if len(photos) != len(cameras) or len({*cameras}) < len(cameras):
            raise ps.PeriscopyError(
                f"photographs: {len(photos)}, cameras: {', '.join(cameras)}; give each photograph "
                "a --camera of its own, in their order"
            )
        if len(cameras) == 1:
            return {cameras[0]: self}
        check_file_names(self.path, "camera", cameras)
        masks = options.files_of_view("--mask", self.mask, cameras)
        off = options.files_of_view("--monitor-off", self.monitor_off, cameras)
        views = {
            each: replace(self, camera=[each], mask=masks[each], monitor_off=off[each])
            for each in cameras
        }
        for view in views.values():
            view.seconds, view.warnings = self.seconds, self.warnings
            view.settings = self.settings
        return views

    def judge(self, name: str, report: "Report") -> tuple[str, str]:
        """Return a report's verdict, one line with a remedy, and its colour; print other warnings.

        A calibration that the scene carries and that is not trusted is a part of the verdict.
        """
        known = scene_covariance(self.scenario.document)
        remedy, shade = self._remedy(report, is_calibrated=known is not None), colour(report)
        if known and not known.trusted:
            names = distant_parameters(self.scenario.document)
            remedy, shade = messages.distrusted("distrusted_scene", names), "red"
        line = messages.verdict(report, remedy)
        for note in report.warnings:
            if note.code != report.verdict.code:
                self.warn(f"{name}: {sentence(note.code, **note.values)}")
        if shade == "red" or report.is_doubted:
            self.warnings.append(f"{name}: {line}")
        return line, shade

    def _remedy(self, report: "Report", is_calibrated: bool) -> str:
        """Return the remedies that lower the residual of this photograph, or where to look."""
        if report.verdict.code == "unexplained" and self.settings.get("method") != DEFAULT:
            return sentence("default_method")
        residual, error = report.residual, self.record.get("transport_error") or 0.0
        if residual is None or not report.is_doubted:
            return ""
        better = self.better_transport(self.record, self.record.get("relative_noise"))
        if better and 2 * error**2 > residual.misfit:  # the larger part of it
            return sentence("pass", options=better)
        untried = {
            "patches": True, "numbers": not is_calibrated, "paint": not self.monitor_off
        }  # fmt: skip
        remedies = [name for name in residual.remedies if untried[name]]
        return " ".join(map(sentence, remedies or ["look"]))
