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

from periscopy_sim.cli import options
from periscopy_sim.cli.options import number, option
from periscopy_sim.cli.output import fixable, progress, say, say_written, warn
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.photograph import Mask
    from periscopy_sim.photographs.film_size import FilmAdvice
    from periscopy_sim.photographs.marks import WallPoints, WallTags
    from periscopy_sim.photographs.prepare import Prepared
    from periscopy_sim.photographs.sensor_image import SensorImage
    from periscopy_sim.photographs.view_fit import FittedView
    from periscopy_sim.scenario import Scenario

FILM_SIZES = (
    ("height", "width"), ("rows", "columns"), ("film_height", "film_width"),
    ("resolution_y", "resolution_x"), ("resolution",),
)  # fmt: skip
"""Possible names of the <default>s for the rows and columns of a scene's film."""

Photos = Annotated[
    list[Path],
    typer.Argument(metavar="PHOTO...", help="Photographs, averaged, or merged by --exposures."),
]
Files = list[Path] | None


def prepare(
    photos: Photos,
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
    hidden: Annotated[str, option("ROWSxCOLUMNS", "Patches for --bin auto and advice.")] = "29x36",
    define: options.Define = None,
) -> None:
    """Bring a camera's photograph to the scene's pixels.

    The command writes NAME.exr; NAME_mask.png, which leaves out saturated pixels, tags and pixels
    outside of the photograph; and NAME_preview.png, black outside of the mask.
    """
    from periscopy_sim.figures.display import save_png
    from periscopy_sim.figures.panels import enlarged
    from periscopy_sim.photographs.film_size import advise
    from periscopy_sim.photographs.prepare import prepare as prepared_from
    from periscopy_sim.storage.formats.exr import write_exr
    from periscopy_sim.storage.pictures import write_png
    from periscopy_sim.storage.wall_marks import read_wall_points, read_wall_tags

    options.require_suffix(out, ".exr", "the photograph")
    session = Session(scene, define=define)
    if points is not None and tags is not None:
        raise PeriscopyError("--points and --tags exclude each other; give one")
    if min(patches := options.parse_size(hidden)) < 1:
        raise PeriscopyError(f"--hidden {hidden}: a hidden image has one patch at least")
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
        advice = advise(scenario, patches)
        film: dict[str, str] = {}
        if bin_by is not None:
            shape = _film(light, scenario, advice, bin_by, on_wall or tags_on_wall)
            film = _film_definitions(scenario, shape, define)
            more = [f"{name}={value}" for name, value in film.items()]
            session = Session(scene, define=[*(define or []), *more])
            scenario = session.scenario
        with progress("averaging its pixels"):
            prepared = prepared_from(light, scenario, points=on_wall, tags=tags_on_wall, mask=used)
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
    for line in _lines(prepared, advice, light.size, casts=not session.warnings):
        say(line)
    say_written(*written)
    if film:
        definitions = " ".join(f"-D {name}={value}" for name, value in film.items())
        say(f"give {definitions} with every command: it sets the scene's film to this size")


# -- reading -------------------------------------------------------------------------------------


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
    from periscopy_sim.photographs.develop import average, black_level_warning, develop
    from periscopy_sim.photographs.sensor_image import mask_of_pixels
    from periscopy_sim.storage.photographs import read_mask, read_sensor_image

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
    source = f"--black {black:g}" if black else f"--dark {_listed(dark)}" if dark else "the file"
    if warning := black_level_warning(light, on_photograph, source):
        warn(f"{photos[0]}: {warning}")
    return light, used


def _listed(paths: Sequence[Path] | None) -> str | None:
    return ", ".join(map(str, paths)) if paths else None


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


# -- the film's size -----------------------------------------------------------------------------


def _film(
    light: SensorImage,
    scenario: Scenario,
    advice: FilmAdvice,
    by: str,
    marks: WallPoints | WallTags | None,
) -> tuple[int, int]:
    """Return (rows, columns) of the film for --bin auto or --bin SIDE."""
    from periscopy_sim.photographs.film_size import films_of_blocks, films_of_marks, films_of_shape
    from periscopy_sim.photographs.placing import place_film

    factor = int(by) if by.isascii() and by.isdigit() else 0
    if by != "auto" and not 0 < factor < 10**4:
        raise PeriscopyError(f"--bin '{by}' is neither auto nor a whole number; write --bin 8")
    rows, columns = scenario.photograph_shape
    if marks is not None:
        placed = place_film(light, scenario, marks)
        side = np.sqrt(placed.coverage)
        if by == "auto":
            return advice.choose(films_of_marks((rows, columns), placed.coverage, placed.placement))
        films = films_of_shape((rows, columns), side)
        return min(films, key=lambda film: abs(film[0] - rows * side / factor))
    sizes = films_of_blocks(light.size)
    if (factor and factor not in sizes) or rows * light.size[1] != columns * light.size[0]:
        raise PeriscopyError(
            f"--bin: {light.size[0]} x {light.size[1]} pixels do not divide into the scene's "
            f"{rows} x {columns} by blocks with a side of {', '.join(map(str, sizes))}; crop the "
            "photograph, or change the scene's film"
        )
    return sizes[factor] if factor else advice.choose(list(sizes.values()))


