"""`periscopy prepare`: any camera's photograph in the pixels of a scene's camera."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.options import number, option
from periscopy_sim.cli.output import fixable, progress, say, say_written, warn
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.figures.display import save_png
from periscopy_sim.figures.panels import enlarged
from periscopy_sim.photographs import film_size
from periscopy_sim.photographs.develop import average, black_level_warning, develop
from periscopy_sim.photographs.placing import place_film
from periscopy_sim.photographs.sensor_image import mask_of_pixels
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file
from periscopy_sim.storage.photographs import read_mask, read_sensor_image
from periscopy_sim.storage.pictures import write_png
from periscopy_sim.storage.tables import read_wall_points, read_wall_tags

if TYPE_CHECKING:
    from periscopy_sim.photograph import Mask
    from periscopy_sim.photographs.sensor_image import SensorImage

FILM_SIZES = (
    ("height", "width"), ("rows", "columns"), ("film_height", "film_width"),
    ("resolution_y", "resolution_x"), ("resolution", "resolution"),
)  # fmt: skip
"""Possible names of the <default>s for the rows and columns of a scene's film."""

Files = list[Path] | None


def prepare(
    photos: Annotated[
        list[Path],
        typer.Argument(metavar="PHOTO...", help="Photographs, averaged, or merged by --exposures."),
    ],
    scene: options.SceneOption,
    out: options.OutFile,
    black: Annotated[float, number("Black level of the camera, subtracted.", form="VALUE")] = 0.0,
    dark: Annotated[
        Files, option("FILE", "Photograph with the lens covered, subtracted; repeatable.")
    ] = None,
    flat: Annotated[
        Files, option("FILE", "Photograph of an evenly lit white surface, divided by; repeatable.")
    ] = None,
    white: Annotated[
        float | None, number("Saturation value. [default: from the file]", form="VALUE")
    ] = None,
    exposures: Annotated[
        str | None, option("T1,T2,...", "Exposure times of photographs to merge.")
    ] = None,
    points: Annotated[
        Path | None, option("FILE.csv", "Points of the wall to rectify by: column,row,x,y,z.")
    ] = None,
    tags: Annotated[
        Path | None, option("FILE.csv", "AprilTag or ArUco markers to rectify by: id,x,y,z,size.")
    ] = None,
    mask: Annotated[
        Path | None,
        option("FILE", "Picture of the photograph's or film's size, black off wall."),
    ] = None,
    bin_by: Annotated[
        str | None, option("auto|K", "Set the film to blocks of K x K pixels.", "--bin")
    ] = None,
    hidden: Annotated[str, option("ROWSxCOLUMNS", "Patches for --bin auto.")] = "29x36",
    define: options.Define = None,
) -> None:
    """Bring a camera's photograph to the scene's pixels.

    The command writes NAME.exr; NAME_mask.png, which leaves out saturated pixels, tags and pixels
    outside of the photograph; and NAME_preview.png, black outside of the mask.
    """
    options.require_suffix(out, ".exr", "the photograph")
    session = Session(scene, "1x1", define)
    if points is not None and tags is not None:
        raise PeriscopyError("--points and --tags exclude each other; give one")
    if min(patches := options.parse_size(hidden)) < 1:
        raise PeriscopyError(f"--hidden {hidden}: give one patch at least")
    with fixable("--exposures"):
        times = None if exposures is None else [float(each) for each in exposures.split(",")]
    written = out, *(out.with_name(f"{out.stem}_{what}.png") for what in ("mask", "preview"))
    given_files = *photos, *(dark or ()), *(flat or ()), mask, points, tags, session.path
    spare_inputs(written, given_files)
    with ExitStack() as stack:
        staged = [stack.enter_context(staged_file(path)) for path in written]
        scenario = session.scenario
        with progress("reading the photograph"):
            light, used = _developed(photos, black, dark, flat, white, times, mask)
        on_wall = read_wall_points(points) if points else None
        tags_on_wall = read_wall_tags(tags) if tags else None
        film: dict[str, str] = {}
        if bin_by is not None:
            shape = _film(light, scenario, patches, bin_by, on_wall or tags_on_wall)
            film = _film_definitions(scenario, shape, session.definitions)
            more = [f"{name}={value}" for name, value in film.items()]
            session = Session(scene, "1x1", [*(define or []), *more])
            scenario = session.scenario
        with progress("averaging its pixels"):
            prepared = ps.prepare(light, scenario, points=on_wall, tags=tags_on_wall, mask=used)
        session.check_scene()
        for warning in prepared.warnings:
            warn(f"{photos[0]}: {warning}")
        text = as_text({
            "photographs": _listed(photos),
            "photographs_sha256": ", ".join(map(_sha256, photos)),
            "black": black, "dark": _listed(dark), "flat": _listed(flat), "white": white,
            "exposures": exposures, "points": points, "tags": tags, "mask": mask, "bin": bin_by,
            **_record(prepared),
            **session.provenance,
        })  # fmt: skip
        write_exr(staged[0], prepared.values, text)
        write_png(staged[1], np.repeat(prepared.mask[..., np.newaxis], 3, axis=2), text)
        save_png(staged[2], enlarged(prepared.values), text=text)
    _say_prepared(prepared, light.size)
    say_written(*written)
    if film:
        definitions = " ".join(f"-D {name}={value}" for name, value in film.items())
        say(f"the scene's film has this size with {definitions}: give it with every command")


