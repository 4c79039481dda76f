"""What the commands are given: the scene, its transport matrix, photographs, masks."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli.arguments import parse_definitions, parse_size
from periscopy_sim.cli.output import Stopwatch, fixable, progress, warn
from periscopy_sim.errors import PeriscopyError, PhotographError

if TYPE_CHECKING:
    from periscopy_sim.photographs.checking import Photograph
    from periscopy_sim.photographs.defects import DefectivePixels
    from periscopy_sim.reconstruction.residual.residual import Residual
    from periscopy_sim.reconstruction.uncertain_scene.uncertain_transport import UncertainTransport
    from periscopy_sim.scenario import Array, Scenario

Mask = NDArray[np.bool_]
SUGGESTED = "mask.png"
"""Where a command that finds defective pixels writes a mask that leaves them out."""


class Model(StrEnum):
    """How the transport matrix is computed."""

    rendered = "rendered"
    analytic = "analytic"


ModelOption = Annotated[
    Model, typer.Option(help="A by shadow rays, or in closed form (planar scenes, convex parts).")
]


def load(name: str, hidden: str, definitions: list[str] | None) -> Scenario:
    """Load a scene from what a command was given."""
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.shipped import find_scene

    refuse_measurements(name)
    return load_scenario(find_scene(name), parse_size(hidden), parse_definitions(definitions))


def refuse_measurements(name: str) -> None:
    """Refuse measurements in the place of the scene that is made of them."""
    path = Path(name)
    if path.suffix.lower() in (".yaml", ".yml") and path.is_file():
        raise PeriscopyError(
            f"{path}: measurements are no scene yet; make one of them: periscopy lab {path} --out "
            f"{path.with_suffix('.xml').name}"
        )


def warn_of_long_patches(scenario: Scenario, name: str) -> list[str]:
    """Warn where rows and columns look interchanged; return that line, if any."""
    rows, columns = scenario.hidden_shape
    across, up = (
        float(np.linalg.norm(edges, axis=1).mean())
        for edges in (scenario.patch_across, scenario.patch_up)
    )
    turned = abs(np.log((across * columns / rows) / (up * rows / columns)))
    if np.exp(abs(np.log(across / up))) < LONG or turned > abs(np.log(across / up)) / 2:
        return []
    told = (
        f"{name}: --hidden {rows}x{columns} makes patches of {1e3 * across:.3g} mm across and "
        f"{1e3 * up:.3g} mm up; rows come first: is {columns}x{rows} meant?"
    )
    warn(told)
    return [told]


LONG = 1.5
"""Sides of a patch, one over the other, from which its grid may be turned."""


def warn_without_shadows(scenario: Scenario, name: str) -> list[str]:
    """Warn where no occluder casts a shadow into the camera's view; return that line, if any."""
    from periscopy_sim.rendering.shadow_check import shadow_doubt

    doubt = shadow_doubt(scenario)
    if doubt:
        warn(f"{name}: {doubt}")
    return [f"{name}: {doubt}"] if doubt else []


def warn_of_occluders(scenario: Scenario, name: str) -> None:
    """Warn where no occluder casts a shadow; else of those whose size looks like a wrong unit."""
    from periscopy_sim.rendering.shadow_check import size_doubts

    if not warn_without_shadows(scenario, name):
        for doubt in size_doubts(scenario):
            warn(f"{name}: {doubt}")


# -- the transport matrix ------------------------------------------------------------------------

TOLD_MEMORY = 2e9
"""Bytes from which they are told beforehand."""


def check_memory(scenario: Scenario, method: str | None = None) -> None:
    """Tell how much memory A and what is fitted to it need; refuse what cannot be had."""
    from periscopy_sim.numerics.memory import available_memory, has_memory, transport_memory
    from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

    pixels, patches = scenario.transport_shape
    entry = METHODS.get(method or DEFAULT, METHODS[DEFAULT])
    per_entry = 4 if method is None else entry.bytes_per_entry
    needed = transport_memory(pixels, patches, per_entry)
    told = f"{pixels} pixels x {patches} patches need about {needed / 1e9:.1f} GB of memory"
    if not has_memory(needed):
        thrifty = min(METHODS.values(), key=lambda each: each.bytes_per_entry)
        would_do = has_memory(transport_memory(pixels, patches, thrifty.bytes_per_entry))
        other = f", or take --method {thrifty.name}" if method is not None and would_do else ""
        raise PeriscopyError(
            f"{told}, where {(available_memory() or 0) / 1e9:.1f} GB can be had; average pixels by "
            f"periscopy prepare --bin, ask for fewer patches by --hidden{other}"
        )
    if needed > TOLD_MEMORY:
        print(f"periscopy: {told}", file=sys.stderr, flush=True)


