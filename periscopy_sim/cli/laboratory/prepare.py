"""`periscopy prepare`: any camera's photograph in the pixels of a scene's camera."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import inputs
from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.laboratory.prepared import tell_prepared, view_record
from periscopy_sim.cli.options import option
from periscopy_sim.cli.output import progress, say, say_written, warn
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.photographs.developing.sensor_image import SensorImage
    from periscopy_sim.photographs.film.size import FilmAdvice
    from periscopy_sim.scenario import Scenario

FILM_SIZES = (
    ("height", "width"), ("rows", "columns"), ("film_height", "film_width"),
    ("resolution_y", "resolution_x"), ("resolution",),
)  # fmt: skip
"""Names that a scene's <default>s for the rows and columns of its film may have."""

Photos = Annotated[
    list[Path],
    typer.Argument(
        metavar="PHOTO...",
        help="Camera raw, TIFF, PNG, JPEG, EXR, NPY, NPZ (key photograph) or MATLAB raw, of any "
        "size; several are averaged, or merged by --exposures.",
    ),
]


def prepare(
    photos: Photos,
    scene: arguments.SceneOption,
    out: arguments.OutFile,
    black: Annotated[
        float,
        option(
            "VALUE",
            "The camera's black level, taken off. Raw files tell theirs.",
            callback=arguments.not_nan,
        ),
    ] = 0.0,
    dark: Annotated[
        list[Path] | None,
        option("FILE", "A photograph with the lens covered, taken off; repeatable, averaged."),
    ] = None,
    flat: Annotated[
        list[Path] | None,
        option(
            "FILE",
            "A photograph of an evenly lit white surface, same lens, to divide by; repeatable.",
        ),
    ] = None,
    white: Annotated[
        float | None,
        option(
            "VALUE",
            "Pixels are saturated from this value on. [default: as the file shows]",
            callback=arguments.not_nan,
        ),
    ] = None,
    exposures: Annotated[
        str | None,
        option("T1,T2,...", "Exposure times of the photographs, which are merged to one."),
    ] = None,
    points: Annotated[
        Path | None,
        option(
            "FILE.csv",
            "Rectify by points of the wall: rows column,row,x,y,z, pixels (the first one's centre "
            "is 0.5,0.5) and metres; four or more, seven or more for the lens's distortion.",
        ),
    ] = None,
    tags: Annotated[
        Path | None,
        option(
            "FILE.csv",
            "Rectify by AprilTag or ArUco markers on the wall: rows id,x,y,z,size, the middle and "
            "the side of the black square in metres; two or more, turned in any way.",
        ),
    ] = None,
    mask: Annotated[
        Path | None,
        option(
            "FILE", "A grey picture of the photograph's or the film's size, black what is not wall."
        ),
    ] = None,
    bin_by: Annotated[
        str | None,
        option(
            "auto|K",
            "Set the scene's film so that a pixel covers K x K of the photograph, or as the "
            "shadows need. [default: the film of the scene]",
            "--bin",
        ),
    ] = None,
    hidden: Annotated[
        str, option("ROWSxCOLUMNS", "Patches that --bin auto and the advice are for.")
    ] = "29x36",
    define: arguments.Define = None,
) -> None:
    """Bring a camera's photograph to the scene's pixels.

    It is written as an EXR file, NAME.exr. Beside it, NAME_mask.png leaves out what lies outside of
    the photograph, what is saturated in every exposure, and the tags; NAME_preview.png is to look
    at, black where the mask is.
    """
    from periscopy_sim.figures.display import save_png
    from periscopy_sim.figures.panels import enlarged
    from periscopy_sim.photographs.film.size import advise
    from periscopy_sim.photographs.prepare import prepare as prepared_from
    from periscopy_sim.storage.formats.exr import write_exr
    from periscopy_sim.storage.pictures import write_png

    arguments.require_suffix(out, ".exr", "the photograph")
    if points is not None and tags is not None:
        raise PeriscopyError("--points and --tags both tell the view; give one of them")
    patches = arguments.parse_size(hidden)
    if min(patches) < 1:
        raise PeriscopyError(f"--hidden {hidden}: a hidden image has one patch at least")
    times = None if exposures is None else _times(exposures, photos)
    factor = None if bin_by is None else _factor(bin_by)
    mask_file, preview = (out.with_name(f"{out.stem}_{what}.png") for what in ("mask", "preview"))
    given_files = *photos, *(dark or ()), *(flat or ()), mask, points, tags, find_scene(scene)
    spare_inputs((out, mask_file, preview), given_files)
    with (
        staged_file(out) as staged,
        staged_file(mask_file) as staged_mask,
        staged_file(preview) as staged_preview,
    ):
        with progress("reading the scene and the photograph") as report:
            scenario = inputs.load(scene, "1x1", define)
            light, used = _developed(photos, black, dark, flat, white, times, mask, report)
        marks = _marks(points, tags)
        advice = advise(scenario, patches)
        given: dict[str, str] = {}
        if factor is not None:
            given = _film_definitions(
                scenario, _film(light, scenario, advice, factor, marks), define
            )
            more = [f"{name}={value}" for name, value in given.items()]
            scenario = inputs.load(scene, "1x1", [*(define or []), *more])
        with progress("averaging its pixels"):
            found = prepared_from(light, scenario, mask=used, **marks)
        shadowless = inputs.warn_without_shadows(scenario, scene)
        for warning in found.warnings:
            warn(f"{photos[0]}: {warning}")
        record = {
            "photographs": ", ".join(map(str, photos)),
            "photographs_sha256": ", ".join(map(_sha256, photos)),
            "black": black, "dark": _listed(dark), "flat": _listed(flat), "white": white,
            "exposures": exposures, "points": points, "tags": tags, "mask": mask, "bin": bin_by,
            **view_record(found),
            **inputs.provenance_of(scenario, None),
        }  # fmt: skip
        text = as_text(record)
        write_exr(staged, found.values, text)
        write_png(staged_mask, np.repeat(found.mask[..., np.newaxis], 3, axis=2), text)
        save_png(staged_preview, enlarged(found.values), text=text)
    tell_prepared(found, advice, light.size, casts=not shadowless)
    say_written(out, mask_file, preview)
    if given:
        definitions = " ".join(f"-D {name}={value}" for name, value in given.items())
        say(f"the scene's film has this size with {definitions}: give it with every command")


