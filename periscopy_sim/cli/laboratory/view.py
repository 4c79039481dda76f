"""`periscopy view`: a laboratory in the browser, which you move by hand."""

import os
import signal
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Annotated

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli import options
from periscopy_sim.cli.messages import report_sentences
from periscopy_sim.cli.options import argument, option
from periscopy_sim.cli.output import outcome, output_folder, progress, say, warn, write_json
from periscopy_sim.cli.reconstruct import OPTIONAL, write_report
from periscopy_sim.cli.session import Session, WallSession
from periscopy_sim.extras import require_all
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.pictures import write_png

if TYPE_CHECKING:
    from periscopy_sim.live.pictures import LivePictures
    from periscopy_sim.live.session import LiveSession

WRITING = Lock()
"""Held while files are written: Ctrl-C waits for them, and for nothing else."""

_PHOTO = "A photograph. Without one: synthetic photographs."
_PLACE = "Ambient light: a shipped place, a Mitsuba XML file, a photograph, or none."
Host = Annotated[str, option("ADDRESS", "Where to listen; 0.0.0.0 is open to the network.")]
Port = Annotated[int, option("NUMBER", "The port; 0 is any free one.", kind="port")]


def view(
    scene: options.SceneArgument,
    hidden: options.Hidden = ["29x36"],  # noqa: B006  nothing changes it
    photo: Annotated[Path | None, argument("PHOTO", _PHOTO, exists=True)] = None,
    out: Annotated[Path, option("FOLDER", "Folder that the page's button writes.")] = Path("view"),
    image: Annotated[str | None, option("IMAGE", "First hidden image: a file or a name.")] = None,
    ambient: Annotated[str | None, option("LIGHT", _PLACE)] = None,
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
    check_page(host, port, method)
    others = {"--mask": mask} if photo is None else {"--ambient": ambient, "--image": image}
    verb, remedy = ("needs", "give both") if photo is None else ("excludes", "give one of the two")
    for flag in filter(others.get, others):
        raise ps.PeriscopyError(f"{flag} {verb} PHOTO; {remedy}")
    session = WallSession(scene, hidden, define, mask=mask)
    with progress("loading the scene"):
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
            lambda pictures: write_view(out, session, pictures, photo), report_sentences,
            photograph=wall, light=light, host=host, port=port,
        )  # fmt: skip
    serve(live, session.path.name)


def check_page(host: str, port: int, method: str, *libraries: str) -> None:
    """Reject a page that cannot be served, before anything is loaded."""
    require_all("websockets", *libraries)
    from periscopy_sim.live.gate import listen

    listen(host, port).close()
    ps.find_method(method)


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
            warn("others can open the page, without encryption; leave --host out to prevent that")
        say(f"{live.gate.url} shows {name}; Ctrl-C ends it", is_result=True)
        while worker.is_alive() and not ends.is_set():
            worker.join(0.2)
        with WRITING:
            live.stop()
            close()
        if ends.is_set():
            say("closed")
            outcome().show()
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
    with WRITING, output_folder(out, (*OPTIONAL, "photograph.exr", "mask.png")) as folder:
        write_copy(scenario.document, {}, folder / "scene.xml")
        if photo is None:
            write_exr(folder / "photograph.exr", photograph.values, text)
            if photograph.mask is not None:
                write_png(folder / "mask.png", photograph.mask, {})
        write_report(folder, report, scenario, images, {"photograph": photograph.values}, text)
        record = {
            "photograph": None if photo is None else str(photo),
            "hidden_shape": session.hidden_shape,
            "notes": report_sentences(report),
            **(report.residual.numbers() if report.residual else {}),
            "provenance": provenance,
        }
        write_json(folder / "view.json", settings | record)
    return f"wrote {out}"
