"""One run of a command on a scene: it reads, checks, times, fits and writes."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.cli.light import LightModel, TransportRequest, check_memory
from periscopy_sim.cli.options import parse_definitions, parse_size
from periscopy_sim.cli.output import Stopwatch, fixable, progress, warn, write_json
from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Mask, blackened
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text

if TYPE_CHECKING:
    from periscopy_sim.model.colour_matrix import ColourMatrix
    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.photograph import Photograph
    from periscopy_sim.scenario import Array, Scenario

SUGGESTED = "mask.png"
"""File of the mask that `Session.suggest_mask` writes."""


def load(name: str, hidden: str, definitions: list[str] | None) -> Scenario:
    """Load the scene that a command names."""
    from periscopy_sim.rendering.scene.load import load_scenario

    return load_scenario(find_scene(name), parse_size(hidden), parse_definitions(definitions))


def provenance_of(scenario: Scenario, seed: int = 0) -> dict[str, Any]:
    """Return versions, scene, variant, seed and command line."""
    import mitsuba as mi

    from periscopy_sim.storage.outputs.provenance import provenance

    command = ["periscopy", *sys.argv[1:]]
    record = provenance(scenario.path, mi.variant(), seed, command, scenario.parameters)
    return {**record, "parameters": dict(scenario.parameters)}


def warn_without_shadows(scenario: Scenario, name: str) -> list[str]:
    """Warn where no occluder casts a shadow into the camera's view; return that line, if any."""
    from periscopy_sim.rendering.checks import shadow_doubt

    doubt = shadow_doubt(scenario)
    if doubt:
        warn(f"{name}: {doubt}")
    return [f"{name}: {doubt}"] if doubt else []


def pixel_record(
    mask_file: Path | None, mask: Mask | None, monitor_off: Mapping[str, Array]
) -> dict[str, Any]:
    """Return a summary's entries about the mask and the monitor-off photographs."""
    return {
        "mask": mask_file,
        "pixels_left_out": 0 if mask is None else np.count_nonzero(~mask),
        "backgrounds": list(monitor_off),
    }


