"""`periscopy calibrate`: the parameters of a scene, or an occluder's form, from photographs."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.output import fixable, output_files, progress, say, say_written, warn_boxed
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics.limits import size_of
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration
    from periscopy_sim.calibration.silhouette.result import Silhouette

_SHOWN = (
    "Picture that the monitor showed in the first photograph; repeat for the second, and so on. "
    "The pictures of further photographs are unknown. Of several surfaces: ID=IMAGE,ID=IMAGE."
)
_FREE = (
    "<default>s to estimate, such as occluder_dx,occluder_dz=0.005. ERROR is the standard error of "
    "the measured value. [default: all NAME with a NAME_error]"
)
_UNCERTAIN = (
    "Standard errors of fixed <default>s, which the result's errors include; 'none' includes none; "
    "repeatable. [default: all NAME_error of what is not free]"
)
_SILHOUETTE = "Recover this shape's silhouette instead: a flat mask of cells within its rectangle."
_CELLS = "Cells of --silhouette. [default: 16 along the longer side]"
_OUT = (
    "Scene to write, NAME.xml, with NAME.json and NAME.png beside it, and scenes that explain as "
    "much, NAME_aside1.xml, if there are such."
)


@dataclass(eq=False, kw_only=True)
class CalibrationSession(PhotoSession):
    """Photographs of one laboratory, pictures shown in the first ones, and what goes with them."""

    photo: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTO",
            help="One or more photographs, between which only the monitor's picture changed.",
            exists=True,
        ),
    ]
    shown: Annotated[list[str] | None, option("[ID=]IMAGE", _SHOWN, group=PHOTOGRAPH)] = None

    @property
    def inputs(self) -> list[Path | None]:
        """The files that are read."""
        others = self.path, self.colour_matrix
        return [*self.photo, *(self.mask or ()), *(self.monitor_off or ()), *others]

    def read(self) -> dict[str, Any]:
        """Return arguments of `calibrate` and of `recover_silhouette`."""
        self.check_lights()
        wall = self.wall(self.photo[0])
        others = [self.photograph(file, wall.mask) for file in self.photo[1:]]
        return {
            "photograph": [wall, *others],
            "scene": self.scenario.scene,
            "hidden": self.sizes,
            "camera": self.sensor,
            "shown": [self.picture(text) for text in self.shown or ()],
            "seed": self.seed,
        }

    def picture(self, text: str) -> Any:
        """Read what the hidden surfaces showed in a photograph."""
        entries = text.split(",") if len(self.scenario.hidden) > 1 else [text]
        return self.hidden_image(self.by_surface(entries, "--shown"))

    def write(self, file: Path, record: dict[str, Any]) -> None:
        """Write a result's record, and where it is from, as JSON."""
        self.warnings += record["doubts"]
        origin = {
            "photograph": str(self.photo[0]),
            "photographs": [str(file) for file in self.photo],
            "shown": self.shown or [],
            "scene": str(self.path),
        }
        self.write_summary(file, {**origin, **record})


def calibrate(
    session: CalibrationSession,
    out: Annotated[Path, option("FILE", _OUT, group=arguments.OUTPUT)],
    free: Annotated[str | None, option("NAME[=ERROR],...", _FREE)] = None,
    uncertain: Annotated[list[str] | None, option("NAME[=ERROR],...", _UNCERTAIN)] = None,
    silhouette: Annotated[str | None, option("SHAPE", _SILHOUETTE)] = None,
    cells: Annotated[str | None, option("ROWSxCOLUMNS", _CELLS)] = None,
) -> None:
    """Correct a scene's measured values from photographs of its wall.

    The search starts from the values in the scene file, or those of -D, and weighs them by their
    standard errors. NAME.json lists the estimates, their standard errors and the search. A result
    that you should not trust is written, too, with a warning and "trusted": false.
    """
    arguments.require_suffix(out, ".xml", "the scene")
    if silhouette is None and cells is not None:
        raise SceneError("--cells are those of --silhouette SHAPE; name the shape")
    if silhouette is None:
        find_parameters(session, out, free, uncertain or [])
    elif free or uncertain or session.colour_matrix:
        names = "--free, --uncertain and --colour-matrix"
        raise SceneError(f"--silhouette finds a form, and all numbers stay; leave out {names}")
    else:
        find_silhouette(session, out, silhouette, cells)


