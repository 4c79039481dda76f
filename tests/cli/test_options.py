import inspect
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import pytest
import typer
from rich.markup import render

from periscopy_sim.cli import MODULES, app, options
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.validation import size_of
from periscopy_sim.reconstruction.registry import METHODS, Option
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.shipped import find_scene


def test_forms_are_read():
    assert size_of("29x36") == size_of("29X36") == (29, 36)
    assert options.parse_definitions(["a=1", "b=x=y"]) == {"a": "1", "b": "x=y"}
    assert options.parse_definitions(None) == {}
    assert options.parse_list("--methods", "a, b") == ["a", "b"]
    assert options.parse_errors("a, b=0.5", "--free") == {"a": None, "b": 0.5}


def test_malformed_list_is_refused_by_name():
    for read, text, offender in [
        (size_of, "29x36x3", "ROWSxCOLUMNS"),
        (size_of, "-1x5", "ROWSxCOLUMNS"),
        (size_of, "9" * 5000 + "x1", "ROWSxCOLUMNS"),
        (lambda text: options.parse_definitions([text]), "a=", "'a'"),
        (lambda text: options.parse_definitions([text, text]), "a=1", "-D a"),
        (lambda text: options.parse_list("--methods", text), "a,,b", "--methods"),
        (lambda text: options.parse_errors(text, "--free"), "a,a", "--free a"),
        (lambda text: options.parse_errors(text, "--free"), "a=wide", "a=wide"),
        (lambda text: options.parse_errors(text, "--free"), "a=١٢", "a=١٢"),
        (lambda text: options.parse_ranges(text, "--vary"), "a=0:1e308", "a=0:1e308"),
    ]:
        with pytest.raises(PeriscopyError, match=offender):
            read(text)


def test_errors_are_those_given_or_declared():
    chair = read_document(find_scene("chair"))
    errors = options.known_errors("occluder_dx,occluder_dz=0.002", chair)
    assert errors == {"occluder_dx": 0.005, "occluder_dz": 0.002}
    for wrong in ("occluder_dx=-1", "occluder_dx=nan", "resolution"):
        with pytest.raises(PeriscopyError, match=f"{wrong.partition('=')[0]}"):
            options.known_errors(wrong, chair)


@dataclass(frozen=True)
class Room(options.OptionGroup):
    width: float
    height: float = 2.0


def test_command_takes_the_options_of_its_groups():
    made = []

    def command(name: str, room: Annotated[Room, {"width": 3.0}], out: Path) -> None:
        made.append((name, room, out))

    taken = options.with_options_of_groups(command)
    parameters = inspect.signature(taken).parameters
    assert list(parameters) == ["name", "width", "height", "out", "quiet", "as_json"]
    assert (parameters["width"].default, parameters["height"].default) == (3.0, 2.0)
    taken(name="a", width=1.0, height=2.5, out=Path("b"))
    assert made == [("a", Room(1.0, 2.5), Path("b"))]


TWO = {
    "first": (
        Option("weight", 1.0, "How much.", 0.5, 10, unit="in kg"),
        Option("l", 2, "L.", 0, 9),
    ),
    "second": (Option("weight", 3.0, "How much.", 0, 4),),
}


def test_defaults_are_those_of_the_method():
    assert options.settings_for("first", {}, TWO) == {"weight": 1.0, "l": 2}
    assert options.settings_for("second", {"weight": None, "l": None}, TWO) == {"weight": 3.0}
    assert options.settings_for("first", {"weight": 0.5, "l": 0}, TWO) == {"weight": 0.5, "l": 0}
    assert options.settings_for("mine.py:Own", {"weight": None}, TWO) == {}


def test_option_of_another_method_is_refused():
    for method, given in [
        ("second", {"l": 1}),
        ("mine.py:Own", {"weight": 1}),
        ("first", {"weight": 0.4}),
    ]:
        with pytest.raises(PeriscopyError, match=f"--{next(iter(given))}"):
            options.settings_for(method, given, TWO)


def test_weights_of_another_coupling_are_left_out():
    for method in options.FOR_VIDEOS:
        for coupling in METHODS[method].video.couplings:
            settings = options.settings_for(method, {}, options.FOR_VIDEOS, coupling)
            assert ("l1_weight" in settings) == (coupling == "l1")
    with pytest.raises(PeriscopyError, match="--l1-weight"):
        options.settings_for("preconditioned", {"l1_weight": 1.0}, options.FOR_VIDEOS, "none")
    for method, coupling in (("magic", "l1"), ("noise-aware", "total-variation")):
        with pytest.raises(PeriscopyError, match=method):
            options.settings_for(method, {}, options.FOR_VIDEOS, coupling)


def test_every_number_has_a_finite_range_and_is_not_nan():
    parser = typer.main.get_command(app)
    commands = [parser.get_command(None, name) for name in MODULES]
    commands += [each for c in commands for each in getattr(c, "commands", {}).values()]
    numbers = [
        option
        for command in commands
        for option in command.params
        if {int, float} & {option.type_descriptor.annotation}
    ]
    assert len(numbers) > 40
    for option in numbers:
        wrong = [math.nan, -math.inf] if option.name == "sbr" else [math.nan, -math.inf, math.inf]
        for number in wrong:
            with pytest.raises(typer.BadParameter):
                option.callback(None, option, number)


def test_help_shows_every_bracket():
    """Rich takes a bracket that is not escaped for a style, and drops what is in it."""
    parser = typer.main.get_command(app)
    for command in map(partial(parser.get_command, None), MODULES):
        for each in command.params:
            assert render(each.help).plain == each.help.replace(r"\[", "["), each.name