class Session:
    """A run of a command on a scene.

    Parameters
    ----------
    scene
        The scene's file, or the name of a shipped one.
    hidden
        ROWSxCOLUMNS of the hidden image; by default the least that a scene can have.
    define
        The values of ``-D``.
    seed
        Of every random draw.

    Attributes
    ----------
    timed : Stopwatch
        Seconds of each stage.
    warnings : list of str
        The lines that a summary repeats.
    sound : (rows, columns) bool
        The pixels without defects, after `without_defects`.
    """

    sound: Mask
    _suggests = False

    def __init__(
        self, scene: str, hidden: str = "1x1", define: list[str] | None = None, seed: int = 0
    ) -> None:
        parse_size(hidden)
        self.name, self.path, self.seed = scene, find_scene(scene), seed
        self.definitions = parse_definitions(define)
        self.timed = Stopwatch()
        self.warnings: list[str] = []
        self._hidden, self._define = hidden, define

    @cached_property
    def scenario(self) -> Scenario:
        """The scene, loaded at first use."""
        with self.timed("load the scene"), progress("loading the scene"):
            return load(self.name, self._hidden, self._define)

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Versions, scene, variant, seed and command line."""
        return provenance_of(self.scenario, self.seed)

    @property
    def metadata(self) -> dict[str, str]:
        """The provenance as text, for the metadata of pictures."""
        return as_text(self.provenance)

    def check_scene(self, method: str | None = None) -> None:
        """Reject a scene that a method cannot use; warn without shadows."""
        if method is not None:
            from periscopy_sim.evaluation.methods import check_able

            check_able(method, self.scenario.hidden_shape)
        self.warnings += warn_without_shadows(self.scenario, self.name)

    def warn(self, line: str) -> None:
        """Print a warning, and keep it for the summary."""
        warn(line)
        self.warnings.append(line)

    # -- reading ---------------------------------------------------------------------------------

    def hidden_image(self, name: str) -> NDArray[np.float64]:
        """Read a hidden image, (R, C, 3), of the session's patches: a file, or a shipped one."""
        from periscopy_sim.shipped import find_image
        from periscopy_sim.storage.pictures import read_hidden_image

        return read_hidden_image(find_image(name), self.scenario.hidden_shape)

    def ambient_light(self, name: str, target: float = 3e-4) -> Array:
        """Path trace ambient light, (rows, columns, 3), to a relative error of a pixel."""
        from periscopy_sim.rendering.ambient.background import render_background

        with progress("path tracing the ambient light") as report:
            return render_background(
                f"ambient/{name}",
                self.scenario,
                target=target,
                seed=self.seed + 1,
                progress=report,
            ).photograph

    def synthetic_photograph(self, image: NDArray[np.float64], samples: int) -> Array:
        """Path trace a photograph, (rows, columns, 3), of an image, (R, C, 3), on the monitor."""
        from periscopy_sim.rendering.photograph import render_photograph

        with fixable("photograph"), progress("path tracing the photograph") as report:
            return render_photograph(
                self.scenario, image, samples=samples, seed=self.seed, progress=report
            )

    def photograph(self, path: Path, mask: Mask | None = None) -> Photograph:
        """Read a photograph of the size that the scene's camera has."""
        from periscopy_sim.storage.photographs import read_photograph

        photograph = read_photograph(path, self.scenario.photograph_shape, mask)
        for warning in photograph.warnings:
            self.warn(warning)
        return photograph

    def companions(
        self, mask: Path | None, monitor_off: list[Path] | None
    ) -> tuple[Mask | None, dict[str, Array]]:
        """Read a mask, (rows, columns), and photographs with the monitor off, by file name."""
        from periscopy_sim.model.observation import checked_mask
        from periscopy_sim.storage.photographs import read_mask

        used = None if mask is None else read_mask(mask, self.scenario.photograph_shape)
        with fixable(str(mask)):
            used = None if used is None else checked_mask(used, self.scenario.transport_shape)
        files = list(map(str, monitor_off or []))
        if len(set(files)) < len(files):
            raise PhotographError(f"--monitor-off {', '.join(files)}: name each photograph once")
        return used, {file: self.photograph(Path(file), used).values for file in files}

    def wall(
        self,
        path: Path,
        mask: Path | None = None,
        monitor_off: list[Path] | None = None,
        **defects: Any,
    ) -> Photograph:
        """Read a photograph, its mask and its monitor-off photographs; see `without_defects`."""
        used, off = self.companions(mask, monitor_off)
        photograph = replace(self.photograph(path, used), monitor_off=off)
        return self.without_defects(photograph, str(path), **defects)

    def without_defects(
        self,
        photograph: Photograph,
        name: str,
        *,
        suggested: Path | str = "FILE",
        maskable: bool = True,
    ) -> Photograph:
        """Warn of a photograph's defects; return it black outside of its mask.

        Without a mask, the result has one that leaves out border lines that stand out, if the
        method is `maskable`. `suggested` is where `suggest_mask` will write its mask.
        """
        from periscopy_sim.photographs.border import BadBorder, bad_border
        from periscopy_sim.photographs.defects import defective_pixels

        values, used = photograph.values, photograph.mask
        border = bad_border(values) if used is None else BadBorder()
        sound = border.inside(photograph.shape) if used is None else used
        remedy = f"leave them out by --mask {suggested}"
        if border:
            lines = f"border lines that are far too dark or bright ({border})"
            if maskable:
                used = sound
                self.warn(f"{name}: left out {lines}; --mask replaces this choice")
            else:
                self.warn(f"{name}: {lines}; {remedy}")
        defects = defective_pixels(values, used)
        if defects.any_kind.any():
            self.warn(f"{name}: {defects}; {remedy}")
        self.sound = sound & ~defects.any_kind
        self._suggests = not self.sound[... if used is None else used].all()
        return replace(photograph, values=blackened(values, used), mask=used)

    def suggest_mask(self, folder: Path) -> None:
        """Write a mask that leaves out the defects of `without_defects`, if there are any."""
        from periscopy_sim.storage.pictures import write_png

        if self._suggests:
            mask = np.repeat(self.sound[..., np.newaxis], 3, axis=2)
            write_png(folder / SUGGESTED, mask, self.metadata)

    # -- fitting and writing ---------------------------------------------------------------------

    def fit(
        self,
        method: str,
        settings: Mapping[str, float],
        transport: TransportRequest,
        light: LightModel,
        wall: Photograph,
        uncertain: UncertainTransport | None = None,
        colour_matrix: ColourMatrix | None = None,
    ) -> Any:
        """Return a method fitted to the scene's A and B."""
        from periscopy_sim.evaluation.methods import fit_method
        from periscopy_sim.rendering.transport.bounced import channels_mean
        from periscopy_sim.storage.transport_matrix import record_of

        with self.timed("transport matrix"):
            check_memory(self.scenario, method)
            A = channels_mean(transport.matrix(self.scenario))
        with self.timed("prototype backgrounds"):
            B = light.matrix(self.scenario)
        place = str(transport.file or f"scene '{self.path}'")
        with (
            self.timed("fit the method"),
            progress(f"fitting {method}"),
            fixable(place, wall.monitor_off),
        ):
            fitted = fit_method(
                method, self.scenario, A, B, wall.mask, wall.monitor_off, uncertain, colour_matrix,
                **settings,
            )  # fmt: skip
        if transport.file is not None and not record_of(transport.file).is_file():
            warn(f"{transport.file} has no JSON file beside it: it may be of another scene")
        return fitted

    def write_summary(self, file: Path, values: Mapping[str, Any]) -> None:
        """Write a command's numbers as JSON, with sizes, warnings, seconds and provenance."""
        summary = {
            "photograph_shape": self.scenario.photograph_shape,
            "hidden_shape": self.scenario.hidden_shape,
            **values,
            "warnings": self.warnings,
            "seconds": self.timed.seconds,
            "provenance": self.provenance,
        }
        write_json(file, summary)
