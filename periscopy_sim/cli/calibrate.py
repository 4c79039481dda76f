"""`periscopy calibrate`: the parameters of a scene, or an occluder's form, from photographs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.cli import options as arguments
from periscopy_sim.cli import output
from periscopy_sim.cli.messages import distrusted, sentence
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics.validation import number_of, size_of
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.storage.outputs import spare_inputs

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Parameter

_PHOTO = "One or more photographs, between which only the monitor's picture changed."
_SHOWN = (
    "Picture that the monitor showed in the first photograph; repeat for the second, and so on. "
    "The pictures of further photographs are unknown. Of several surfaces: ID=IMAGE,ID=IMAGE."
)
_FREE = (
    "<default>s to estimate, such as occluder_dx,occluder_dz=0.005. ERROR is the measurement "
    "error. [default: all NAME with a NAME_error]"
)
_UNCERTAIN = (
    "Measurement errors of fixed <default>s, which the result's errors include; 'none' includes "
    "none; repeatable. [default: all NAME_error of what is not free]"
)
_SILHOUETTE = "Recover this shape's silhouette instead: a flat mask of cells within its rectangle."
_CELLS = "Cells of --silhouette. [default: 16 along the longer side]"
_UNKNOWN = (
    "Find a piece that nobody measured instead, of the likeliest of these kinds: ball, box, plate, "
    "cylinder, by comma."
)
_WITHIN = "Where the middle of --unknown may be. [default: between monitor and wall]"
_SIZES = "Extents of --unknown, in metres. [default: 2 to 30 % of the monitor's distance]"
_OUT = (
    "Scene to write, NAME.xml, with NAME.json and NAME.png beside it, and scenes that explain as "
    "much, NAME_aside1.xml, if there are such."
)


@dataclass(eq=False, kw_only=True)
class CalibrationSession(PhotoSession):
    """Photographs of one laboratory, pictures shown in the first ones, and what goes with them."""

    photo: Annotated[list[Path], arguments.argument("PHOTO", _PHOTO, exists=True)]
    shown: Annotated[
        list[str] | None, arguments.option("[ID=]IMAGE", _SHOWN, group=arguments.PHOTOGRAPH)
    ] = None

    @property
    def inputs(self) -> list[Path | None]:
        """The files that are read."""
        mask, monitor_off = self.files()
        return [*self.photo, mask, *monitor_off, self.path, self.colour_matrix]

    def read(self) -> tuple[list["ps.Photograph"], list[Any]]:
        """Return the photographs, and the pictures that the monitor showed in the first ones."""
        self.warn_of(self.scenario.check(), but=("shadows",))  # which a calibration may mend
        wall = self.wall(self.photo[0])
        others = [self.photograph(file, wall.mask) for file in self.photo[1:]]
        several = len(self.scenario.hidden) > 1
        shown = [text.split(",") if several else [text] for text in self.shown or ()]
        pictures = [self.scenario.image(self.by_surface(each, "--shown")) for each in shown]
        return [wall, *others], pictures

    def write(self, file: Path, record: dict[str, Any]) -> None:
        """Write a result's record, and where it is from, as JSON."""
        origin = {
            "photograph": str(self.photo[0]),
            "photographs": [str(file) for file in self.photo],
            "shown": self.shown or [],
            "scene": str(self.path),
        }
        self.write_summary(file, {**origin, **record})