def render_transport(
    scenario: Scenario, samples: int, seed: int, model: Model = Model.rendered
) -> NDArray[np.float32]:
    """Compute A with a progress bar."""
    if model is Model.analytic:
        from periscopy_sim.analytic.transport import analytic_transport

        with progress("projecting shadows") as report:
            return analytic_transport(scenario, samples=samples, progress=report)
    from periscopy_sim.rendering.transport import shadow_rays

    with progress("rendering the transport matrix") as report:
        return shadow_rays.render_transport(scenario, samples=samples, seed=seed, progress=report)


def fit(
    method: str,
    settings: Mapping[str, float],
    scenario: Scenario,
    used: Mask | None,
    dark: Mapping[str, Array],
    timed: Stopwatch,
    *,
    matrix: Path | None,
    samples: int,
    seed: int,
    model: Model,
    uncertain: UncertainTransport | None = None,
) -> tuple[Any, NDArray[np.float32], dict[str, Any]]:
    """Fit a method to a scene's B and A, from a file or computed; return it, A and A's origin."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.evaluation.methods import fit_method

    with timed("transport matrix"):
        check_memory(scenario, method)
        if matrix is None:
            A = render_transport(scenario, samples, seed, model)
            origin: dict[str, Any] = {"model": model.value, "transport": None, "samples": samples}
        else:
            A = read_transport(matrix, scenario)
            origin = {"model": "file", "transport": matrix, "samples": None}
    place = str(matrix or f"scene '{scenario.path}'")
    with timed("fit the method"), progress(f"fitting {method}"), fixable(place, dark):
        B = point_light_backgrounds(scenario)
        fitted = fit_method(method, scenario, A, B, used, dark, uncertain, **settings)
    if matrix is not None and not matrix.with_suffix(".json").is_file():
        warn(f"{matrix} has no JSON file beside it: it may be of another scene of this size")
    return fitted, A, origin


def read_transport(path: Path, scenario: Scenario) -> NDArray[np.float32]:
    """Read a matrix, (M, N), that `periscopy transport` wrote, and check that it fits the scene.

    Without the JSON file that was written beside it, only the shapes can be compared.
    """
    from periscopy_sim.photographs.checking import check_real
    from periscopy_sim.storage.formats.decoding import decoding
    from periscopy_sim.storage.formats.table import format_of

    if format_of(path).name != "NPY":
        raise PhotographError(f"{path}: is no NPY file; make one by `periscopy transport`")
    with decoding(path, "NPY"):
        # Mapped, not read: it may be large, and its shape is told by the header.
        A: NDArray[np.float32] = np.load(path, mmap_mode="r", allow_pickle=False)
    check_real(A.dtype, str(path))
    if A.shape != scenario.transport_shape:
        raise PhotographError(
            f"{path}: holds a matrix of shape {A.shape}; the scene's camera and hidden size need "
            f"{scenario.transport_shape}"
        )
    if not np.isfinite(A).all():
        raise PhotographError(f"{path}: holds NaN or infinities; render the matrix again")
    _check_record(path, scenario)
    return A


def _check_record(path: Path, scenario: Scenario) -> None:
    """Compare the JSON beside a matrix with the scene it shall serve."""
    record_file = path.with_suffix(".json")
    if not record_file.is_file():
        return
    try:
        record = json.loads(record_file.read_text())
        held = {name: record[name] for name in ("scene_sha256", "parameters", "hidden_shape")}
    except (ValueError, KeyError, TypeError, OSError):
        raise PhotographError(f"{record_file}: is damaged; render the matrix again") from None
    from periscopy_sim.storage.outputs.provenance import scene_sha256

    wanted = {
        "scene_sha256": scene_sha256(scenario.path, scenario.parameters),
        "parameters": dict(scenario.parameters),
        "hidden_shape": list(scenario.hidden_shape),
    }
    for name, value in wanted.items():
        if held[name] != value:
            raise PhotographError(
                f"{path}: was made from another scene ({name.replace('_', ' ')} {held[name]}, here "
                f"{value}); render it again"
            )


# -- images and masks ----------------------------------------------------------------------------


def hidden_image(name: str, hidden_shape: tuple[int, int]) -> NDArray[np.float64]:
    """Read a hidden image, (R, C, 3): a file, or a shipped one by its name."""
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.pictures import read_hidden_image

    return read_hidden_image(find_image(name), hidden_shape)


def read_mask(path: Path | None, scenario: Scenario) -> Mask | None:
    """Read the mask that a command was given, (rows, columns); None if it was given none."""
    from periscopy_sim.reconstruction.observation import checked_mask
    from periscopy_sim.storage import photographs

    if path is None:
        return None
    if not path.exists():
        beside = [
            other
            for other in (path.with_name(f"{path.stem}_mask.png"), path.with_name("mask.png"))
            if other.is_file()
        ]
        if beside:
            raise PhotographError(f"{path}: no such file; there is {beside[0]}: is that meant?")
    mask = photographs.read_mask(path, scenario.photograph_shape)
    with fixable(str(path)):
        return checked_mask(mask, scenario.transport_shape)


def read_photograph(path: Path, scenario: Scenario, mask: Mask | None = None) -> Photograph:
    """Read a photograph of the size that the scene's camera sees, and print its warnings."""
    from periscopy_sim.storage import photographs

    try:
        given = photographs.read_photograph(path, scenario.photograph_shape, mask)
    except PhotographError as error:
        if mask is not None or "by a mask" not in str(error):
            raise
        beside = path.with_name(f"{path.stem}_mask.png")
        if beside.is_file():
            raise PhotographError(f"{error}, such as --mask {beside}") from None
        raise
    for warning in given.warnings:
        warn(warning)
    return given