def _developed(
    photos: Sequence[Path],
    black: float,
    dark: Sequence[Path] | None,
    flat: Sequence[Path] | None,
    white: float | None,
    times: Sequence[float] | None,
    mask: Path | None,
    report: Any,
) -> tuple[SensorImage, inputs.Mask | None]:
    """Read the photographs, and make one picture of linear light of them."""
    from periscopy_sim.photographs.developing.calibration_frames import (
        black_level_doubt,
        dark_frame_doubt,
    )
    from periscopy_sim.photographs.developing.develop import develop
    from periscopy_sim.photographs.developing.exposures import average
    from periscopy_sim.photographs.developing.sensor_image import mask_of_pixels
    from periscopy_sim.storage.photographs import read_mask, read_sensor_image

    for flag, frames in (("--dark", dark), ("--flat", flat)):
        for frame, photo in product(frames or (), photos):
            if _same_file(frame, photo):
                raise PeriscopyError(f"{flag} {frame}: is the photograph itself; give another")
    count = len(photos) + len(dark or ()) + len(flat or ())
    done = 0

    def taken(paths: Sequence[Path]) -> Iterator[SensorImage]:
        nonlocal done
        for path in paths:
            exposure, warnings = read_sensor_image(path, white, has_black=bool(black))
            for warning in warnings:
                warn(warning)
            done += 1
            report(done / count)
            yield exposure

    offset = average(taken(dark), f"the dark frame {dark[-1]}") if dark else None
    even = average(taken(flat), f"the flat field {flat[-1]}") if flat else None
    first = next(iter(photographs := taken(photos)))
    used = None if mask is None else read_mask(mask)
    on_photograph = None
    if used is not None and max(used.shape) >= max(first.size):  # smaller ones are the film's
        on_photograph = mask_of_pixels(used, first)

    def all_of_them() -> Iterator[SensorImage]:
        yield first
        yield from photographs

    light = develop(
        all_of_them(), times=times, black=black, dark=offset, flat=even, mask=on_photograph
    )
    by = f"--black {black:g}" if black else f"--dark {_listed(dark)}" if dark else "the file"
    if doubt := black_level_doubt(light, on_photograph, by):
        warn(f"{photos[0]}: {doubt}")
    if dark and offset is not None and (doubt := dark_frame_doubt(offset, first)):
        warn(f"{_listed(dark)}: {doubt}")
    return light, used


