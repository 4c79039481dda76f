"""A laboratory taken the way that a user goes, with the picture after each step.

Each person's ruler gives a scene. Before it stand the photograph as it comes (only averaged to the
scene's film), the same rectified by points of the wall, that with a photograph of the monitor off,
and that before the calibrated scene. The first columns have the true scene and an even wall.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.drawing import PAGE, drawn
from experiments.laboratories.commands import CommandError, User
from experiments.laboratories.making.laboratories import LABORATORIES
from experiments.laboratories.making.laboratory import Laboratory
from experiments.page import described
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import package_sha256
from periscopy_sim.evaluation.metrics import registered
from periscopy_sim.figures.style import mpl
from periscopy_sim.numerics import Array
from periscopy_sim.storage.outputs.staging import staged_file

TRUE, TRUE_OFF = "true scene, even wall", "the same, monitor off"
AS_IT_COMES, PREPARED = "as it comes", "prepare"
BACKGROUND, CALIBRATED = "--monitor-off", "calibrate"
ROW = 1.6
"""Inches that a step's pictures are high."""

WORDS = 1.4
"""Inches for what a step is, and its numbers."""

REACH = 3.0
"""Patches, the largest shift after which a picture is compared: what a centimetre of an occluder's
place can be. The commands tell that of at most 2."""

BEST_SHIFT = f"the best shift of at most {REACH:.0f} patches"
MOST_LOST, LEAST_WON = 4.0, -0.3
"""dB that are asked of calibration: on the true scene's picture, and on the ruler's."""

KINDS = {"psnr": "unshifted", "registered": f"after {BEST_SHIFT}"}
"""Of PSNR, and what each is."""

STAGES = (TRUE, TRUE_OFF, AS_IT_COMES, PREPARED, BACKGROUND, CALIBRATED)


@dataclass(frozen=True)
class Workplace:
    """What the stages are made from, and where.

    Attributes
    ----------
    out
        Folder of the run.
    rendered
        Folder of the laboratories.
    rulers
        How many persons measure each.
    seed
        Of the commands.
    """

    out: Path
    rendered: Path
    rulers: int
    seed: int = 0

    def identity(self) -> bytes:
        """Return what tells these inputs from others."""
        return f"{self.rendered} {self.rulers}".encode()


@dataclass(frozen=True)
class Stage:
    """A picture after a step.

    Attributes
    ----------
    name
        Of the step.
    folder
        Of the reconstruction.
    psnr, registered
        dB, unshifted and after the best shift of at most `REACH` patches.
    unexplained
        Part of the photograph.
    failure
        What the command said if it failed; the numbers are NaN then.
    """

    name: str
    folder: str = ""
    psnr: float = float("nan")
    registered: float = float("nan")
    unexplained: float = float("nan")
    failure: str = ""


@dataclass(frozen=True)
class Parameter:
    """A parameter that calibration was to find.

    Attributes
    ----------
    name, ruler, value, error, true
        The ruler's value, the estimate with its standard error, and the true value.
    determined
        Whether the photograph determines it.
    """

    name: str
    ruler: float
    value: float
    error: float
    true: float
    determined: bool

    @property
    def strays(self) -> float:
        """Distance of the estimate from the true value, in standard errors."""
        return abs(self.value - self.true) / self.error if self.error else float("inf")


@dataclass(frozen=True)
class Way:
    """What one person's ruler led to."""

    laboratory: str
    ruler: int
    stages: Sequence[Stage]
    parameters: Sequence[Parameter] = ()
    trusted: bool = False
    doubts: Sequence[str] = ()

    def stage(self, name: str) -> Stage:
        """Return a step."""
        return next(found for found in self.stages if found.name == name)


def run(laboratory: Laboratory, place: Workplace) -> Section:
    """Photograph a laboratory, go the way with each ruler, and tell of it."""
    ways = [way(laboratory, number, place) for number in range(place.rulers)]
    pictures = [_draw(each, place) for each in ways]
    return Section(
        name=laboratory.name,
        title=f"The laboratory “{laboratory.name}”",
        text=described(__doc__),
        claims=list(claims(ways)),
        pictures=pictures,
        tables=[_stages_table(laboratory, ways), _parameters_table(ways)],
    )