def read_backgrounds(
    paths: list[Path] | None, scenario: Scenario, mask: Mask | None = None
) -> dict[str, Array]:
    """Read photographs with the monitor off, by the names of their files; print their warnings."""
    backgrounds: dict[str, Array] = {}
    for path in paths or []:
        if str(path) in backgrounds:
            raise PhotographError(f"--background {path} is given twice")
        backgrounds[str(path)] = read_photograph(path, scenario, mask).values
    return backgrounds


@dataclass(frozen=True, eq=False)
class Defects:
    """What of a photograph measures no light of the wall, where a mask does not leave it out."""

    pixels: DefectivePixels
    used: Mask | None
    """(rows, columns), the mask that the command was given; without one, all but a bad border."""
    sound: Mask
    """(rows, columns), what is used and has no defect."""
    warnings: Sequence[str]
    """A line of each kind, if there are any."""

    def else_warned(self, residual: Residual | None) -> str:
        """Return what a residual warns of, unless these pixels are the likeliest cause; or none."""
        if residual is None or (self.pixels.any_kind.any() and residual.likeliest == "pixels"):
            return ""
        return residual.warning

    def suggest_mask(self, folder: Path, text: Mapping[str, str]) -> None:
        """Write a mask that leaves them out too, if any are used."""
        from periscopy_sim.storage.pictures import write_png

        if not self.sound[... if self.used is None else self.used].all():
            write_png(folder / SUGGESTED, np.repeat(self.sound[..., np.newaxis], 3, axis=2), text)


def look_for_defects(
    photograph: Array,
    mask: Mask | None,
    name: str,
    suggested: Path | None = None,
    *,
    maskable: bool = True,
) -> Defects:
    """Look for defects of a photograph, (rows, columns, 3), and warn of them.

    A border that stands out is not used, where no mask says what is and the method is `maskable`;
    else it is warned of. `suggested` is where a mask that leaves all of them out will be.
    """
    from periscopy_sim.photographs.border import bad_border
    from periscopy_sim.photographs.defects import defective_pixels

    remedy = f"leave them out by --mask {suggested or 'FILE'}"
    border = bad_border(photograph, mask)
    inside = border.inside(photograph.shape[:2])
    sound = inside if mask is None else mask & inside
    used, warnings = mask, []
    if border:
        outstanding = f"{border}, darker or brighter all along than the light farther inside"
        if mask is None and maskable:
            used = inside
            warnings.append(f"{name}: left out {outstanding}; --mask takes exactly what it shows")
        else:
            warnings.append(f"{name}: {outstanding}; {remedy}")
    found = defective_pixels(photograph, used)
    if found.any_kind.any():
        warnings.append(f"{name}: {found}; {remedy}")
    for warning in warnings:
        warn(warning)
    return Defects(found, used, sound & ~found.any_kind, warnings)


def mask_record(path: Path | None, mask: Mask | None) -> dict[str, Any]:
    """Return what a summary tells of what was left out."""
    return {"mask": path, "pixels_left_out": 0 if mask is None else np.count_nonzero(~mask)}


def photograph(
    scenario: Scenario, image: NDArray[np.float64], samples: int, seed: int
) -> NDArray[np.float64]:
    """Path trace a photograph with a progress bar."""
    from periscopy_sim.rendering.photograph import render_photograph

    with fixable("photograph"), progress("path tracing the photograph") as report:
        return render_photograph(scenario, image, samples=samples, seed=seed, progress=report)


def provenance_of(scenario: Scenario, seed: int | None) -> dict[str, Any]:
    """Record versions, scene, variant, seed and command line."""
    import mitsuba as mi

    from periscopy_sim.storage.outputs.provenance import provenance

    command = ["periscopy", *sys.argv[1:]]
    record = provenance(scenario.path, mi.variant(), seed, command, scenario.parameters)
    return {**record, "parameters": dict(scenario.parameters)}