def _marks(points: Path | None, tags: Path | None) -> dict[str, Any]:
    from periscopy_sim.storage.wall_marks import read_wall_points, read_wall_tags

    if points is not None:
        return {"points": read_wall_points(points)}
    return {} if tags is None else {"tags": read_wall_tags(tags)}


def _times(text: str, photos: Sequence[Path]) -> list[float]:
    """Read exposure times, as many as there are photographs."""
    try:
        times = [float(each) for each in text.split(",")]
    except ValueError:
        times = []
    if len(times) != len(photos) or not all(0 < time < np.inf for time in times):
        raise PeriscopyError(
            f"--exposures '{text}': give {len(photos)} positive times separated by commas, one for "
            "each photograph"
        )
    return times


def _factor(text: str) -> int:
    """Read the side of a block; 0 stands for auto."""
    if text == "auto":
        return 0
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 10**4):
        raise PeriscopyError(f"--bin '{text}' is neither auto nor a whole number; write --bin 8")
    return int(text)


# -- the film's size -----------------------------------------------------------------------------


def _film(
    light: SensorImage,
    scenario: Scenario,
    advice: FilmAdvice,
    factor: int,
    marks: Mapping[str, Any],
) -> tuple[int, int]:
    """Return the (rows, columns) of the film that was asked for."""
    from periscopy_sim.photographs.film.placing import place_film
    from periscopy_sim.photographs.film.size import films_of_blocks, films_of_marks, films_of_shape

    if marks:
        own = scenario.photograph_shape
        placed = place_film(light, scenario, **marks)
        if not factor:
            return advice.choose(films_of_marks(own, placed.coverage, placed.placement))
        side = np.sqrt(placed.coverage)
        return min(
            films_of_shape(own, side), key=lambda each: abs(each[0] - own[0] * side / factor)
        )
    films = films_of_blocks(light.size)
    if factor and factor not in films:
        raise PeriscopyError(
            f"--bin {factor}: blocks of that side do not fill {light.size[0]} x {light.size[1]} "
            f"pixels; give one of {', '.join(map(str, films))}, or crop the photograph"
        )
    height, width = scenario.photograph_shape
    if height * light.size[1] != width * light.size[0]:
        raise PeriscopyError(
            f"--bin: {light.size[0]} x {light.size[1]} pixels (rows x columns) have other "
            f"proportions than the {height} x {width} of the scene's camera; let its film have "
            "the photograph's"
        )
    return films[factor] if factor else advice.choose(list(films.values()))


def _film_definitions(
    scenario: Scenario, shape: tuple[int, int], define: list[str] | None
) -> dict[str, str]:
    """Return the values of the scene's <default>s that give its film a size of (rows, columns)."""
    from periscopy_sim.rendering.scene.document import read_document

    declared = read_document(scenario.path).defaults
    chosen = arguments.parse_definitions(define)
    for names in FILM_SIZES:
        if set(names) <= declared.keys() and (len(names) == 2 or shape[0] == shape[1]):
            if set(names) & chosen.keys():
                raise PeriscopyError(
                    f"--bin sets {' and '.join(names)}, which -D sets, too; leave one of them out"
                )
            return dict(zip(names, map(str, shape), strict=False))
    raise PeriscopyError(
        f"--bin: scene '{scenario.path}' declares no <default> for its film's size; write <default "
        'name="width" .../> and <default name="height" .../> into it, and $width and $height into '
        "its film"
    )


def _same_file(first: Path, second: Path) -> bool:
    """Return whether two files are one, or hold the same bytes."""
    try:
        return first.samefile(second) or (
            first.stat().st_size == second.stat().st_size
            and first.read_bytes() == second.read_bytes()
        )
    except OSError:  # what cannot be read is told where it is read
        return False


def _listed(paths: Sequence[Path] | None) -> str | None:
    return ", ".join(map(str, paths)) if paths else None


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
