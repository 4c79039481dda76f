"""`periscopy prepare`: any camera's photograph in the pixels of a scene's camera."""

import hashlib
from collections.abc import Iterator, Sequence
from math import gcd
from pathlib import Path
from typing import Annotated

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.options import PHOTOGRAPH, argument, option
from periscopy_sim.cli.output import conclude, output_files, progress, record, show_table, warn
from periscopy_sim.cli.session import Session
from periscopy_sim.extras import require_all
from periscopy_sim.figures.panels import exposed, write_enlarged
from periscopy_sim.photographs.develop import SensorImage, average, develop
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.formats.table import libraries_of
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.pictures import write_png

Files = list[Path] | None
_BLACK = "Black level of the camera, subtracted."
Black = Annotated[float, option("VALUE", _BLACK, group=PHOTOGRAPH, kind="level")]
_DARK = "Photograph with the lens covered, subtracted; repeatable."
Dark = Annotated[Files, option("FILE", _DARK, group=PHOTOGRAPH, exists=True)]
_PHOTOS, _BIN = "Photographs of one exposure, averaged.", "Set the film to blocks of K x K pixels."
_FLAT = "Photograph of an evenly lit white surface, divided by; repeatable."
_MASK = "Picture of the photograph's or film's size, black off wall."
_WHITE = "Saturation value. [default: from the file]"
White = Annotated[float | None, option("VALUE", _WHITE, group=PHOTOGRAPH, kind="level")]
_POINTS = "Points of the wall to rectify by: column,row,x,y,z."
Points = Annotated[Path | None, option("FILE.csv", _POINTS, group=PHOTOGRAPH, exists=True)]
_TAGS = "AprilTag or ArUco markers to rectify by: id,x,y,z,size."
Tags = Annotated[Path | None, option("FILE.csv", _TAGS, group=PHOTOGRAPH, exists=True)]


def prepare(
    photos: Annotated[list[Path], argument("PHOTO", _PHOTOS, exists=True)],
    scene: options.SceneOption,
    out: options.OutFile,
    black: Black = 0.0,
    dark: Dark = None,
    flat: Annotated[Files, option("FILE", _FLAT, exists=True)] = None,
    white: White = None,
    points: Points = None,
    tags: Tags = None,
    mask: Annotated[Path | None, option("FILE", _MASK, exists=True)] = None,
    bin_by: Annotated[int | None, option("K", _BIN, "--bin", kind="side")] = None,
    define: options.Define = None,
) -> None:
    """Bring a camera's photograph to the scene's pixels.

    The command writes NAME.exr; NAME_mask.png, which leaves out saturated pixels, tags and pixels
    outside of the photograph; and NAME_preview.png, hatched outside of the mask.
    """
    options.require_suffix(out, ".exr", "the photograph")
    raw = libraries_of([*photos, *(dark or ()), *(flat or ())])
    require_all(*raw, *(["cv2"] if tags else []))
    session = Session(scene, [], define)
    marks = marks_of(points, tags)
    outputs = out, *(out.with_name(f"{out.stem}_{what}.png") for what in ("mask", "preview"))
    inputs = *photos, *(dark or ()), *(flat or ()), mask, points, tags, session.path
    with output_files(*outputs, inputs=inputs) as staged:
        with progress("reading the photograph"):
            offset, even = (
                average(exposures(frames, white, black), f"{name} {frames[-1]}") if frames else None
                for frames, name in ((dark, "the dark frame"), (flat, "the flat field"))
            )
            light = develop(exposures(photos, white, black), black=black, dark=offset, flat=even)
        film: list[str] = []
        if bin_by is not None:
            film = _film(light, session, bin_by, marks)
            session = Session(scene, [], [*(define or []), *film])
        with progress("averaging its pixels"):
            wall = None if mask is None else ps.read_mask(mask)
            prepared = ps.prepare(light, session.scenario, marks=marks, mask=wall)
            # A black level above all light leaves none: readers reject such a photograph.
            ps.Photograph.of(prepared.values, name=str(photos[0]), mask=prepared.mask)
        session.check_scene()
        for warning in prepared.warnings:
            warn(f"{photos[0]}: {warning}")
        digests = ", ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in photos)
        text = as_text({"photographs_sha256": digests, **prepared.record(), **session.provenance})
        write_exr(staged[0], prepared.values, text)
        write_png(staged[1], prepared.mask, text)
        values = np.where(prepared.mask[..., None], prepared.values, np.nan)
        write_enlarged(staged[2], exposed(values), text)
    record(**prepared.record())
    _show_prepared(prepared, light.size)
    if film:
        definitions = " ".join(f"-D {each}" for each in film)
        conclude(f"the scene's film has this size with {definitions}: give it with every command")