def calibrate(
    session: CalibrationSession,
    out: Annotated[Path, arguments.option("FILE", _OUT, group=arguments.OUTPUT)],
    free: Annotated[str | None, arguments.option("NAME[=ERROR],...", _FREE)] = None,
    uncertain: Annotated[list[str] | None, arguments.option("NAME[=ERROR],...", _UNCERTAIN)] = None,
    silhouette: Annotated[str | None, arguments.option("SHAPE", _SILHOUETTE)] = None,
    cells: Annotated[str | None, arguments.option("ROWSxCOLUMNS", _CELLS)] = None,
    unknown: Annotated[str | None, arguments.option("KIND,...", _UNKNOWN)] = None,
    within: Annotated[str | None, arguments.option("X:X,Y:Y,Z:Z", _WITHIN)] = None,
    sizes: Annotated[str | None, arguments.option("LEAST:MOST", _SIZES)] = None,
) -> None:
    """Correct a scene's measured values from photographs of its wall.

    The search starts from the values in the scene file, or those of -D, and weighs them by their
    standard errors. NAME.json lists the estimates, their standard errors and the search. A result
    that you should not trust is written, too, with a warning and "trusted": false.
    """
    arguments.require_suffix(out, ".xml", "the scene")
    if unknown is None and (within or sizes):
        raise SceneError("--within and --sizes are those of --unknown KIND; name a kind")
    if unknown is not None:
        if free or uncertain or silhouette or cells or session.shown or session.colour_matrix:
            raise SceneError(
                "--unknown finds a piece alone; leave out --free, --uncertain, --silhouette, "
                "--cells, --shown and --colour-matrix"
            )
        find_piece(session, out, unknown, within, sizes)
    elif silhouette is None:
        if cells is not None:
            raise SceneError("--cells are those of --silhouette SHAPE; name the shape")
        find_parameters(session, out, free, uncertain or [])
    else:
        if free or uncertain or session.colour_matrix:
            names = "--free, --uncertain and --colour-matrix"
            raise SceneError(f"--silhouette finds a form, and all numbers stay; leave out {names}")
        find_silhouette(session, out, silhouette, cells)


def find_parameters(
    session: CalibrationSession, out: Path, free: str | None, uncertain: list[str]
) -> None:
    """Find parameters; write the scene that has them, JSON and a picture."""
    from periscopy_sim.calibration.search import ASIDES
    from periscopy_sim.figures.calibration import draw_calibration

    document = session.scenario.document
    freed = None if free is None else arguments.parse_errors(free, "--free")
    named = ",".join(each for each in uncertain if each != "none")
    errors = arguments.known_errors(named, document) if uncertain else None
    colours = {"colour_matrix": session.colours.matrix} if session.colours else {}
    outputs = out, out.with_suffix(".json"), out.with_suffix(".png")
    with output.output_files(*outputs, inputs=session.inputs) as (scene, json, png):
        asides = [out.with_stem(f"{out.stem}_aside{k + 1}") for k in range(ASIDES)]
        spare_inputs(asides, session.inputs)
        photographs, shown = session.read()
        _write_copy(session, scene, {}, out)  # proves now that it can be written
        with (
            session.timed("calibrate"),
            output.fixable("calibrate"),
            output.progress("calibrating") as report,
        ):
            result = session.scenario.calibrate(
                photographs, shown=shown, free=freed, uncertain=errors, progress=report
            )
        remark = _distrust("periscopy calibrate", result.doubts)
        _write_copy(session, scene, _written(result, result.values), out, remark)
        session.warn(*result.doubts)
        session.write(json, result.record() | colours)
        draw_calibration(png, photographs[0], result, document.units, session.metadata)
        beside = asides[: len(result.rivals)]
        with output.output_files(*beside) as staged:  # last: all files are whole by then
            for rival, aside, file in zip(result.rivals, beside, staged, strict=True):
                _write_copy(session, file, _written(result, rival.values), aside, remark)
    for stale in asides[len(beside) :]:
        stale.unlink(missing_ok=True)
    show_calibration(result, document.units)
    if result.rivals:
        say_rivals(result, [out, *beside], document.units, outputs[-1])


def _written(result: "ps.Calibration", values: Mapping[str, float]) -> dict[str, str]:
    """Return free parameters' values, and the covariance about them, as a scene file has them."""
    known = result.scene_covariance
    known = replace(known, values=np.array([*values.values(), *known.values[len(values) :]]))
    return {n: f"{value:.9g}" for n, value in values.items()} | {CALIBRATED: known.text()}


