"""One run of a command on a scene: it reads, checks, times, fits and writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.cli import inputs
from periscopy_sim.cli.inputs import Defects, Mask
from periscopy_sim.cli.light import LightModel, TransportRequest, check_memory
from periscopy_sim.cli.options import parse_definitions, parse_size
from periscopy_sim.cli.output import Stopwatch, fixable, progress, warn, write_json
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text

if TYPE_CHECKING:
    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.scenario import Array, Scenario


@dataclass(frozen=True, eq=False)
class WallInput:
    """A photograph of the wall, black where its mask leaves the wall out, and its companions."""

    values: Array  # (rows, columns, 3), linear light
    mask: Mask | None  # (rows, columns); None where all of the wall is used
    monitor_off: Mapping[str, Array]  # (rows, columns, 3) each, by the names of their files
    defects: Defects
    record: Mapping[str, Any]  # the entries of a summary


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
    """

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
            return inputs.load(self.name, self._hidden, self._define)

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Versions, scene, variant, seed and command line."""
        return inputs.provenance_of(self.scenario, self.seed)

    @property
    def metadata(self) -> dict[str, str]:
        """The provenance as text, for the metadata of pictures."""
        return as_text(self.provenance)

    def check_scene(self, method: str | None = None) -> None:
        """Reject a scene that a method cannot work with; warn where it shows little."""
        from periscopy_sim.evaluation.methods import check_able

        if method is not None:
            check_able(method, self.scenario.hidden_shape)
        self.warnings += inputs.warn_without_shadows(self.scenario, self.name)

    def warn(self, line: str) -> None:
        """Print a warning, and keep it for the summary."""
        warn(line)
        self.warnings.append(line)

    # -- reading ---------------------------------------------------------------------------------

    def hidden_image(self, name: str) -> NDArray[np.float64]:
        """Read a hidden image, (R, C, 3), of the session's patches."""
        return inputs.hidden_image(name, self.scenario.hidden_shape)

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

    def wall(
        self,
        path: Path,
        mask: Path | None = None,
        monitor_off: list[Path] | None = None,
        *,
        suggested: Path | None = None,
        maskable: bool = True,
    ) -> WallInput:
        """Read a photograph with its mask and monitor-off photographs, and look for defects."""
        used = inputs.read_mask(mask, self.scenario)
        photograph = inputs.read_photograph(path, self.scenario, used)
        off = inputs.read_backgrounds(monitor_off, self.scenario, used)
        self.warnings += photograph.warnings
        return self.checked_wall(
            photograph.values, str(path), mask, used, off, suggested=suggested, maskable=maskable
        )

    def checked_wall(
        self,
        values: Array,
        name: str,
        mask: Path | None,
        used: Mask | None,
        off: Mapping[str, Array],
        *,
        suggested: Path | None = None,
        maskable: bool = True,
    ) -> WallInput:
        """Look for the defects of a photograph that was read; its border may be left out."""
        from periscopy_sim.photograph import blackened

        defects = inputs.look_for_defects(values, used, name, suggested, maskable=maskable)
        self.warnings += defects.warnings
        record = {**inputs.mask_record(mask, defects.used), "backgrounds": list(off)}
        seen = blackened(values, defects.used)
        return WallInput(seen, defects.used, off, defects, record)

    # -- fitting and writing ---------------------------------------------------------------------

    def fit(
        self,
        method: str,
        settings: Mapping[str, float],
        transport: TransportRequest,
        light: LightModel,
        wall: WallInput,
        uncertain: UncertainTransport | None = None,
    ) -> tuple[Any, NDArray[np.float32]]:
        """Fit a method to the scene's A and B; return it and A, the channels' mean."""
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
                method, self.scenario, A, B, wall.mask, wall.monitor_off, uncertain, **settings
            )
        if transport.file is not None and not record_of(transport.file).is_file():
            warn(f"{transport.file} has no JSON file beside it: it may be of another scene")
        return fitted, A

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
