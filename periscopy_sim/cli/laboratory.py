"""`periscopy lab`, `draw`, `prepare`, `view`, `watch`: a laboratory, its photographs, its page."""

import csv
import hashlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from math import gcd
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli import messages, options, output, reconstruct
from periscopy_sim.cli.session import ALL_BUT_SHADOWS, PhotoSession, Session, WallSession
from periscopy_sim.errors import OutputError, PeriscopyError, require_all
from periscopy_sim.figures.panels import exposed, write_enlarged
from periscopy_sim.hidden import named
from periscopy_sim.photographs.develop import SensorImage, develop
from periscopy_sim.photographs.develop import average as averaged
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.storage import formats, photographs, rasters
from periscopy_sim.storage.outputs import append_array, unwritable_reported
from periscopy_sim.storage.pictures import write_png
from periscopy_sim.storage.provenance import as_text

if TYPE_CHECKING:
    from periscopy_sim.live.pictures import LivePictures
    from periscopy_sim.live.session import LiveSession
    from periscopy_sim.live.watch import Progress

_MEASUREMENTS = "The measurements; see --example."
_SCENE_FILE = "The scene's XML file; its meshes are written beside it."
Example = Annotated[
    bool, options.example_of("periscopy_sim.laboratory.document", "commented measurements")
]


def lab(
    measurements: Annotated[
        Path, options.argument("MEASUREMENTS.yaml", _MEASUREMENTS, exists=True)
    ],
    out: Annotated[Path, options.option("FILE", _SCENE_FILE, group=options.OUTPUT)],
    example: Example = False,  # noqa: ARG001
) -> None:
    """Make a scene of a laboratory from a ruler's measurements.

    Each number and its error become <default>s of the scene.
    """
    options.require_suffix(out, ".xml", "the scene")
    output.written(*ps.lab(measurements, out))
    _Trial(str(out), []).check_scene(but=ALL_BUT_SHADOWS)
    output.conclude(
        f"look at it before you use it: periscopy draw {out} --out {out.with_suffix('.png')}"
    )


def draw(
    scene: options.SceneArgument,
    out: options.OutFile,
    define: options.Define = None,
    camera: options.Cameras = None,
) -> None:
    """Draw a scene to scale: plan, side view, shadows.

    Look at it to find wrong signs and units.
    """
    options.require_suffix(out, ".png", "the drawing")
    with output.output_files(out) as (staged,):
        session = _Trial(scene, [], define, camera=camera)
        figure = ps.draw(session.scenario)
        with output.progress("drawing"):
            figure.savefig(staged, metadata=session.metadata)
    session.check_scene(but=ALL_BUT_SHADOWS)


class _Trial(Session):
    """A session of few pixels and patches: as many as shadows need."""

    pixels, patches = (64, 64), (18, 24)


Files = list[Path] | None
_BLACK = "Black level of the camera, subtracted."
Black = Annotated[float, options.option("VALUE", _BLACK, group=options.PHOTOGRAPH, kind="level")]
_DARK = "Photograph with the lens covered, subtracted; repeatable."
Dark = Annotated[Files, options.option("FILE", _DARK, group=options.PHOTOGRAPH, exists=True)]
_PHOTOS, _BIN = "Photographs of one exposure, averaged.", "Set the film to blocks of K x K pixels."
_FLAT = "Photograph of an evenly lit white surface, divided by; repeatable."
_MASK = "Picture of the photograph's or film's size, black off wall."
_WHITE = "Saturation value. [default: from the file]"
White = Annotated[
    float | None, options.option("VALUE", _WHITE, group=options.PHOTOGRAPH, kind="level")
]
_POINTS = "Points of the wall to rectify by: column,row,x,y,z."
Points = Annotated[
    Path | None, options.option("FILE.csv", _POINTS, group=options.PHOTOGRAPH, exists=True)
]
_TAGS = "AprilTag or ArUco markers to rectify by: id,x,y,z,size."
Tags = Annotated[
    Path | None, options.option("FILE.csv", _TAGS, group=options.PHOTOGRAPH, exists=True)
]