def marks_of(points: Path | None, tags: Path | None) -> ps.WallPoints | ps.WallTags | None:
    """Read the marks of the wall, if a file of them is given; of two it is a PeriscopyError."""
    if points is not None and tags is not None:
        raise ps.PeriscopyError("--points and --tags exclude each other; give one")
    return ps.read_wall_points(points) if points else ps.read_wall_tags(tags) if tags else None


def exposures(
    paths: Sequence[Path],
    white: float | None = None,
    black: float = 0.0,
    encoding: str | None = None,
) -> Iterator[SensorImage]:
    """Read photographs of a camera, with their warnings; see `read_sensor_image`."""
    for path in paths:
        exposure, warnings = ps.read_sensor_image(
            path, white, has_black=bool(black), encoding=encoding
        )
        for warning in warnings:
            warn(warning)
        yield exposure


def _film(
    light: SensorImage, session: Session, side: int, marks: ps.WallPoints | ps.WallTags | None
) -> list[str]:
    """Return NAME=VALUE of <default>s: of a film whose pixels cover side x side of a photograph."""
    rows, columns = session.scenario.photograph_shape
    covered = light.size[0] / rows  # pixels of the photograph along a side of the scene's own
    if marks is not None:
        from periscopy_sim.photographs.prepare import place_film

        covered = np.sqrt(place_film(light, session.scenario, marks).coverage)
    common = gcd(rows, columns)
    times = max(1, round(common * covered / side))
    rows, columns = times * rows // common, times * columns // common
    declared = session.scenario.document.defaults.keys() - session.definitions.keys()
    if {"height", "width"} <= declared:
        return [f"height={rows}", f"width={columns}"]
    if "resolution" in declared and rows == columns:
        return [f"resolution={rows}"]
    raise ps.PeriscopyError(
        f"--bin: scene '{session.path}' declares no <default> for its film's size that -D leaves "
        "free; declare width and height, and use $width and $height in its film"
    )


def _show_prepared(prepared: "ps.Prepared", size: tuple[int, int]) -> None:
    """Print how well points or tags place the scene's pixels, and what the mask leaves out."""
    rows = [
        ["photograph", "{}x{} pixels".format(*size)],
        ["film", "{}x{} pixels".format(*prepared.mask.shape)],
        ["averaged in each", f"{prepared.coverage:.3g} pixels of the photograph"],
        ["dead or hot", f"{prepared.defects} pixels of the photograph"],
        ["masked", f"{np.count_nonzero(~prepared.mask)} of {prepared.mask.size} pixels"],
    ]
    if (fit := prepared.view) is not None:
        rms = f"{fit.rms:.2f} pixels of the photograph ({1e3 * fit.rms_on_wall:.2g} mm on the wall)"
        fits = f"fit to {rms} rms" if fit.freedom else "as many as the view needs"
        rows.append(["tags" if fit.marks.are_tags else "points", f"{len(fit.marks)}, {fits}"])
        rows.append(["placement", f"± {prepared.placement:.2f} pixels of the film"])
    show_table(rows)