def way(laboratory: Laboratory, number: int, place: Workplace) -> Way:
    """Go the way with one ruler, or read where it led the same package before."""
    from experiments.laboratories.making.render import make

    folder = make(laboratory, place.rendered)
    values = json.loads((folder / "truth" / "values.json").read_text("utf-8"))
    made_from = f"{values['made_from']} {package_sha256()}"
    out = place.out / "ways" / laboratory.name

    def kept(name: str, go: Callable[[User], Way]) -> Way:
        file = out / name / "way.json"
        if file.is_file():
            record = json.loads(file.read_text("utf-8"))
            if record.pop("made_from") == made_from:
                return _read(record)
        patches = "x".join(map(str, laboratory.hidden))
        gone = go(User(folder, patches, laboratory.camera.black, out / name))
        with staged_file(file) as staged:
            record = {"made_from": made_from, **asdict(gone)}
            staged.write_text(json.dumps(record, indent=2) + "\n", "utf-8")
        return gone

    true = kept("true", lambda user: _with_the_truth(laboratory, user))
    gone = kept(f"ruler_{number}", lambda user: _go(laboratory, number, user, values["true"]))
    truth = np.load(folder / "truth" / "hidden.npy")
    return replace(gone, stages=[_shifted(each, truth) for each in (*true.stages, *gone.stages)])


def all_ways(place: Workplace) -> list[Way]:
    """Go the ways of all laboratories and rulers, see `way`."""
    numbers = range(place.rulers)
    return [way(each, number, place) for each in LABORATORIES.values() for number in numbers]


def _read(record: dict[str, Any]) -> Way:
    stages = [Stage(**stage) for stage in record.pop("stages")]
    parameters = [Parameter(**parameter) for parameter in record.pop("parameters")]
    return Way(**record, stages=stages, parameters=parameters)


def _with_the_truth(laboratory: Laboratory, user: User) -> Way:
    """Reconstruct before the true scene, a wall of even paint."""
    scene = user.folder / "truth" / "scene.xml"
    points = laboratory.camera.distortion != 0  # a scene's camera has no such lens

    @cache
    def prepared(name: str) -> Path:
        return user.prepare(f"{name}_even.tiff", scene, name, points=points)

    photograph, off = partial(prepared, "photograph"), partial(prepared, "monitor_off")
    stages = [
        _stage(TRUE, user, lambda: (photograph(), scene, [])),
        _stage(TRUE_OFF, user, lambda: (photograph(), scene, [off()])),
    ]
    return Way(laboratory.name, 0, stages)


def _go(laboratory: Laboratory, number: int, user: User, true: Mapping[str, float]) -> Way:
    """Take every step; one that fails costs only those that need it."""
    ending = f"_{number}" if number else ""
    camera, ruler = (user.folder / f"{name}{ending}.xml" for name in ("ruler_camera", "ruler"))
    report: dict[str, Any] = {}

    @cache
    def rectified(name: str) -> Path:
        return user.prepare(f"{name}.tiff", ruler, name, points=True)

    def calibrated() -> Path:
        off = [rectified("monitor_off")]
        scene, found = user.calibrate(rectified("photograph"), ruler, off, "calibrated")
        report.update(found)
        return scene

    def as_it_comes() -> Path:
        return user.prepare("photograph.tiff", camera, "as_it_comes", points=False)

    photograph, off = partial(rectified, "photograph"), partial(rectified, "monitor_off")
    stages = [
        _stage(AS_IT_COMES, user, lambda: (as_it_comes(), camera, [])),
        _stage(PREPARED, user, lambda: (photograph(), ruler, [])),
        _stage(BACKGROUND, user, lambda: (photograph(), ruler, [off()])),
        _stage(CALIBRATED, user, lambda: (photograph(), calibrated(), [off()])),
    ]
    parameters = [
        Parameter(
            name, one["start"], one["value"], one["standard_error"], true[name], one["determined"]
        )
        for name, one in report.get("parameters", {}).items()
    ]
    doubts = [str(doubt) for doubt in report.get("doubts", ())]
    return Way(laboratory.name, number, stages, parameters, bool(report.get("trusted")), doubts)


def _stage(name: str, user: User, given: Callable[[], tuple[Path, Path, list[Path]]]) -> Stage:
    folder = "".join(letter if letter.isalnum() else "_" for letter in name)
    try:
        summary = user.reconstruct(*given(), folder)
    except CommandError as error:
        return Stage(name, failure=str(error))
    return Stage(
        name,
        str(user.out / folder / "picture"),
        summary["psnr"],
        unexplained=summary["unexplained"],
    )


def _shifted(stage: Stage, truth: Array) -> Stage:
    """Return a step with its PSNR after the best shift, of the picture that it left."""
    if stage.failure:
        return stage
    image = _picture(stage)
    return replace(stage, registered=registered(image, truth, reach=REACH).psnr)


def _picture(stage: Stage) -> Array:
    return np.asarray(np.load(Path(stage.folder) / "reconstruction.npy"), np.float64)


def won(ways: Sequence[Way], by: str, over: str, kind: str) -> Array:
    """Return dB that one step wins on another, for each way, `psnr` or `registered`."""
    return np.array([getattr(w.stage(by), kind) - getattr(w.stage(over), kind) for w in ways])