def prepare(
    photos: Annotated[list[Path], options.argument("PHOTO", _PHOTOS, exists=True)],
    scene: options.SceneOption,
    out: options.OutFile,
    black: Black = 0.0,
    dark: Dark = None,
    flat: Annotated[Files, options.option("FILE", _FLAT, exists=True)] = None,
    white: White = None,
    points: Points = None,
    tags: Tags = None,
    mask: Annotated[Path | None, options.option("FILE", _MASK, exists=True)] = None,
    bin_by: Annotated[int | None, options.option("K", _BIN, "--bin", kind="side")] = None,
    define: options.Define = None,
) -> None:
    """Bring a camera's photograph to the scene's pixels.

    The command writes NAME.exr; NAME_mask.png, which leaves out saturated pixels, tags and pixels
    outside of the photograph; and NAME_preview.png, hatched outside of the mask.
    """
    options.require_suffix(out, ".exr", "the photograph")
    raw = formats.libraries_of([*photos, *(dark or ()), *(flat or ())])
    require_all(*raw, *(["cv2"] if tags else []))
    session = Session(scene, [], define)
    marks = marks_of(points, tags)
    outputs = out, *(out.with_name(f"{out.stem}_{what}.png") for what in ("mask", "preview"))
    inputs = *photos, *(dark or ()), *(flat or ()), mask, points, tags, session.path
    with output.output_files(*outputs, inputs=inputs) as staged:
        with output.progress("reading the photograph"):
            offset, even = (
                averaged(exposures(frames, white, black), f"{name} {frames[-1]}")
                if frames
                else None
                for frames, name in ((dark, "the dark frame"), (flat, "the flat field"))
            )
            light = develop(exposures(photos, white, black), black=black, dark=offset, flat=even)
        film: list[str] = []
        if bin_by is not None:
            film = _film(light, session, bin_by, marks)
            session = Session(scene, [], [*(define or []), *film])
        with output.progress("averaging its pixels"):
            wall = None if mask is None else ps.read_mask(mask)
            prepared = ps.prepare(light, session.scenario, marks=marks, mask=wall)
            # A black level above all light leaves none: readers reject such a photograph.
            ps.Photograph.of(prepared.values, name=str(photos[0]), mask=prepared.mask)
        session.check_scene()
        for warning in prepared.warnings:
            output.warn(f"{photos[0]}: {warning}")
        digests = ", ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in photos)
        text = as_text({"photographs_sha256": digests, **prepared.record(), **session.provenance})
        rasters.write_exr(staged[0], prepared.values, text)
        write_png(staged[1], prepared.mask, text)
        values = np.where(prepared.mask[..., None], prepared.values, np.nan)
        write_enlarged(staged[2], exposed(values), text)
    output.record(**prepared.record())
    _show_prepared(prepared, light.size)
    if film:
        definitions = " ".join(f"-D {each}" for each in film)
        output.conclude(
            f"the scene's film has this size with {definitions}: give it with every command"
        )


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
            output.warn(warning)
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
    output.show_table(rows)


WRITING = Lock()
"""Held while files are written: Ctrl-C waits for them, and for nothing else."""

_PHOTO = "A photograph. Without one: synthetic photographs."
_PLACE = "Ambient light: a shipped place, a Mitsuba XML file, a photograph, or none."
Host = Annotated[str, options.option("ADDRESS", "Where to listen; 0.0.0.0 is open to the network.")]
Port = Annotated[int, options.option("NUMBER", "The port; 0 is any free one.", kind="port")]


def view(
    scene: options.SceneArgument,
    hidden: options.Hidden = ["29x36"],  # noqa: B006  nothing changes it
    photo: Annotated[Path | None, options.argument("PHOTO", _PHOTO, exists=True)] = None,
    out: Annotated[Path, options.option("FOLDER", "Folder that the page's button writes.")] = Path(
        "view"
    ),
    image: Annotated[
        str | None, options.option("IMAGE", "First hidden image: a file or a name.")
    ] = None,
    ambient: Annotated[str | None, options.option("LIGHT", _PLACE)] = None,
    method: options.FirstMethodOption = DEFAULT,
    mask: options.MaskOption = None,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    define: options.Define = None,
) -> None:
    """Move a laboratory by hand, in the browser.

    The page shows the scene in 3-D, with handles and sliders for its <default>s, photograph,
    reconstruction and standard error. Ctrl-C ends the command.
    """
    require_all("websockets")
    ps.find_method(method)
    others = {"--mask": mask} if photo is None else {"--ambient": ambient, "--image": image}
    verb, remedy = ("needs", "give both") if photo is None else ("excludes", "give one of the two")
    for flag in filter(others.get, others):
        raise ps.PeriscopyError(f"{flag} {verb} PHOTO; {remedy}")
    session = WallSession(scene, hidden, define, mask=mask)
    with output.progress("loading the scene"):
        from periscopy_sim.live.pictures import Choice
        from periscopy_sim.live.session import LiveSession

        session.check_scene(method)
        wall, first = (session.wall(photo), "") if photo else (None, image or "mushroom")
        if first:
            session.scenario.image(first)
        # Its error is smooth: methods project it out.
        light = session.ambient_light(ambient, target=0.05).photograph if ambient else None
        live = LiveSession(
            session.scenario, Choice({}, first, ambient or "", method=method),
            lambda pictures: write_view(out, session, pictures, photo), messages.report_sentences,
            photograph=wall, light=light, host=host, port=port,
        )  # fmt: skip
    serve(live, session.path.name)