def _film_definitions(
    scenario: Scenario, shape: tuple[int, int], define: list[str] | None
) -> dict[str, str]:
    """Return the scene's <default>s that set its film to (rows, columns)."""
    from periscopy_sim.rendering.scene.document import read_document

    declared = read_document(scenario.path).defaults.keys()
    for names in FILM_SIZES:
        if set(names) <= declared and (len(names) == 2 or shape[0] == shape[1]):
            if set(names) & options.parse_definitions(define).keys():
                raise PeriscopyError(f"--bin and -D both set {' and '.join(names)}; give one")
            return dict(zip(names, map(str, shape), strict=False))
    raise PeriscopyError(
        f"--bin: scene '{scenario.path}' declares no <default> for its film's size; declare width "
        "and height, and use $width and $height in its film"
    )


# -- the report ----------------------------------------------------------------------------------


def _lines(
    prepared: Prepared, advice: FilmAdvice, size: tuple[int, int], *, casts: bool
) -> Iterator[str]:
    """Yield the accuracy of the view, the pixels left out, and advice on the film."""
    from periscopy_sim.photographs.film_size import PIXELS_IN_STEP, films_of_marks
    from periscopy_sim.photographs.resampling import Flaw

    shape = prepared.mask.shape[0], prepared.mask.shape[1]
    if (fit := prepared.view) is not None:
        pixel = 1e3 * advice.pixel * advice.shape[0] / shape[0]
        yield (
            f"{len(fit.marks)} marks {_fit(fit)}; they place the scene's pixels to "
            f"{prepared.placement:.2f} of one ({pixel * prepared.placement:.2g} mm on the wall) "
            "where it is worst"
        )
    notes = [f"{prepared.coverage:.3g} in each"]
    if prepared.defects:
        notes.append(f"without {prepared.defects} dead or hot ones")
    rest = ~prepared.mask  # each pixel counts once
    for flaw, reason in (
        (Flaw.OUTSIDE, "outside of the photograph"), (Flaw.MASKED, "by the mask"),
        (Flaw.TAG, "beneath tags"), (Flaw.SATURATED, "saturated"),
        (Flaw.SPARSE, "mostly dead or hot"),
    ):  # fmt: skip
        pixels = rest & ((prepared.flaws & flaw) != 0)
        if pixels.any():
            notes.append(f"left out {np.count_nonzero(pixels)} {reason}")
        rest &= ~pixels
    yield f"{size[0]}x{size[1]} pixels averaged to {shape[0]}x{shape[1]}: {', '.join(notes)}"

    film = f"A takes {4 * shape[0] * shape[1] * advice.patches / 1e6:.3g} MB"
    film += "" if advice.fits(shape) else ", too much here"
    if advice.step is None:
        yield f"film: {'no mesh casts the shadows; ' if casts else ''}{film}"
        return
    pixels_in_step = advice.pixels_in_step(shape)
    finer = films_of_marks(shape, prepared.coverage, prepared.placement)
    if not advice.fits(shape) or pixels_in_step >= 2 * PIXELS_IN_STEP:
        film += "; coarser would do: --bin auto"
    elif pixels_in_step < PIXELS_IN_STEP and advice.choose(finer) > shape:
        film += "; finer may show more: --bin auto"
    yield (
        f"film: {pixels_in_step:.2g} pixels in a step of the shadow ({1e3 * advice.step:.2g} mm "
        f"from patch to patch); {film}"
    )


def _fit(view: FittedView) -> str:
    """Return how well a view fits its marks."""
    if not view.freedom:
        return "are as many as the view needs: nothing checks them"
    lens = "".join(f", k{n + 1} = {k:.4g}" for n, k in enumerate(view.view.distortion))
    return (
        f"fit to {view.rms:.2f} pixels of the photograph ({1e3 * view.rms_on_wall:.2g} mm on the "
        f"wall) rms{lens}"
    )


def _record(prepared: Prepared) -> dict[str, Any]:
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