def say_rivals(
    result: "ps.Calibration", scenes: Sequence[Path], units: Mapping[str, str], picture: Path
) -> None:
    """Print how likely each place of the image is, and which number differs most there."""

    def about(probability: float) -> str:  # which is no better known
        return f"about {10 * max(round(10 * probability), 1)} %"

    own = 1 - sum(rival.probability for rival in result.rivals)
    shares = [f"{scenes[0]} ({about(own)})"]
    for scene, rival in zip(scenes[1:], result.rivals, strict=True):
        moves = {p.name: rival.values[p.name] - p.value for p in result.parameters}
        name = max(result.parameters, key=lambda p: abs(moves[p.name]) / p.ruler_error).name
        moved = f"{name} {moves[name]:+.2g} {units.get(name, '')}".rstrip()
        shares.append(f"{scene} ({about(rival.probability)}; {moved})")
    output.say(sentence("rivals", scenes=", ".join(shares), picture=picture))


def _distrust(result: str, doubts: Sequence[str]) -> str:
    """Return the remark in a scene whose result is not trusted; empty if it is."""
    return f"{result}: not trusted: {'; '.join(doubts)}" if doubts else ""


def _write_copy(
    session: PhotoSession, staged: Path, values: Mapping[str, str], out: Path, remark: str = ""
) -> None:
    """Write a scene with other defaults; without any, see that it loads from where it lies."""
    try:
        write_copy(session.scenario.document, values, staged, remark)
        if not values:  # values that the scene took load from anywhere
            ps.load_scenario(staged, session.sizes, camera=session.sensor)
    except SceneError as error:
        raise SceneError(
            f"--out {out}: a copy of scene '{session.path}' does not load from there; name a file "
            f"beside the scene ({str(error).replace(str(staged), str(out))})"
        ) from None


def find_piece(
    session: CalibrationSession, out: Path, kinds: str, within: str | None, sizes: str | None
) -> None:
    """Find a piece that nobody measured; write the scene that has it, JSON and a picture."""
    from periscopy_sim.figures.calibration import draw_calibration

    names = [each.strip() for each in kinds.split(",")]
    box = None if within is None else [_range(each, "--within") for each in within.split(",")]
    extents = None if sizes is None else _range(sizes, "--sizes")
    with output.output_files(
        *(out.with_suffix(each) for each in (".json", ".png")), inputs=session.inputs
    ) as (json, png):
        spare_inputs([out], session.inputs)
        (photographs, _), doing = session.read(), "find the piece"
        with session.timed(doing), output.fixable("--unknown"), output.progress(doing) as report:
            piece = session.scenario.find_occluder(
                photographs, out, kinds=names, within=box, sizes=extents, progress=report
            )
        result = piece.calibration
        session.warn(*result.doubts)
        session.write(json, piece.record())
        units = result.scenario.document.units if result.scenario else {}
        draw_calibration(png, photographs[0], result, units, session.metadata)
    output.written(*piece.files)
    kinds_by = sorted(piece.probabilities.items(), key=lambda each: -each[1])
    output.show_table([[kind, f"{100 * share:.0f} %"] for kind, share in kinds_by], ["kind", ""])
    show_calibration(result, units)


def _range(text: str, flag: str) -> tuple[float, float]:
    """Read ``LEAST:MOST``."""
    ends = tuple(number_of(each) for each in text.split(":"))
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise SceneError(f"{flag} {text}: write the least and the most, in metres, as 0.1:0.4")
    return ends[0], ends[1]