def serve(live: "LiveSession", name: str, close: Callable[[], None] = lambda: None) -> None:
    """Serve a page until its session ends, or until Ctrl-C; then call `close`.

    Nothing interrupts `close`: a terminal and a program may both send the same Ctrl-C.
    """
    ends, both = Event(), (signal.SIGINT, signal.SIGTERM)
    former = {each: signal.signal(each, lambda *_: ends.set()) for each in both}
    try:
        worker = Thread(target=live.run, daemon=True)  # its long steps would delay Ctrl-C
        worker.start()
        if live.gate.is_open:
            output.warn(
                "others can open the page, without encryption; leave --host out to prevent that"
            )
        output.say(f"{live.gate.url} shows {name}; Ctrl-C ends it", is_result=True)
        while worker.is_alive() and not ends.is_set():
            worker.join(0.2)
        with WRITING:
            live.stop()
            close()
        if ends.is_set():
            output.say("closed")
            output.outcome().show()
            os._exit(0)
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def write_view(
    out: Path, session: Session, pictures: "LivePictures", photo: Path | None = None
) -> str:
    """Write pictures and their scene to a folder, in place of former ones; return what to say."""
    scenario, report, photograph = pictures.scenario, pictures.report, pictures.photograph
    provenance = session.provenance_of(scenario)
    text, images = as_text(provenance), scenario.hidden.images(pictures.image)
    settings = {**asdict(pictures.choice), "psnr": pictures.psnr}
    if pictures.truth is None:
        settings = {name: settings[name] for name in ("values", "method")}
    with (
        WRITING,
        output.output_folder(out, (*reconstruct.OPTIONAL, "photograph.exr", "mask.png")) as folder,
    ):
        write_copy(scenario.document, {}, folder / "scene.xml")
        if photo is None:
            rasters.write_exr(folder / "photograph.exr", photograph.values, text)
            if photograph.mask is not None:
                write_png(folder / "mask.png", photograph.mask, {})
        reconstruct.write_report(
            folder, report, scenario, images, {"photograph": photograph.values}, text
        )
        record = {
            "photograph": None if photo is None else str(photo),
            "hidden_shape": session.hidden_shape,
            "notes": messages.report_sentences(report),
            **(report.residual.numbers() if report.residual else {}),
            "provenance": provenance,
        }
        output.write_json(folder / "view.json", settings | record)
    return f"wrote {out}"


EXAMPLE = Path(__file__).with_name("camera.py")
_SOURCE = "A folder into which a camera writes, or file.py:function, which returns the next frame."
_OUT = "Folder to write: every picture and its numbers. [default: only the page's button, to watch]"
_AVERAGE = "Frames of the running average; 8-bit cameras need some tens."
_LINEAR = "A function's integers are linear light, not encoded for screens."


