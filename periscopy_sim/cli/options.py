"""The options that commands share, in the groups of ``--help``, and the forms of their values."""

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import typer
from typer.core import TyperCommand, TyperGroup

import periscopy_sim as ps
from periscopy_sim.calibration.prior import check_error, declared_errors, start_values
from periscopy_sim.cli.output import fixable, outcome_of
from periscopy_sim.errors import OutputError, PeriscopyError, did_you_mean
from periscopy_sim.hidden import Sizes
from periscopy_sim.numerics import validation
from periscopy_sim.reconstruction.registry import METHODS, Option
from periscopy_sim.scene import CAMERA, SceneDocument
from periscopy_sim.storage.places import place

Value = TypeVar("Value")

SCENE, PHOTOGRAPH, LIGHT = "Scene", "Photograph", "Light"
SOLVER, OUTPUT, EXPERT = "Solver", "Output", "Expert"
GROUPS = None, SCENE, PHOTOGRAPH, OUTPUT, SOLVER, LIGHT, EXPERT
"""Titles of the groups of options, in the order of ``--help``; None: the command's own."""

RENAMED = {"background": "monitor-off", "backgrounds": "light-model"}
"""Former names of options, which still work."""


def option(
    form: str,
    words: str = "",
    *names: str,
    group: str | None = None,
    limits: tuple[float, float] | None = None,
    kind: str = "",
    **more: Any,
) -> Any:
    """Return an option: the form of its value, its help in words, the rest as typer takes it.

    `limits` are of its number, or those of its kind in `RANGES`, whose help serves where there are
    no words.
    """
    # Rich takes a bracket for the start of a style.
    words = (words or validation.RANGES[kind].help).replace("[", r"\[")
    if limits := validation.RANGES[kind].ends if kind else limits:
        least, most = limits

        def within(value: float | None) -> float | None:
            if value is not None and not least <= value <= most:  # nor is NaN
                raise typer.BadParameter(f"{value:.10g} is not from {least:.10g} to {most:.10g}.")
            return value

        more["callback"] = within
    return typer.Option(*names, metavar=form, help=words, rich_help_panel=group, **more)


def argument(form: str, words: str, **more: Any) -> Any:
    """Return an argument: the form of its value, its help in words, the rest as typer takes it."""
    return typer.Argument(metavar=form, help=words, **more)


class OptionGroup:
    """Options that commands share: the parameters of a class's constructor.

    A command that takes such an object has these options on the command line; for
    ``Annotated[Group, {"hidden": ["29x36"]}]`` with other defaults.
    """

    @classmethod
    def parameters(cls, defaults: Mapping[str, Any]) -> list[inspect.Parameter]:
        """Return the parameters of the constructor, some of them with other defaults."""
        members = inspect.signature(cls, eval_str=True).parameters.values()
        return [each.replace(default=defaults.get(each.name, each.default)) for each in members]


# -- the options ---------------------------------------------------------------------------------


_SCENE = "A Mitsuba XML file, or the name of a shipped scene."
_PHOTO = "EXR, NPY, NPZ (key photograph), 16-bit PNG or TIFF."
_EACH = "Of several views one for each --camera, in their order."
IMAGE = "a name, a picture, EXR, NPY or NPZ (key hidden); of several surfaces ID=IMAGE, repeated"
_DEFINE = "Set one of the scene's <default>s; repeatable."
_RESUMED = "Folder of results; the same command resumes there."
_STORE = "Made or continued; or a URL, as s3://a/b."
_SCHEDULER = "A Dask scheduler, instead of this machine."
_HIDDEN = "Size of the hidden image in patches: 29x36; of several surfaces ID=29x36, repeated."
_VIEWS = "of several views CAMERA=FILE, repeated."
_MASK = f"A picture of the photograph's size; its black pixels are not used; {_VIEWS}"
_OFF = f"Background photograph, with the monitor off; repeatable; {_VIEWS}"
_CAMERA = f"Id of the scene's sensor. [default: {CAMERA}]"
_COLOURS = (
    "3x3 matrix (NPY, JSON, CSV) from the monitor's primaries to the camera's channels, or a raw "
    "file of the camera."
)
_SAMPLES = (
    "Shadow rays from each pixel's centre to each patch. [default, without a closed form: as many "
    "as keep the error of A small beside the noise]"
)
_MODEL = (
    "Compute A by shadow rays, or in closed form (flat wall and monitor, occluders of triangles). "
    "[default: in closed form where the scene has one, but by 16 rays for preconditioned "
    "and pseudoinverse]"
)
_BOUNCES = "Light of the monitor in A: direct, all reflections, or at most N."
_LIGHT_MODEL = "Ambient light to remove: Eq. 4's point lights, or columns of a file; repeatable."