DISTRUSTED = (
    "Look at the picture. Measure again what is named above, free fewer parameters (--free), leave "
    "out what is not bare wall (--mask), or add a photograph with the monitor off (--monitor-off)."
)
"""What to do with a calibration that is not to be trusted."""

NEGLIGIBLE = 0.1
"""Of how far an error of a fixed number moves the free ones, over the errors of their rulers."""

DOUBTED = (
    "Look at the picture: a silhouette that looks like nothing is nothing. Show known pictures "
    "(--shown), move the plane in which it is sought (-D), draw its rectangle closer, or ask for "
    "fewer --cells."
)
"""What to do with a silhouette that is not to be trusted."""

PARAMETER = "start", "value", "statistical_error", "standard_error", "ruler_error", "determined"
SILHOUETTE = "opacities", "unexplained_open", "unexplained", "starts", "evidence"
"""What the JSON files have of a `Parameter` and of a `Silhouette`, under its own name."""


def find_parameters(
    session: CalibrationSession, out: Path, free: str | None, uncertain: list[str]
) -> None:
    """Find parameters; write the scene that has them, JSON and a picture."""
    from periscopy_sim.figures.calibration import draw_calibration

    document = session.scenario.document
    freed = None if free is None else arguments.parse_errors(free, "--free")
    named = ",".join(each for each in uncertain if each != "none")
    errors = arguments.known_errors(named, document) if uncertain else None
    colours = session.colours
    outputs = out, out.with_suffix(".json"), out.with_suffix(".png")
    with output_files(outputs, session.inputs) as (scene, json, png), ExitStack() as stack:
        with progress("loading"):  # takes seconds
            from periscopy_sim.calibration.calibrate import calibrate
            from periscopy_sim.calibration.search import ASIDES

        asides = [out.with_stem(f"{out.stem}_aside{k + 1}") for k in range(ASIDES)]
        spare_inputs(asides, session.inputs)
        files = session.read()
        _write_copy(session, scene, {}, out)  # proves now that it can be written
        with session.timed("calibrate"), fixable("calibrate"), progress("calibrating") as report:
            result = calibrate(free=freed, uncertain=errors, progress=report, **files)
        remark = _distrust("periscopy calibrate", result.doubts)
        _write_copy(session, scene, _written(result, result.values), out, remark)
        record = calibration_record(result)
        session.write(json, record | ({"colour_matrix": colours.matrix} if colours else {}))
        draw_calibration(png, files["photograph"][0], result, document.units, session.metadata)
        for rival, aside in zip(result.rivals, asides, strict=False):
            values = _written(result, rival.values)
            _write_copy(session, stack.enter_context(staged_file(aside)), values, aside, remark)
    written = [*outputs, *asides[: len(result.rivals)]]
    for stale in asides[len(result.rivals) :]:
        stale.unlink(missing_ok=True)
    say_calibration(result, document.units)
    if result.rivals:
        say_rivals(result, [out, *written[len(outputs) :]], document.units, outputs[-1])
    say_written(*written)
    if result.doubts:
        reasons = (*result.doubts, *fixed_numbers(result, document.units))
        warn_boxed("this calibration is not to be trusted", reasons, DISTRUSTED)


def _written(result: "Calibration", values: Mapping[str, float]) -> dict[str, str]:
    """Return free parameters' values, and the covariance about them, as a scene file has them."""
    known = result.scene_covariance
    known = replace(known, values=np.array([*values.values(), *known.values[len(values) :]]))
    return {n: f"{value:.9g}" for n, value in values.items()} | {CALIBRATED: known.text()}