def find_silhouette(session: CalibrationSession, out: Path, shape: str, cells: str | None) -> None:
    """Find the silhouette of a shape; write a scene that has it, its mesh, JSON and a picture."""
    from periscopy_sim.calibration.silhouette import write_masked_scene
    from periscopy_sim.figures.calibration import draw_silhouette
    from periscopy_sim.numerics.validation import percentages

    size = None if cells is None else size_of(cells)
    mesh = out.with_name(f"{out.stem}_{shape}.ply")
    picture = out.with_name(f"{out.stem}_silhouette.png")
    outputs = out, mesh, out.with_suffix(".json"), picture
    with output.output_files(*outputs, inputs=session.inputs) as (scene, ply, json, png):
        (photographs, shown), doing = session.read(), "find the silhouette"
        with session.timed(doing), output.fixable("--silhouette"), output.progress(doing) as report:
            solution = session.scenario.recover_silhouette(
                photographs, shape, cells=size, shown=shown, progress=report
            )
        origin = f"'{shape}' is a silhouette by periscopy calibrate --silhouette"
        remark = _distrust(origin, solution.doubts) or origin
        write_masked_scene(session.scenario.document, solution, scene, ply, mesh.name, remark)
        session.warn(*solution.doubts)
        session.write(json, solution.record())
        draw_silhouette(png, photographs[0], solution, session.metadata)
    for row in solution.opaque:
        output.say("  " + "".join("##" if cell else " ." for cell in row))
    output.say(f"the photograph shows the shadows of {solution.seen.sum()} of these cells")
    if solution.depth.is_free:
        show_parameters(solution.parameters, session.scenario.document.units)
    if solution.starts:
        output.say("silhouette and image may both be shifted, against each other")
    without, with_it = percentages(solution.unexplained_open, solution.unexplained)
    if solution.doubts:
        output.conclude(sentence("distrusted", what="silhouette"), "red")
    else:
        output.conclude(sentence("silhouette", without=without, with_it=with_it), "green")


def show_parameters(parameters: Sequence["Parameter"], units: Mapping[str, str]) -> None:
    """Print parameters with their units, measured values, and what each rests on."""
    from periscopy_sim.calibration.result import ParameterSource
    from periscopy_sim.numerics.validation import with_error

    rows = []
    for p in parameters:
        value = with_error(p.value, p.standard_error, units.get(p.name, ""))
        source: str = p.source
        if p.source is ParameterSource.PHOTOGRAPH_ALONE:
            alone = with_error(p.value, p.statistical_error).partition(" ")[2]
            source += f" ({alone} then)"
        rows.append([p.name, value, with_error(p.start, p.ruler_error), source])
    output.show_table(rows, ["parameter", "calibrated", "measured", "source"])


def show_calibration(result: "ps.Calibration", units: Mapping[str, str]) -> None:
    """Print the parameters with their units, the gain and the colours, and whether to trust."""
    from periscopy_sim.calibration.prior import FARTHEST
    from periscopy_sim.numerics.validation import percentages

    show_parameters(result.parameters, units)
    before, after = percentages(*result.unexplained)
    rows = [
        ["unexplained", f"{after} %", f"{before} % with the measured values"],
        ["gain over the wall", f"{result.gain.min():.2f} to {result.gain.max():.2f}", ""],
    ]
    if result.overdispersion > 1:
        reason = "with more, the numbers end farther than rulers err"
        rows.append(["photograph's weight", f"1/{result.overdispersion:g}", reason])
    if fixed := result.uncertain.names:
        names = f"all {len(fixed)}" if len(fixed) > 3 else ", ".join(fixed)
        rows.append(["fixed numbers", names, "counted in the errors; not by --uncertain none"])
    output.show_table(rows)
    if result.colour_matrix is None or result.colour_errors is None:
        output.say(sentence("any_place"))
    else:
        pairs = np.stack([result.colour_matrix, result.colour_errors], axis=2)
        camera = dict(zip(("red", "green", "blue"), pairs, strict=True))
        rows = [[n, *(f"{m:.2f} ± {error:.2f}" for m, error in row)] for n, row in camera.items()]
        output.show_table(rows, ["camera, from the monitor's", *camera])
        if result.assumes_colours and result.trusted:
            output.say(sentence("assumed_colours"))
    if not result.trusted:
        distant = [p.name for p in result.parameters if p.distance > FARTHEST]
        output.conclude(distrusted("distrusted", distant, what="calibration"), "red")
    elif result.rivals:
        output.conclude(sentence("rival", count=len(result.rivals)), "yellow")
    elif not result.moved:
        output.conclude(sentence("kept"), "yellow")
    else:
        output.conclude(sentence("trusted", before=before, after=after), "green")