SceneArgument = Annotated[str, argument("SCENE", _SCENE)]
SceneOption = Annotated[str, option("SCENE", _SCENE, group=SCENE)]
Hidden = Annotated[list[str], option("[ID=]ROWSxCOLUMNS", _HIDDEN, group=SCENE)]
Define = Annotated[list[str] | None, option("NAME=VALUE", _DEFINE, "-D", group=SCENE)]
Cameras = Annotated[list[str] | None, option("ID", _CAMERA, "--camera", group=SCENE)]
PhotoArguments = Annotated[list[Path], argument("PHOTO", f"{_PHOTO} {_EACH}", exists=True)]
FilesOfViews = list[Path] | None
MaskOption = Annotated[FilesOfViews, option("[CAMERA=]FILE", _MASK, group=PHOTOGRAPH)]
MonitorOffOption = Annotated[FilesOfViews, option("[CAMERA=]FILE", _OFF, group=PHOTOGRAPH)]
ColourMatrixOption = Annotated[Path | None, option("FILE", _COLOURS, group=PHOTOGRAPH, exists=True)]
Samples = Annotated[int | None, option("NUMBER", _SAMPLES, group=LIGHT, kind="rays")]
ModelOption = Annotated[
    Literal["rendered", "analytic"] | None, option("rendered|analytic", _MODEL, group=LIGHT)
]
BouncesOption = Annotated[str, option("direct|all|N", _BOUNCES, group=LIGHT)]
_MATRIX = "Read A from an NPY file"
MatrixOption = Annotated[
    Path | None, option("FILE", f"{_MATRIX}.", "--transport", group=LIGHT, exists=True)
]
MatricesOption = Annotated[
    FilesOfViews, option("[CAMERA=]FILE", f"{_MATRIX}; {_VIEWS}", "--transport", group=LIGHT)
]
LightModelOption = Annotated[list[str] | None, option("grid|FILE.npy", _LIGHT_MODEL, group=LIGHT)]
Out = Annotated[Path, option("FOLDER", "Folder to write.", group=OUTPUT)]
ResumedFolder = Annotated[Path, option("FOLDER", _RESUMED, group=OUTPUT)]


Store = Annotated[Path, option("FOLDER", _STORE, group=OUTPUT, parser=str, callback=place)]
OutFile = Annotated[Path, option("FILE", "File to write.", group=OUTPUT)]
Seed = Annotated[int, option("NUMBER", group=EXPERT, kind="seed")]
Snr = Annotated[float, option("DB", kind="decibels")]
OptionalSnr = Annotated[float | None, option("DB", kind="decibels")]
Scheduler = Annotated[str | None, option("ADDRESS", _SCHEDULER, group=EXPERT)]


def example_of(module: str, what: str) -> Any:
    """Return an option that prints the ``EXAMPLE`` of a module, and ends."""

    def show(is_asked: bool) -> None:
        if is_asked:
            print(import_module(module).EXAMPLE.read_text("utf-8"), end="")
            raise typer.Exit

    words = f"Print {what} and exit."
    return typer.Option("--example", help=words, is_eager=True, callback=show)


# -- the options of the methods ------------------------------------------------------------------

Offered = Mapping[str, tuple[Option, ...]]
"""The options that each method takes, by the method's name."""

FOR_STILLS: Offered = {name: entry.options for name, entry in METHODS.items()}
_VIDEOS = {name: entry.video for name, entry in METHODS.items() if entry.video}
FOR_VIDEOS: Offered = {
    name: (*METHODS[name].options, *video.options) for name, video in _VIDEOS.items()
}
COUPLINGS = tuple(dict.fromkeys(each for video in _VIDEOS.values() for each in video.couplings))


def _one_of(words: str, names: Collection[str]) -> Any:
    """Return an option that takes one of some names, which the shell completes."""
    return option("NAME", words, group=SOLVER, autocompletion=lambda: list(names))


def _listed(offered: Offered) -> str:
    """Return a line for each method: its help, with its certainty for stills."""
    certain = {n: METHODS[n].certainty for n in offered if offered is FOR_STILLS}
    known = {name: f" (with {words})" for name, words in certain.items() if words}
    lines = (f"- {name}: {METHODS[name].help}{known.get(name, '')}." for name in offered)
    return "\n\n".join(lines)