def watch(
    *,
    source: Annotated[str, options.argument("SOURCE", _SOURCE)],
    session: PhotoSession,
    out: Annotated[Path | None, options.option("FOLDER", _OUT, group=options.OUTPUT)] = None,
    average: Annotated[int, options.option("NUMBER", _AVERAGE, kind="count")] = 30,
    black: Black = 0.0,
    dark: Dark = None,
    white: White = None,
    points: Points = None,
    tags: Tags = None,
    linear: Annotated[bool, typer.Option("--linear", help=_LINEAR)] = False,
    method: options.FirstMethodOption = DEFAULT,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    example: Annotated[bool, options.example_of(__name__, "a camera's function by PyAV")] = False,  # noqa: ARG001
) -> None:
    """Recover the hidden image from photographs as they come.

    In the browser, on the page of view: move the laboratory while the picture sharpens. Frames
    that come too late are dropped and counted. The command ends with the source, or by Ctrl-C.
    """
    require_all("websockets", *(["cv2"] if tags else []))
    ps.find_method(method)
    marks = marks_of(points, tags)
    encoding = None if Path(source).is_dir() else rasters.LINEAR if linear else rasters.SRGB
    if dark and black:
        raise PeriscopyError("a dark frame holds the black level; give one of the two")
    if (black or white) and encoding == rasters.SRGB:
        raise PeriscopyError("--black, --white: add --linear if the integers are linear light")
    recorder = None if out is None else Recorder(out, session)
    with output.progress("loading the scene"):
        from periscopy_sim.live.frames import Companions, open_source
        from periscopy_sim.live.watch import WatchSession

        frames = open_source(source, linear=linear, white=white, has_black=bool(black))
        session.check_scene(method)
        mask, monitor_off = session.files()
        read = partial(exposures, white=white, black=black, encoding=encoding)
        companions = Companions(
            marks, photographs.read_mask(mask) if mask else None, black,
            averaged(read(dark), f"the dark frame {dark[-1]}") if dark else None,
            {str(file): next(read([file])) for file in monitor_off},
            session.colours,
        )  # fmt: skip
        live = WatchSession(
            frames, session.scenario, method,
            partial(write_view, (out or Path("watch")) / "set", session), messages.report_sentences,
            companions=companions, count=average, say=session.warn,
            record=recorder or (lambda *_: None), seed=session.seed, host=host, port=port,
        )  # fmt: skip

    def close() -> None:
        if recorder is not None:
            recorder.close({"source": source, **live.record})
        output.record(**live.record)
        output.say(f"frames shown: {live.shown}, dropped: {live.dropped}")
        if live.verdict is not None:
            output.conclude(*session.judge(source, live.verdict))

    with live:
        serve(live, session.path.name, close)
    if live.fault is not None:
        raise live.fault


class Recorder:
    """The pictures of all frames and their numbers in a folder, whole at any moment.

    `frames.npy`, of several surfaces one for each, and `metrics.csv`, whose columns are those of
    the first frame, grow with each frame in full size; `close` writes `summary.json`. An
    OutputError says that the folder holds a recording, which no camera can repeat.
    """

    def __init__(self, folder: Path, session: PhotoSession) -> None:
        if any(any(folder.glob(name)) for name in ("metrics.csv", "summary.json", "frames*.npy")):
            raise OutputError(f"{folder} holds a recording; name another folder for --out")
        # Before the first frame only a look: what fails before it leaves no empty folder.
        place = next(each for each in (folder, *folder.absolute().parents) if each.exists())
        if not (place.is_dir() and os.access(place, os.W_OK)):
            raise OutputError(f"cannot write {folder}; name another folder for --out")
        self._folder, self._session, self._count = folder, session, 0
        self._columns: list[str] = []

    def __call__(self, pictures: "LivePictures", progress: "Progress") -> None:
        """Record a frame; coarse pictures, which a moving scene has, are left out."""
        if pictures.is_coarse:
            return
        from periscopy_sim.evaluation.metrics import record_of

        images = named("frames", self._session.scenario.hidden.images(pictures.image))
        choice, residual = pictures.choice, pictures.report.residual
        row: dict[str, Any] = {
            "frame": progress.frame, "time": f"{progress.time:.4f}", "method": choice.method,
            **record_of(pictures.seconds, pictures.report.numbers),
            "unexplained": residual.unexplained if residual else "",
            **{n: getattr(progress, n) for n in ("latency", "dropped", "averaged")},
            "noise_left": progress.noise_left or "", **choice.values,
        }  # fmt: skip
        with WRITING, unwritable_reported(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
            for stem, image in images.items():
                append_array(self._folder / f"{stem}.npy", image, self._count)
            with (self._folder / "metrics.csv").open("a", encoding="utf-8", newline="") as file:
                self._columns = self._columns or [*row]
                form: Any = {"extrasaction": "ignore", "lineterminator": "\n"}
                table = csv.DictWriter(file, self._columns, **form)
                if not self._count:
                    table.writeheader()
                table.writerow(row)
            self._count += 1

    def close(self, numbers: Mapping[str, object]) -> None:
        """Write the summary of the frames, if there are any."""
        if not self._count:
            return
        with output.output_files(self._folder / "summary.json") as (staged,):
            self._session.write_summary(staged, {"frames": self._count, **numbers})
        output.written(self._folder / "metrics.csv", *sorted(self._folder.glob("frames*.npy")))