def claims(ways: Sequence[Way]) -> Iterator[Claim]:
    """Return what was asked of the pictures beside what came out."""
    for kind, words in KINDS.items():
        lost = -won(ways, CALIBRATED, TRUE_OFF, kind)
        median = float(np.median(lost))
        yield Claim(
            "what the calibrated scene's picture loses on the true scene's with an even wall, "
            f"{words}: median over {len(ways)} rulers",
            f"at most {MOST_LOST:g} dB",
            f"{median:.1f} dB",
            Verdict.of(median <= MOST_LOST),
            f"from {lost.min():.1f} to {lost.max():.1f} dB",
        )
        gained = won(ways, CALIBRATED, BACKGROUND, kind)
        yield Claim(
            f"what calibration wins on the ruler's scene, {words}: worst of the rulers",
            f"at least {LEAST_WON:g} dB",
            f"{gained.min():.1f} dB",
            Verdict.of(float(gained.min()) >= LEAST_WON),
            f"best {gained.max():.1f} dB",
        )


def _stages_table(laboratory: Laboratory, ways: Sequence[Way]) -> Table:
    def cell(stage: Stage) -> str:
        if stage.failure:
            return stage.failure
        return f"{stage.psnr:.1f} ({stage.registered:.1f}), {100 * stage.unexplained:.2f} %"

    return Table(
        f"Gain-matched PSNR in dB, unshifted (after {BEST_SHIFT}), and what stays unexplained; "
        f"paint uneven by {100 * laboratory.unevenness['']:.1f} %, SBR {laboratory.sbr:g}",
        ["ruler", *STAGES],
        [[str(way.ruler), *map(cell, way.stages)] for way in ways],
    )


def _parameters_table(ways: Sequence[Way]) -> Table:
    def cell(parameter: Parameter) -> str:
        estimate = f"{parameter.value:.4g} ± {parameter.error:.2g}"
        mark = ", determined" if parameter.determined else ""
        return f"{parameter.ruler:.4g}, {estimate}{mark}"

    names = [parameter.name for parameter in ways[0].parameters]
    rows = []
    for index, name in enumerate(names):
        found = [way.parameters[index] if way.parameters else None for way in ways]
        true = f"{ways[0].parameters[index].true:.4g}"
        rows.append([name, true, *(cell(each) if each else "failed" for each in found)])
    return Table(
        "Parameters: true, then for each ruler what it read and the calibrated value",
        ["parameter", "true", *(f"ruler {way.ruler}" for way in ways)],
        rows,
    )


def _draw(gone: Way, place: Workplace) -> Picture:
    """Draw the pictures and what is left of the photographs, one row a step."""
    from periscopy_sim.storage.formats.srgb import srgb_encode

    name = f"{gone.laboratory}_{gone.ruler}"
    truth = np.load(place.rendered / gone.laboratory / "truth" / "hidden.npy")
    with drawn(place.out, name, PAGE, ROW * (len(gone.stages) + 1)) as figure:
        width = ROW * truth.shape[1] / truth.shape[0]
        widths = [WORDS, width, PAGE - WORDS - width]
        axes = figure.subplots(len(gone.stages) + 1, 3, width_ratios=widths)
        for ax in axes.flat:
            ax.set_axis_off()
        _write(axes[0, 0], "hidden image")
        axes[0, 1].imshow(np.clip(srgb_encode(truth), 0, 1), interpolation="nearest")
        for (words, seen, left), stage in zip(axes[1:], gone.stages, strict=True):
            if stage.failure:
                _write(words, f"{stage.name}\n\nfailed")
                continue
            shifted = f"{stage.registered:.1f} dB after a shift"
            _write(words, f"{stage.name}\n\n{stage.psnr:.1f} dB\n{shifted}")
            picture = np.maximum(_picture(stage), 0)
            # Not `gain_matched`: one beside its place would be dim.
            energies = (np.sum(image**2, axis=(0, 1)) for image in (truth, picture))
            gain = np.sqrt(np.divide(*energies))
            seen.imshow(np.clip(srgb_encode(gain * picture), 0, 1), interpolation="nearest")
            residual = Path(stage.folder) / "residual.png"
            if residual.is_file():
                left.imshow(mpl.image.imread(residual))
                left.set_anchor("W")
    return Picture(
        place.out / f"{name}.png",
        f"Ruler {gone.ruler}: the picture after each step, each channel as strong as the hidden "
        f"image's, and what the scene leaves of the photograph; “a shift” is {BEST_SHIFT}.",
    )


def _write(ax: Any, words: str) -> None:
    """Write words, a step and its numbers, in the middle of an empty axes."""
    ax.text(1, 0.5, words, ha="right", va="center", transform=ax.transAxes)
