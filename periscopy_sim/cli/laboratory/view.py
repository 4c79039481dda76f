"""`periscopy view`: a laboratory in the browser, to be moved by hand."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from periscopy_sim.cli import inputs, options
from periscopy_sim.cli.laboratory.viewed import write_view
from periscopy_sim.cli.messages import report_sentences
from periscopy_sim.cli.options import number, option, parse_definitions
from periscopy_sim.cli.output import progress, say
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import require
from periscopy_sim.live.choice import SBR, SNR, Choice
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.storage.outputs.staging import staged_folder

if TYPE_CHECKING:
    from periscopy_sim.live.level import LivePictures, Shot
    from periscopy_sim.live.page import Offered
    from periscopy_sim.scenario import Scenario

PORT = 8080
HERE = "127.0.0.1"
IMAGE = "mushroom"


def view(
    scene: options.SceneArgument,
    hidden: Annotated[str, option("ROWSxCOLUMNS", "Patches of the hidden image.")] = "29x36",
    photo: Annotated[
        Path | None,
        typer.Argument(
            metavar="PHOTO",
            help="A photograph, as reconstruct takes it: the page then shows its residual. Without "
            "one, photographs are synthetic.",
        ),
    ] = None,
    out: Annotated[
        Path,
        option("FOLDER", "Where the page's button writes the scene and the pictures."),
    ] = Path("view"),
    image: Annotated[
        str | None,
        option("IMAGE", "What the monitor shows at first: a file, or a shipped image."),
    ] = None,
    ambient: Annotated[
        str | None,
        option("PLACE", "Ambient light at first: a shipped place or a Mitsuba XML file."),
    ] = None,
    sbr: Annotated[
        float,
        number("Signal-to-background ratio at first.", form="RATIO", min=1e-6, max=1e6),
    ] = SBR,
    snr: options.Snr = SNR,
    method: Annotated[
        str, option("NAME", "Method at first; yours as module:callable or file.py:callable.")
    ] = DEFAULT,
    mask: options.MaskOption = None,
    host: Annotated[
        str,
        option("ADDRESS", "Where to listen; 0.0.0.0 lets all who know the address look and set."),
    ] = HERE,
    port: Annotated[
        int, option("NUMBER", "The port; 0 takes a free one.", min=0, max=65535)
    ] = PORT,
    define: options.Define = None,
) -> None:
    """Move a laboratory by hand, in the browser.

    The page shows the scene in 3-D, with handles and sliders for the numbers among its <default>s.
    Photograph, reconstruction and standard error follow. Ctrl-C ends the command.
    """
    require("viser")
    _check_place(out)
    given = parse_definitions(define)
    image = image or (IMAGE if photo is None else "")
    first = Choice({}, image, ambient or "", sbr, snr, method)
    with progress("loading the scene", lines=False):
        # Takes seconds, in which a user would see nothing.
        from periscopy_sim.live.session import LiveSession

        _check(first, photo)
        scenario = inputs.load(scene, hidden, define)
        if first.image:
            inputs.hidden_image(first.image, scenario.hidden_shape)
        shot = _shot(photo, scenario, inputs.read_mask(mask, scenario))

        def save(pictures: LivePictures) -> str:
            write_view(out, pictures, given, photo)
            return f"wrote {out}"

        session = LiveSession(
            scenario, first, _offered(), save, report_sentences, shot=shot, host=host, port=port
        )
    with session:
        say(f"{session.page.gate.url} shows {scenario.path.name}; Ctrl-C ends it")
        try:
            session.run()
        except KeyboardInterrupt:
            say("closed")


class _Tried(Exception):  # noqa: N818  nothing is wrong
    """A folder can be made."""


def _check_place(out: Path) -> None:
    """Reject a folder that the page's button could not write; the trial leaves nothing."""
    with suppress(_Tried), staged_folder(out):
        raise _Tried


def _check(first: Choice, photo: Path | None) -> None:
    """Reject a wrong method or place before anything is loaded."""
    from periscopy_sim.evaluation.methods import find_method
    from periscopy_sim.storage.ambient_library import find_condition

    find_method(first.method)
    if first.place:
        if photo is not None:
            raise PeriscopyError("--ambient is of synthetic photographs; leave it or PHOTO out")
        find_condition(first.place)


def _shot(photo: Path | None, scenario: Scenario, used: inputs.Mask | None) -> Shot | None:
    """Read the photograph, and mask its defects."""
    from periscopy_sim.live.level import Shot

    if photo is None:
        return None
    given = inputs.read_photograph(photo, scenario, used)
    defects = inputs.look_for_defects(given.values, used, str(photo))
    return Shot(given.values, defects.used)


def _offered() -> Offered:
    """Return the shipped images and places, and the methods that are installed."""
    from importlib.util import find_spec

    from periscopy_sim.live.page import Offered
    from periscopy_sim.reconstruction.registry import METHODS
    from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, scenes_folder

    images = sorted(file.stem for file in (scenes_folder() / "images").glob("*.png"))
    methods = [name for name, each in METHODS.items() if not each.needs or find_spec(each.needs)]
    return Offered(images, (*REALISTIC, *ADVERSARIAL), methods)
