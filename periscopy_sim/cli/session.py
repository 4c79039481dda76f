"""One run of a command on a scene: it reads, checks, times, fits and writes."""

import re
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import messages, options
from periscopy_sim.cli.output import fixable, progress, say, warn, write_json
from periscopy_sim.measurement import TARGET
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photograph import blackened
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.scene import CAMERA
from periscopy_sim.storage.provenance import as_text, provenance

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Note, Report, StillMethod


ALL_BUT_SHADOWS = "other_lights", "glossy"
"""Codes of notes on a scene that are of A alone: a photograph and a drawing have no A."""


def check_file_names(path: Path, names: Iterable[str]) -> None:
    """Reject ids of a scene's hidden surfaces or cameras that cannot be parts of files' names."""
    for name in names:
        if not re.fullmatch(r"[\w.-]+", name):
            form = "letters, digits, '_', '-' and '.'"
            raise ps.PeriscopyError(f"scene '{path}': '{name}': give it an id of {form}")


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
                check_file_names(self.path, scene.emission)
            sizes = self.sizes or dict.fromkeys(scene.emission, self.patches)
            return ps.load_scenario(
                scene, sizes, photograph=self.pixels, camera=self.sensor, seed=self.seed
            )

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

    def lit(
        self,
        light: options.MonitorLight,
        matrix: Path | None = None,
        strata: Literal["jittered", "gauss"] = "jittered",
    ) -> ps.Scenario:
        """Return the scenario whose light is computed by options, or whose A is of a file."""
        from periscopy_sim.storage.transport_matrix import read_record, read_transport

        if matrix is not None and (light.samples or light.model):
            raise ps.PeriscopyError("--transport: leave out --samples and --model, or the file")
        lit = replace(light.of(self.scenario), strata=strata)
        self.record["transport"] = matrix
        if matrix is not None:
            A = read_transport(matrix, self.scenario, light.most_bounces)
            if not (record := read_record(matrix)):
                self.warn(messages.sentence("no_record", file=matrix))
            lit = replace(lit, matrix=A, record=record)
        if isinstance(light, options.LightOptions):
            self.settings |= light.origin
        return replace(self.scenario, light=lit)

    def check_scene(self, method: str = "", but: Collection[str] = ()) -> None:
        """Reject a scene that a method, or the memory, cannot take; warn of what A lacks."""
        scenario = self.scenario  # loading it is a stage of its own
        with self.timed("check the scene"), progress("checking the scene"):
            self.warn_of(scenario.check(method), but)

    def warn_of(self, notes: "Iterable[Note]", but: Collection[str] = ()) -> None:
        """Print notes, one line each, but for those of some codes."""
        for note in notes:
            if note.code == "fine_grid":
                say(messages.note_sentence(note))
            elif note.code not in but:
                self.warn(messages.note_sentence(note))

    def warn(self, *lines: str) -> None:
        """Print warnings, and keep them for the summary; views of one scene share some."""
        for line in lines:
            if line not in self.warnings:
                warn(line)
                self.warnings.append(line)

    def by_surface(self, entries: Sequence[str], flag: str) -> dict[str, str]:
        """Read ``VALUE`` of the only hidden surface, or ``ID=VALUE`` of each, by the ids."""
        pairs = options.by_name(flag, entries, self.scenario.hidden, str)
        if any(len(values) != 1 for values in pairs.values()):
            form = ", ".join(f"{name}=..." for name in pairs)
            raise ps.PeriscopyError(f"{flag}: name each hidden surface once: {form}")
        return {name: value for name, (value,) in pairs.items()}

    def ambient_light(self, name: str | Path, target: float = TARGET) -> "ps.Background":
        """Return ambient light: of a photograph, of no known error, or of a condition."""
        light = self.scenario.ambient(name, target=target, progress=progress)
        self.warn(*light.warnings)
        return light

    def photograph(self, path: Path, mask: Mask | None = None) -> ps.Photograph:
        """Read a photograph of the size that the scene's camera has."""
        photograph = ps.read_photograph(path, self.scenario.photograph_shape, mask)
        self.warn(*photograph.warnings)
        return photograph

    def transport(
        self, scenario: ps.Scenario, noise: float | None = None, method: str = DEFAULT
    ) -> None:
        """Make a scenario's A, by stages that show their progress; warn of what it lacks.

        The noise is that of the photographs that A is fitted to, over their mean; None of none.
        """
        with progress("choosing how A is made"):
            plan = scenario.plan(noise, method)
        verb = "rendering" if plan.by == "rays" else "computing"
        with progress(f"{verb} the transport matrix") as report:
            scenario.transport(noise, method, progress=report)
        names = "model", "samples", "transport_error"
        self.record |= {name: plan.origin[name] for name in names}
        self.record |= {} if noise is None else {"relative_noise": noise}
        self.warn_of(scenario.check_light(noise, method))

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
            options.by_name(flag, entries, [self.sensor], Path)[self.sensor]
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
            self.warn(messages.sentence("defects", name=name, defects=defects))
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
        scenario: ps.Scenario,
        wall: ps.Photograph,
        errors: Mapping[str, float] | None = None,
    ) -> "StillMethod[Any]":
        """Return a method fitted to a scenario and a photograph, by stages that are timed."""
        colours = wall.colour_matrix and wall.colour_matrix.matrix
        self.settings |= {"method": method, **settings, "colour_matrix": colours}
        self.warn_of(scenario.uncertainty(method, errors)[1])
        with self.timed("transport matrix"):
            self.transport(scenario, scenario.noise(wall), method)
        with self.timed("prototype backgrounds"), progress("computing the prototype backgrounds"):
            _ = scenario.B
        place = fixable(str(self.record["transport"] or f"scene '{self.path}'"))
        with self.timed("fit the method"), progress(f"fitting {method}"), place:
            return scenario.method(method, wall, errors=errors, **settings)

    def views(self, photos: Sequence[Path]) -> "dict[str, PhotoSession]":
        """Return the session of each photograph's view, by its camera; what they share is one's."""
        cameras = self.camera or [CAMERA]
        if len(photos) != len(cameras) or len({*cameras}) < len(cameras):
            raise ps.PeriscopyError(
                f"photographs: {len(photos)}, cameras: {', '.join(cameras)}; give each photograph "
                "a --camera of its own, in their order"
            )
        if len(cameras) > 1:
            check_file_names(self.path, cameras)
        masks = options.by_name("--mask", self.mask, cameras, Path)
        off = options.by_name("--monitor-off", self.monitor_off, cameras, Path)
        views = {each: copy(self) for each in cameras}
        for each, view in views.items():
            view.camera, view.mask, view.monitor_off = [each], masks[each], off[each]
            view.record = {}
        return views

    def judge(self, name: str, report: "Report") -> tuple[str, str]:
        """Return a report's verdict, one line with remedies, and its colour; print its warnings.

        A calibration that the scene carries and that is not trusted is a part of the verdict.
        """
        line, shade = messages.verdict(report, with_remedies=True), messages.colour(report)
        for note in report.warnings:
            if note.code != report.verdict.code:
                self.warn(f"{name}: {messages.note_sentence(note)}")
        if shade == "red" or report.is_doubted:
            self.warnings.append(f"{name}: {line}")
        return line, shade