def _developed(
    photos: Sequence[Path],
    black: float,
    dark: Sequence[Path] | None,
    flat: Sequence[Path] | None,
    white: float | None,
    times: Sequence[float] | None,
    mask: Path | None,
) -> tuple[SensorImage, Mask | None]:
    """Read the photographs into one picture of linear light, and the mask."""

    def pictures(paths: Sequence[Path]) -> Iterator[SensorImage]:
        for path in paths:
            exposure, warnings = read_sensor_image(path, white, has_black=bool(black))
            for warning in warnings:
                warn(warning)
            yield exposure

    offset = average(pictures(dark), f"the dark frame {dark[-1]}") if dark else None
    even = average(pictures(flat), f"the flat field {flat[-1]}") if flat else None
    taken = pictures(photos)
    first = next(taken)
    used = None if mask is None else read_mask(mask)
    on_photograph = None
    if used is not None and max(used.shape) >= max(first.size):  # smaller ones are the film's
        on_photograph = mask_of_pixels(used, first)
    every = chain([first], taken)
    light = develop(every, times=times, black=black, dark=offset, flat=even, mask=on_photograph)
    if warning := black_level_warning(light, on_photograph, "the black level or the dark frame"):
        warn(f"{photos[0]}: {warning}")
    return light, used


def _listed(paths: Sequence[Path] | None) -> str | None:
    return ", ".join(map(str, paths)) if paths else None


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _film(
    light: SensorImage,
    scenario: ps.Scenario,
    patches: tuple[int, int],
    by: str,
    marks: ps.WallPoints | ps.WallTags | None,
) -> tuple[int, int]:
    """Return (rows, columns) of the film for --bin auto or --bin SIDE."""
    factor = int(by) if by.isascii() and by.isdigit() and len(by) < 5 else 0
    if by != "auto" and not factor:
        raise PeriscopyError(f"--bin '{by}' is neither auto nor a whole number; write --bin 8")
    shape = rows, columns = scenario.photograph_shape
    if marks is not None:
        placed = place_film(light, scenario, marks)
        side = np.sqrt(placed.coverage)
        if factor:
            films = film_size.films_of_shape(shape, side)
            return min(films, key=lambda film: abs(film[0] - rows * side / factor))
        sizes = film_size.films_of_marks(shape, placed.coverage, placed.placement)
        return film_size.advise(scenario, patches).choose(sizes)
    blocks = film_size.films_of_blocks(light.size)
    if (factor and factor not in blocks) or rows * light.size[1] != columns * light.size[0]:
        raise PeriscopyError(
            f"--bin: {light.size[0]} x {light.size[1]} pixels do not divide into the scene's "
            f"{rows} x {columns} by blocks with a side of {', '.join(map(str, blocks))}; crop the "
            "photograph, or change the scene's film"
        )
    if factor:
        return blocks[factor]
    return film_size.advise(scenario, patches).choose(list(blocks.values()))


def _film_definitions(
    scenario: ps.Scenario, shape: tuple[int, int], given: dict[str, str]
) -> dict[str, str]:
    """Return the scene's <default>s that set its film to (rows, columns)."""
    declared = read_document(scenario.path).defaults.keys()
    for names in FILM_SIZES:
        film = dict(zip(names, map(str, shape), strict=True))
        if film.keys() <= declared and (len(film) == 2 or shape[0] == shape[1]):
            if film.keys() & given.keys():
                raise PeriscopyError(f"--bin and -D both set {' and '.join(film)}; give one")
            return film
    raise PeriscopyError(
        f"--bin: scene '{scenario.path}' declares no <default> for its film's size; declare width "
        "and height, and use $width and $height in its film"
    )


def _say_prepared(prepared: ps.Prepared, size: tuple[int, int]) -> None:
    """Print how well marks place the scene's pixels, and what the mask leaves out."""
    if (fit := prepared.view) is not None:
        rms = f"{fit.rms:.2f} pixels of the photograph ({1e3 * fit.rms_on_wall:.2g} mm on the wall)"
        fits = f"fit to {rms} rms" if fit.freedom else "are as many as the view needs"
        say(f"{len(fit.marks)} marks {fits}, film pixels placed to {prepared.placement:.2f} of one")
    rows, columns = prepared.mask.shape
    say(
        f"{size[0]}x{size[1]} pixels averaged to {rows}x{columns}: {prepared.coverage:.3g} in "
        f"each, {prepared.defects} dead or hot; the mask leaves out "
        f"{np.count_nonzero(~prepared.mask)} of {prepared.mask.size}"
    )


def _record(prepared: ps.Prepared) -> dict[str, Any]:
    """Return the metadata of the view and the pixels left out."""
    record: dict[str, Any] = {
        "pixels_left_out": int(np.count_nonzero(~prepared.mask)),
        "defects_left_out": prepared.defects,
        "coverage": prepared.coverage,
    }
    if (fit := prepared.view) is not None:
        record |= {
            "view_placement": prepared.placement,
            "view_residual_pixels": fit.rms,
            "view_residual_metres": fit.rms_on_wall,
            "view_distortion": " ".join(map(repr, fit.view.distortion)) or "none",
            "view_homography": " ".join(map(repr, fit.view.homography.ravel().tolist())),
        }
    return record
