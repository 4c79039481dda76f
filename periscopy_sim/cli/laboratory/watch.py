"""`periscopy watch`: photographs as they come, reconstructed on the page of `view`."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli.laboratory import prepare
from periscopy_sim.cli.laboratory.view import WRITING, Host, Port, check_page, serve, write_view
from periscopy_sim.cli.messages import report_sentences
from periscopy_sim.cli.options import OUTPUT, FirstMethodOption, argument, example_of, option
from periscopy_sim.cli.output import conclude, output_files, progress, record, say, written
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.hidden import named
from periscopy_sim.photographs.develop import average as averaged
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.storage.formats.decoding import LINEAR, SRGB
from periscopy_sim.storage.outputs.growing import GrowingStack, GrowingTable
from periscopy_sim.storage.outputs.staging import unwritable_reported
from periscopy_sim.storage.photographs import read_mask

if TYPE_CHECKING:
    from periscopy_sim.live.pictures import LivePictures
    from periscopy_sim.live.watch import Progress

EXAMPLE = Path(__file__).with_name("camera.py")
_SOURCE = "A folder into which a camera writes, or file.py:function, which returns the next frame."
_OUT = "Folder to write: every picture and its numbers. [default: only the page's button, to watch]"
_AVERAGE = "Frames of the running average; 8-bit cameras need some tens."
_LINEAR = "A function's integers are linear light, not encoded for screens."


def watch(
    *,
    source: Annotated[str, argument("SOURCE", _SOURCE)],
    session: PhotoSession,
    out: Annotated[Path | None, option("FOLDER", _OUT, group=OUTPUT)] = None,
    average: Annotated[int, option("NUMBER", _AVERAGE, kind="count")] = 30,
    black: prepare.Black = 0.0,
    dark: prepare.Dark = None,
    white: prepare.White = None,
    points: prepare.Points = None,
    tags: prepare.Tags = None,
    linear: Annotated[bool, typer.Option("--linear", help=_LINEAR)] = False,
    method: FirstMethodOption = DEFAULT,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    example: Annotated[bool, example_of(__name__, "a camera's function by PyAV")] = False,  # noqa: ARG001
) -> None:
    """Recover the hidden image from photographs as they come.

    In the browser, on the page of view: move the laboratory while the picture sharpens. Frames
    that come too late are dropped and counted. The command ends with the source, or by Ctrl-C.
    """
    check_page(host, port, method, *(["cv2"] if tags else []))
    marks = prepare.marks_of(points, tags)
    encoding = None if Path(source).is_dir() else LINEAR if linear else SRGB
    if dark and black:
        raise PeriscopyError("a dark frame holds the black level; give one of the two")
    if (black or white) and encoding == SRGB:
        raise PeriscopyError("--black, --white: add --linear if the integers are linear light")
    recorder = None if out is None else Recorder(out, session)
    with progress("loading the scene"):
        from periscopy_sim.live.frames import open_source
        from periscopy_sim.live.preparation import Companions
        from periscopy_sim.live.watch import WatchSession

        frames = open_source(source, linear=linear, white=white, has_black=bool(black))
        session.check_scene(method)
        mask, monitor_off = session.files()
        read = partial(prepare.exposures, white=white, black=black, encoding=encoding)
        companions = Companions(
            marks, read_mask(mask) if mask else None, black,
            averaged(read(dark), f"the dark frame {dark[-1]}") if dark else None,
            {str(file): next(read([file])) for file in monitor_off},
            session.colours,
        )  # fmt: skip
        live = WatchSession(
            frames, session.scenario, method,
            partial(write_view, (out or Path("watch")) / "set", session), report_sentences,
            companions=companions, count=average, say=session.warn,
            record=recorder or (lambda *_: None), seed=session.seed, host=host, port=port,
        )  # fmt: skip

    def close() -> None:
        if recorder is not None:
            recorder.close({"source": source, **live.record})
        record(**live.record)
        say(f"frames shown: {live.shown}, dropped: {live.dropped}")
        if live.verdict is not None:
            conclude(*session.judge(source, live.verdict))

    with live:
        serve(live, session.path.name, close)
    if live.fault is not None:
        raise live.fault


class Recorder:
    """The pictures of all frames and their numbers in a folder, whole at any moment.

    `frames.npy`, of several surfaces one for each, and `metrics.csv` grow with each frame in full
    size; `close` writes `summary.json`. An OutputError says that the folder holds a recording,
    which no camera can repeat.
    """

    def __init__(self, folder: Path, session: PhotoSession) -> None:
        if any(any(folder.glob(name)) for name in ("metrics.csv", "summary.json", "frames*.npy")):
            raise OutputError(f"{folder} holds a recording; name another folder for --out")
        # Before the first frame only a look: what fails before it leaves no empty folder.
        place = next(each for each in (folder, *folder.absolute().parents) if each.exists())
        if not (place.is_dir() and os.access(place, os.W_OK)):
            raise OutputError(f"cannot write {folder}; name another folder for --out")
        self._folder, self._session = folder, session
        self._stacks: dict[str, GrowingStack] = {}
        self._table: GrowingTable | None = None

    def __call__(self, pictures: "LivePictures", progress: "Progress") -> None:
        """Record a frame; coarse pictures, which a moving scene has, are left out."""
        if pictures.is_coarse:
            return
        from periscopy_sim.evaluation.video_metrics import record_of

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
            if self._table is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                places = {stem: self._folder / f"{stem}.npy" for stem in images}
                self._stacks = {n: GrowingStack(places[n], f.shape) for n, f in images.items()}
                self._table = GrowingTable(self._folder / "metrics.csv", row)
            for stem, image in images.items():
                self._stacks[stem].append(image)
            self._table.append(row)

    def close(self, numbers: Mapping[str, object]) -> None:
        """Write the summary of the frames, if there are any."""
        if self._table is None:
            return
        files: list[GrowingTable | GrowingStack] = [self._table, *self._stacks.values()]
        for each in files:
            each.close()
        with output_files(self._folder / "summary.json") as (staged,):
            self._session.write_summary(staged, {"frames": self._table.count, **numbers})
        written(*(each.path for each in files))