def say_rivals(
    result: "Calibration", scenes: Sequence[Path], units: Mapping[str, str], picture: Path
) -> None:
    """Print how likely each place of the image is, and which number differs most there."""
    from periscopy_sim.calibration.search import SURE

    own = 1 - sum(rival.probability for rival in result.rivals)
    shares = [f"{scenes[0]} ({_about(own)})"]
    for scene, rival in zip(scenes[1:], result.rivals, strict=True):
        moves = {p.name: rival.values[p.name] - p.value for p in result.parameters}
        name = max(result.parameters, key=lambda p: abs(moves[p.name]) / p.ruler_error).name
        moved = f"{name} {moves[name]:+.2g} {units.get(name, '')}".rstrip()
        shares.append(f"{scene} ({_about(rival.probability)}; {moved})")
    say(sentence("rivals", scenes=", ".join(shares), least=100 * SURE, picture=picture))


def _about(probability: float) -> str:
    """Return a probability in tens of per cent, since it is no better known."""
    return f"about {10 * max(round(10 * probability), 1)} %"


def fixed_numbers(result: "Calibration", units: Mapping[str, str]) -> Iterator[str]:
    """Yield a sentence on the fixed numbers whose errors move the result most."""
    from periscopy_sim.model.residual import with_error

    fixed, free = result.uncertain, np.array([p.ruler_error for p in result.parameters])
    effects = np.sqrt(np.sum((result.moves / free[:, None]) ** 2, axis=0))
    most = [k for k in np.argsort(-effects)[:3] if effects[k] > NEGLIGIBLE]
    if most:
        numbers = (
            f"{name} {with_error(value, error, units.get(name, ''))}"
            for name, value, error in (
                (fixed.names[k], fixed.values[k], fixed.standard_errors[k]) for k in most
            )
        )
        yield f"fixed numbers may be wrong, above all {', '.join(numbers)}: free these"


def _distrust(result: str, doubts: Sequence[str]) -> str:
    """Return the remark in a scene whose result is not to be trusted; empty if it is."""
    return f"{result}: NOT TO BE TRUSTED: {'; '.join(doubts)}" if doubts else ""


def _write_copy(
    session: PhotoSession,
    staged: Path,
    values: Mapping[str, str],
    out: Path,
    remark: str = "",
) -> None:
    """Write a scene with other defaults; without any, see that it loads from where it lies."""
    from periscopy_sim.calibration.calibrated_scene import write_copy

    try:
        write_copy(session.scenario.document, values, staged, remark)
        if not values:  # values that the scene took load from anywhere
            ps.load_scenario(staged, session.sizes, camera=session.sensor)
    except SceneError as error:
        raise SceneError(
            f"--out {out}: a copy of scene '{session.path}' does not load from there; name a file "
            f"beside the scene ({str(error).replace(str(staged), str(out))})"
        ) from None


def find_silhouette(session: CalibrationSession, out: Path, shape: str, cells: str | None) -> None:
    """Find the silhouette of a shape; write a scene that has it, its mesh, JSON and a picture."""
    from periscopy_sim.calibration.silhouette.recover import recover_silhouette
    from periscopy_sim.calibration.silhouette.scene import write_masked_scene
    from periscopy_sim.figures.calibration import draw_silhouette

    size = None if cells is None else size_of(cells)
    mesh = out.with_name(f"{out.stem}_{shape}.ply")
    picture = out.with_name(f"{out.stem}_silhouette.png")
    outputs = out, mesh, out.with_suffix(".json"), picture
    with output_files(outputs, session.inputs) as (scene, ply, json, png):
        files, doing = session.read(), "find the silhouette"
        with session.timed(doing), fixable("--silhouette"), progress(doing) as report:
            solution = recover_silhouette(shape=shape, cells=size, progress=report, **files)
        origin = f"'{shape}' is a silhouette by periscopy calibrate --silhouette"
        remark = _distrust(origin, solution.doubts) or origin
        write_masked_scene(session.scenario.document, solution, scene, ply, mesh.name, remark)
        session.write(json, silhouette_record(solution))
        draw_silhouette(png, files["photograph"][0], solution, session.metadata)
    say_silhouette(solution)
    say_written(*outputs)
    if solution.doubts:
        warn_boxed("this silhouette is not to be trusted", solution.doubts, DOUBTED)


