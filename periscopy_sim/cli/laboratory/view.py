"""`periscopy view`: a laboratory in the browser, to be moved by hand."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option, parse_definitions, parse_size
from periscopy_sim.cli.laboratory.viewed import write_view
from periscopy_sim.cli.output import progress, say
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import require
from periscopy_sim.live.choice import SBR, SNR, Choice
from periscopy_sim.reconstruction.registry import DEFAULT

if TYPE_CHECKING:
    from periscopy_sim.live.level import Pictures, Shot
    from periscopy_sim.live.page import Offered

PORT = 8080
HERE = "127.0.0.1"
IMAGE = "mushroom"


def view(
    scene: arguments.SceneArgument,
    hidden: arguments.Hidden,
    photo: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PHOTO]",
            help="A photograph, as reconstruct takes it: the page then shows what the scene leaves "
            "of it. Without one, photographs are synthetic.",
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
        float, option("RATIO", "Signal-to-background ratio at first.", min=1e-6, max=1e6)
    ] = SBR,
    snr: arguments.Snr = SNR,
    method: Annotated[
        str, option("NAME", "Method at first; yours as module:callable or file.py:callable.")
    ] = DEFAULT,
    mask: arguments.MaskOption = None,
    host: Annotated[
        str, option("ADDRESS", "Where to listen; 0.0.0.0 lets other computers look and set.")
    ] = HERE,
    port: Annotated[int, option("NUMBER", "The port; 0 takes a free one.", min=0, max=65535)] = PORT,
    define: arguments.Define = None,
) -> None:
    """Show a laboratory in the browser, with handles that move what its scene declares.

    Photograph, reconstruction and standard error follow. Ctrl-C ends it.
    """
    require("viser")
    with progress("loading the scene", lines=False):
        from periscopy_sim.evaluation.methods import find_method
        from periscopy_sim.live.laboratory import LiveLaboratory
        from periscopy_sim.live.level import Level, coarse_sizes
        from periscopy_sim.live.light import AmbientLight
        from periscopy_sim.live.movable import find_movables
        from periscopy_sim.live.page import Page, refuse_taken
        from periscopy_sim.storage.ambient_library import find_condition

        find_method(method)
        if port:
            refuse_taken(host, port)
        if ambient is not None:
            find_condition(ambient)
        if photo is not None and ambient is not None:
            raise PeriscopyError("--ambient is of synthetic photographs; leave it or PHOTO out")
        if image is not None or photo is None:
            inputs.hidden_image(image or IMAGE, parse_size(hidden))
        scenario = inputs.load(scene, hidden, define)
        used = inputs.read_mask(mask, scenario)
        shot = _shot(photo, scenario, used)
        path, given = scenario.path, parse_definitions(define)
        share = 1.0 if shot is None or shot.used is None else float(shot.used.mean())
        small = coarse_sizes(scenario.photograph_shape, scenario.hidden_shape, share)
        sizes = scenario.photograph_shape, scenario.hidden_shape
        light = AmbientLight(path, given, scenario.hidden_shape, lambda place, why: arrived())
        coarse = Level(path, given, *small, light.photograph, shot, is_coarse=True)
        full = Level(path, given, *sizes, light.photograph, shot, is_coarse=False)
        movables, handles = find_movables(path, given, coarse.scenario)
    first = Choice(
        values={each.name: each.value for each in movables},
        image=(image or IMAGE) if photo is None else (image or ""),
        place=ambient or "",
        sbr=sbr,
        snr=snr,
        method=method,
    )
    page = Page(
        host, port, scenario, movables, handles, _offered(), first, is_given=photo is not None
    )
    laboratory = LiveLaboratory(coarse, full, page.show, page.tell)

    def arrived() -> None:
        laboratory.want(page.choice)

    def save(pictures: Pictures) -> None:
        write_view(out, pictures, given, hidden, photo)
        page.tell(f"wrote {out}")

    page.want, page.save = laboratory.want, lambda: laboratory.save(save)
    say(f"http://{host}:{page.port} shows {path.name}; Ctrl-C ends it")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            laboratory.want(first)
            laboratory.run()
    except KeyboardInterrupt:
        say("closed")
    finally:
        light.close()
        page.close()


def _shot(photo: Path | None, scenario: Any, used: Any) -> Shot | None:
    """Read the photograph, and leave out what measures no light of the wall."""
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