_OWN = "yours as module:callable or file.py:callable"
MethodOption = Annotated[str, _one_of(f"{_listed(FOR_STILLS)}\n\n- {_OWN}.", FOR_STILLS)]
FirstMethodOption = Annotated[str, option("NAME", f"First method; {_OWN}.")]
VideoMethodOption = Annotated[str, _one_of(_listed(FOR_VIDEOS), FOR_VIDEOS)]
Coupling = Annotated[
    str, _one_of(f"Coupling of a frame to the one before: {', '.join(COUPLINGS)}.", COUPLINGS)
]


def settings_for(
    method: str, numbers: Mapping[str, float | None], offered: Offered, coupling: str = ""
) -> dict[str, float]:
    """Return the values of a method's options: the user's, else the defaults.

    A user's own method has no options. A PeriscopyError names an option that the method, with this
    coupling of a video's frames, does not take, or not of this value; or an unknown coupling.
    """
    if coupling and not (method in _VIDEOS and coupling in _VIDEOS[method].couplings):
        known = "; ".join(f"{name}: {', '.join(v.couplings)}" for name, v in _VIDEOS.items())
        guess = "" if method in _VIDEOS else did_you_mean(method, _VIDEOS)
        raise PeriscopyError(
            f"--method {method} --coupling {coupling}: {guess or f'videos have {known}'}"
        )
    taken = {each.name: each for each in offered.get(method, ()) if each.coupling in ("", coupling)}
    values = {name: value for name, value in numbers.items() if value is not None}
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        if name not in taken:
            raise PeriscopyError(f"{flag} {value:g}: --method {method} {coupling} takes none")
        values[name] = taken[name].checked(value, flag)
    return {name: values.get(name, each.default) for name, each in taken.items()}


def _argument(taken: Mapping[str, Option]) -> Any:
    """Return the annotation of an option that some methods take."""
    first = next(iter(taken.values()))
    defaults: dict[str, list[str]] = {}
    for method, each in taken.items():
        unit = f" ({each.unit})" if each.unit else ""
        defaults.setdefault(f"{each.default:g}{unit}", []).append(method)
    listed = "; ".join(f"{default} for {', '.join(names)}" for default, names in defaults.items())
    group = SOLVER if first.name.endswith("weight") else EXPERT
    least, most = min(e.least for e in taken.values()), max(e.most for e in taken.values())
    words = f"{first.help} Default: {listed}."
    return Annotated[float | None, option("NUMBER", words, group=group, limits=(least, most))]


class MethodNumbers(OptionGroup):
    """The values of the options of methods, None where the user gave none."""

    def __init__(self, **values: float | None) -> None:
        self.values = values

    @classmethod
    def parameters(cls, offered: Offered) -> list[inspect.Parameter]:
        """Return a parameter for each option that any of the offered methods takes."""
        by_name: dict[str, dict[str, Option]] = {}
        for method, options in offered.items():
            for each in options:
                by_name.setdefault(each.name, {})[method] = each
        kind = inspect.Parameter.KEYWORD_ONLY
        return [
            inspect.Parameter(name, kind, default=None, annotation=_argument(taken))
            for name, taken in by_name.items()
        ]


StillNumbers = Annotated[MethodNumbers, FOR_STILLS]
VideoNumbers = Annotated[MethodNumbers, FOR_VIDEOS]


# -- forms of values -----------------------------------------------------------------------------


def by_name(
    flag: str, entries: Iterable[Any] | None, names: Iterable[str], kind: Callable[[str], Value]
) -> dict[str, list[Value]]:
    """Return the values of each name, from ``NAME=VALUE``, or ``VALUE`` where there is one name.

    A file that exists is a ``VALUE``, whatever it is called.
    """
    values = {name: list[Value]() for name in names}
    for entry in map(str, entries or ()):
        name, equals, value = entry.partition("=")
        is_file = kind is Path and Path(entry).exists()
        if len(values) == 1 and (is_file or not (equals and name in values)):
            name, value = next(iter(values)), entry
        if name not in values:
            form = " ".join(f"{flag} {each}=..." for each in values)
            raise PeriscopyError(f"{flag} {entry}: write {form}")
        values[name].append(kind(value))
    return values