def calibration_record(result: "Calibration") -> dict[str, Any]:
    """Return a calibration as its JSON file has it."""
    fixed = result.uncertain

    def by_name(values: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(result.values, values, strict=True))

    return {
        "trusted": result.trusted,
        "doubts": result.doubts,
        "better_than_start": result.moved,
        "parameters": {p.name: {n: getattr(p, n) for n in PARAMETER} for p in result.parameters},
        "uncertain": {
            name: {"value": value, "standard_error": error, "moves": by_name(moves)}
            for name, value, error, moves in zip(
                fixed.names, fixed.values, fixed.standard_errors, result.moves.T, strict=True
            )
        },
        "correlation": by_name(map(by_name, result.correlation)),
        "unexplained_before": result.noise_before,
        "unexplained": result.noise,
        "overdispersion": result.overdispersion,
        "gain": {"least": result.gain.min(), "largest": result.gain.max()},
        "colour_matrix": result.colour_matrix,
        "colour_errors": result.colour_errors,
        "rivals": [{"values": r.values, "probability": r.probability} for r in result.rivals],
        "path": [{"values": rows[:, :-1], "evidence": rows[:, -1]} for rows in result.path],
    }


def silhouette_record(solution: "Silhouette") -> dict[str, Any]:
    """Return a silhouette as its JSON file has it."""
    return {
        "shape": solution.name,
        "trusted": not solution.doubts,
        "doubts": solution.doubts,
        "rectangle": {way: getattr(solution.plane, way) for way in ("corner", "across", "down")},
        "opaque": ["".join("#" if cell else "." for cell in row) for row in solution.opaque],
        "cells_seen": int(solution.seen.sum()),
        "cells_decided": solution.decided,
        "starts_agreeing": solution.agreeing,
        **{key: getattr(solution, key) for key in SILHOUETTE},
    }


def say_calibration(result: "Calibration", units: Mapping[str, str]) -> None:
    """Print what is unexplained, the parameters with their units, the gain and the colours."""
    from periscopy_sim.calibration.result import DeterminedBy
    from periscopy_sim.model.residual import percentages, with_error

    before, after = percentages(*result.unexplained)
    verdict = "" if result.moved else "; no significant improvement, the measured values are kept"
    say(f"unexplained in calibration: {before} % by the measured scene, {after} % now{verdict}")
    if result.overdispersion > 1:
        reason = "because the scene does not explain it fully"
        say(f"the photograph's weight was divided by {result.overdispersion:g} {reason}")
    width = max(len(p.name) for p in result.parameters)
    for p in result.parameters:
        value = with_error(p.value, p.standard_error, units.get(p.name, ""))
        trust: str = p.determined_by
        if p.determined_by is DeterminedBy.PHOTOGRAPH_ALONE:
            alone = with_error(p.value, p.statistical_error).partition(" ")[2]
            trust += f" ({alone} then)"
        say(f"{p.name:{width}}  {value}  measured {with_error(p.start, p.ruler_error)}  {trust}")
    if fixed := result.uncertain.names:
        names = f"all {len(fixed)}" if len(fixed) > 3 else ", ".join(fixed)
        say(f"standard errors include those of fixed numbers ({names}); --uncertain none does not")
    say(f"smooth gain over the wall: {result.gain.min():.2f} to {result.gain.max():.2f}")
    if result.colour_matrix is None or result.colour_errors is None:
        say(sentence("any_place"))
    else:
        pairs = np.stack([result.colour_matrix, result.colour_errors], axis=2)
        rows = "; ".join(", ".join(f"{m:.2f} ± {error:.2f}" for m, error in row) for row in pairs)
        say(f"colour matrix, from the monitor's to the camera's, up to exposure: {rows}")
        if result.assumes_colours and result.trusted:
            say(sentence("assumed_colours"))


def say_silhouette(solution: "Silhouette") -> None:
    """Print what the mask looks like and how far it is to be believed."""
    from periscopy_sim.model.residual import percentages

    for row in solution.opaque:
        say("  " + "".join("##" if cell else " ." for cell in row))
    cells, seen = solution.opaque.size, solution.seen.sum()
    say(f"of {cells} cells the photograph shows the shadows of {seen}")
    without, with_it = percentages(solution.unexplained_open, solution.unexplained)
    say(f"unexplained: {without} % of the photograph without it, {with_it} % with it")
    if solution.starts:
        say("silhouette and image may both be shifted, against each other")
