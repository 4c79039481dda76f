"""`periscopy view`: a laboratory in the browser, which you move by hand."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli import options
from periscopy_sim.cli.messages import report_sentences
from periscopy_sim.cli.options import number, option
from periscopy_sim.cli.output import output_folder, progress, say, write_json
from periscopy_sim.cli.reconstruct import OPTIONAL, write_report
from periscopy_sim.cli.session import Session, provenance_of
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import require
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.live.choice import SBR, SNR, Choice
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, scenes_folder
from periscopy_sim.storage.ambient_library import find_condition
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_folder

if TYPE_CHECKING:
    from periscopy_sim.live.level import LivePictures
    from periscopy_sim.live.session import LiveSession


def view(
    scene: options.SceneArgument,
    hidden: options.Hidden = "29x36",
    photo: Annotated[
        Path | None,
        typer.Argument(metavar="PHOTO", help="A photograph. Without one: synthetic photographs."),
    ] = None,
    out: Annotated[Path, option("FOLDER", "Folder that the page's button writes.")] = Path("view"),
    image: Annotated[str | None, option("IMAGE", "First hidden image: a file or a name.")] = None,
    ambient: Annotated[
        str | None, option("PLACE", "First ambient light: a shipped place or a Mitsuba XML file.")
    ] = None,
    sbr: Annotated[
        float, number("First signal-to-background ratio.", form="RATIO", min=1e-6, max=1e6)
    ] = SBR,
    snr: options.Snr = SNR,
    method: Annotated[
        str, option("NAME", "First method; yours as module:callable or file.py:callable.")
    ] = DEFAULT,
    mask: options.MaskOption = None,
    host: Annotated[
        str, option("ADDRESS", "Where to listen; 0.0.0.0 is open to the network.")
    ] = "127.0.0.1",
    port: Annotated[int, option("NUMBER", "The port; 0 is any free one.", min=0, max=65535)] = 8080,
    define: options.Define = None,
) -> None:
    """Move a laboratory by hand, in the browser.

    The page shows the scene in 3-D, with handles and sliders for its <default>s, photograph,
    reconstruction and standard error. Ctrl-C ends the command.
    """
    require("viser")
    with suppress(InterruptedError), staged_folder(out):  # rejects a folder that cannot be written
        raise InterruptedError
    if ambient and photo is not None:
        raise PeriscopyError("--ambient needs synthetic photographs; leave it or PHOTO out")
    session = Session(scene, hidden, define)
    image = image or ("mushroom" if photo is None else "")
    first = Choice({}, image, ambient or "", sbr, snr, method)
    with progress("loading the scene"):
        from periscopy_sim.live.page import Offered
        from periscopy_sim.live.session import LiveSession

        ps.find_method(method)
        if ambient:
            find_condition(ambient)
        if image:
            session.hidden_image(image)
        wall = None if photo is None else session.wall(photo, mask)
        offered = Offered(
            sorted(file.stem for file in (scenes_folder() / "images").glob("*.png")),
            (*REALISTIC, *ADVERSARIAL),
            [name for name, each in METHODS.items() if not each.needs or find_spec(each.needs)],
        )

        def save(pictures: LivePictures) -> str:
            write_view(out, pictures, session.definitions, photo)
            return f"wrote {out}"

        live = LiveSession(
            session.scenario, first, offered, save, report_sentences,
            photograph=wall, host=host, port=port,
        )  # fmt: skip
    with live:
        _stop_by_interrupt(live)
        say(f"{live.page.gate.url} shows {session.path.name}; Ctrl-C ends it")
        live.run()
    say("closed")


def _stop_by_interrupt(live: LiveSession) -> None:
    """Let Ctrl-C end a session after the present stage of its work; a second one ends it at once.

    An exception anywhere could leave a lock held, or a page half closed.
    """

    def stop(which: int, _: Any) -> None:
        signal.signal(which, signal.default_int_handler)
        live.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)


def write_view(
    out: Path, pictures: LivePictures, given: Mapping[str, str], photo: Path | None
) -> None:
    """Write pictures and their scene to a folder, in place of former ones.

    A PeriscopyError names what cannot be written; then nothing is written.
    """
    scenario, choice, report = pictures.scenario, pictures.choice, pictures.report
    photograph = pictures.photograph.values
    provenance = provenance_of(scenario)
    text = as_text(provenance)
    values = dict(given) | {name: f"{value:.9g}" for name, value in choice.values.items()}
    panels = [("photograph", displayable(photograph))]
    if pictures.truth is not None:
        panels.insert(0, ("hidden image", displayable(pictures.truth, white=1)))
    panels.append(("reconstruction", displayable(pictures.image)))
    record: dict[str, Any] = {
        **asdict(choice),
        "photograph": None if photo is None else str(photo),
        "hidden_shape": scenario.hidden_shape,
        "psnr": pictures.psnr,
        "notes": report_sentences(report),
        **({} if report.residual is None else report.residual.numbers()),
        "provenance": provenance,
    }
    with output_folder(out, (*OPTIONAL, "photograph.exr")) as folder:
        write_copy(scenario.path, values, folder / "scene.xml")
        ps.load_scenario(folder / "scene.xml", scenario.hidden_shape)
        if photo is None:
            write_exr(folder / "photograph.exr", photograph, text)
        write_report(folder, report, pictures.image, photograph, text)
        draw_panels(folder / "pictures.png", panels, metadata=text)
        write_json(folder / "view.json", record)