def _pairs(flag: str, entries: Iterable[str]) -> dict[str, str]:
    """Read ``NAME=VALUE`` or ``NAME`` entries, of an empty value; each name once."""
    parts = [entry.partition("=") for entry in entries]
    pairs = {name.strip(): value.strip() for name, _, value in parts}
    if not all(pairs):
        raise PeriscopyError(f"{flag} '{','.join(map(''.join, parts))}': a name is missing")
    if len(pairs) < len(parts):
        raise PeriscopyError(f"{flag} {','.join(pairs)}: name each once")
    return pairs


def parse_list(flag: str, text: str) -> list[str]:
    """Read names separated by commas, each once."""
    return list(_pairs(flag, text.split(",")))


def parse_definitions(definitions: Iterable[str] | None, flag: str = "-D") -> dict[str, str]:
    """Read ``-D name=value`` options, or those of another name; each name once."""
    pairs = _pairs(flag, definitions or ())
    if empty := [name for name, value in pairs.items() if not value]:
        raise PeriscopyError(f"{flag} '{empty[0]}': write name=value")
    return pairs


def parse_sizes(entries: Sequence[str]) -> Sizes:
    """Read ``--hidden``: ``ROWSxCOLUMNS`` of the only surface, or ``ID=ROWSxCOLUMNS`` of each."""
    if entries and not any("=" in entry for entry in entries):
        return validation.size_of(entries[-1])  # the last counts, as of other options
    pairs = parse_definitions(entries, "--hidden")
    return {name: validation.size_of(size) for name, size in pairs.items()}


def parse_errors(text: str, flag: str) -> dict[str, float | None]:
    """Read ``NAME[=ERROR],...``: names, each with its error if one is given; each name once."""
    pairs = _pairs(flag, text.split(",") if text else ())
    errors = {name: validation.number_of(error) if error else None for name, error in pairs.items()}
    for name, error in errors.items():
        if error is not None and math.isnan(error):
            form = "NAME or NAME=0.005, by comma, without units"
            raise PeriscopyError(f"{flag} {name}={pairs[name]}: write {form}")
    return errors


def known_errors(text: str, document: SceneDocument) -> dict[str, float]:
    """Read the errors of ``--uncertain``: those given, else those that the scene declares.

    A PeriscopyError names a parameter whose error is unknown or not positive.
    """
    if not text:
        return {}
    named, declared = parse_errors(text, "--uncertain"), declared_errors(document)
    start_values(document, list(named))
    errors = {n: declared.get(n, 0.0) if error is None else error for n, error in named.items()}
    for name, error in errors.items():
        check_error(name, error)
    return errors


def require_suffix(out: Path, suffix: str, what: str) -> None:
    """Reject an --out whose suffix is not that of the file's format."""
    if out.suffix != suffix:
        raise OutputError(f"--out {out}: {what} is written as {suffix}; name a file that ends so")


def parse_ranges(text: str, flag: str) -> dict[str, tuple[float, float]]:
    """Read ``NAME=LOW:HIGH,...``, each name once."""
    ranges = {}
    for name, ends in parse_definitions(text.split(","), flag).items():
        low, high = map(validation.number_of, ends.partition(":")[::2])
        if not (high - low >= validation.SMALLEST and validation.in_range("parameter", low, high)):
            form = "NAME=LOW:HIGH, such as occluder_dx=-0.05:0.05"
            raise PeriscopyError(f"{flag} {name}={ends}: write {form}")
        ranges[name] = (low, high)
    return ranges


def parse_indices(text: str, count: int) -> list[int]:
    """Read indices below `count` and ranges of them, such as ``0,4-7``."""
    form = r"\s*([0-9]{1,12})(?:-([0-9]{1,12}))?\s*"
    parts = [re.fullmatch(form, each) for each in text.split(",")]
    ends = [(int(part[1]), int(part[2] or part[1])) for part in filter(None, parts)]
    if not all(parts) or not all(first <= last < count for first, last in ends):
        form = f"numbers and ranges of 0 to {count - 1}, as 0,5,8-11"
        raise PeriscopyError(f"--samples '{text}': write {form}")
    return list(dict.fromkeys(index for first, last in ends for index in range(first, last + 1)))


HELP = {"help_option_names": ["-h", "--help"]}
"""Settings of every command's context."""


class _WithoutTypes:
    """A command, or a group, whose help gives no type to arguments and to flags."""

    def get_params(self, ctx: Any) -> Any:
        """Return the command's arguments and options, that of its help last."""
        parameters = super().get_params(ctx)  # type: ignore[misc]
        for each in parameters:
            if each.param_type_name == "argument":
                each.display_type_rich = lambda ctx: ""  # noqa: ARG005
            elif getattr(each, "is_flag", False):
                each.metavar = ""
        return parameters


class Command(_WithoutTypes, TyperCommand):
    """A command; its errors name its options as users write them."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; the library's "sbr 1e9: ..." becomes "--sbr 1e9: ..."."""
        try:
            return super().invoke(ctx)
        except PeriscopyError as error:
            names = {each.name: each.opts[0] for each in self.params if each.opts[0][:2] == "--"}
            name, *rest = re.split(r"(?=[ :])", str(error), maxsplit=1)
            is_file = Path(name).exists()  # which the error may be about
            if name not in names or is_file or not re.match(r"( [^\s']+)?: ", "".join(rest)):
                raise
            raise type(error)("".join([names[name], *rest])) from error


class CommandGroup(_WithoutTypes, TyperGroup):
    """A group of commands."""


def _for_all(
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print warnings and errors alone.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print all numbers, files and warnings as JSON.")
    ] = False,
) -> None:
    """Have the options of all commands."""


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that takes the options of its groups one by one, and those of all."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, tuple[type[OptionGroup], list[str]]] = {}
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        group, *others = get_args(parameter.annotation) or (parameter.annotation,)
        members = [parameter]
        if isinstance(group, type) and issubclass(group, OptionGroup):
            members = group.parameters(*others or ({},))
            groups[name] = group, [each.name for each in members]
        parameters += members

    def run(*, quiet: bool = False, as_json: bool = False, **values: Any) -> None:
        with outcome_of(quiet, as_json):
            for name, (group, members) in groups.items():
                values[name] = group(**{each: values.pop(each) for each in members})
            command(**values)

    def place(parameter: inspect.Parameter) -> int:
        *_, described = (None, *get_args(parameter.annotation))
        return GROUPS.index(getattr(described, "rich_help_panel", None))

    parameters += inspect.signature(_for_all).parameters.values()
    keywords = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
    described: Any = run
    described.__doc__ = re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(command.__doc__ or ""))
    described.__signature__ = inspect.Signature(sorted(keywords, key=place))
    return run


GRID = "grid"
"""Names Eq. 4's point lights on the paper's grid."""


def most_bounces(text: str) -> int | None:
    """Return the most reflections of a path that ``--bounces`` names: None for any number."""
    with fixable("--bounces"):
        return validation.bounces_of_words(text)


@dataclass(frozen=True)
class MonitorLight(OptionGroup):
    """The options of A, checked before anything is rendered."""

    samples: Samples = None
    model: ModelOption = None
    bounces: BouncesOption = "direct"

    def __post_init__(self) -> None:
        _ = self.most_bounces

    @property
    def most_bounces(self) -> int | None:
        """The most reflections of a path: 1 of direct light, None of any number."""
        return most_bounces(self.bounces)

    def of(self, scenario: ps.Scenario) -> ps.Light:
        """Return how the light of a scenario is computed."""
        del scenario
        by = None if self.model is None else validation.WAYS[self.model]
        return ps.Light(by, self.samples, self.most_bounces)


@dataclass(frozen=True)
class LightOptions(MonitorLight):
    """The options of A and B, checked before anything is rendered.

    B has the columns of all sources that `light_model` names, in this order.
    """

    light_model: LightModelOption = None

    @property
    def sources(self) -> list[str]:
        """The sources of ambient light."""
        return self.light_model or [GRID]

    @property
    def origin(self) -> dict[str, Any]:
        """The entries of a summary on the light, beside those of its `TransportPlan`."""
        bounces = validation.bounces_in_words(self.most_bounces)
        return {"bounces": bounces, "ambient_prototypes": self.sources}

    def check_methods(self, *names: str) -> None:
        """Reject a light model for a method that takes no B."""
        without = [name for name in names if name in METHODS and not METHODS[name].backgrounds]
        if self.light_model and without:
            raise ps.PeriscopyError(f"--light-model: {without[0]} models no ambient light; drop it")

    def of(self, scenario: ps.Scenario) -> ps.Light:
        """Return how the light of a scenario is computed; B of files has its pixels."""
        from periscopy_sim.storage.transport_matrix import read_prototypes

        pixels = scenario.transport_shape[0]
        sources = [None if s == GRID else read_prototypes(Path(s), pixels) for s in self.sources]
        return replace(super().of(scenario), ambient=tuple(sources))
