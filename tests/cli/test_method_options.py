"""Options of the methods as the command line takes them, made from the registry."""

import inspect

import pytest

from periscopy_sim.cli.method_options import (
    COUPLINGS,
    FOR_STILLS,
    FOR_VIDEOS,
    check_coupling,
    coupling_help,
    method_help,
    settings_for,
    takes_options_of,
)
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import METHODS, Option

TWO = {
    "first": (
        Option("weight", 1.0, 0.5, 10, "How much.", unit="in kg"),
        Option("l", 2, 0, 9, "L."),
    ),
    "second": (Option("weight", 3.0, 0, 4, "How much."),),
}


def test_what_is_not_given_is_the_methods_own_default():
    assert settings_for("first", {}, TWO) == {"weight": 1.0, "l": 2}
    assert settings_for("second", {"weight": None, "l": None}, TWO) == {"weight": 3.0}
    assert settings_for("first", {"weight": 0.5, "l": 0}, TWO) == {"weight": 0.5, "l": 0}
    assert settings_for("mine.py:Own", {"weight": None}, TWO) == {}


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        ("second", {"l": 1}, "--l belongs to --method first, not to second; leave it out"),
        ("mine.py:Own", {"weight": 1}, "--weight belongs to --method first or second, not to mine"),
        ("first", {"weight": 0.4}, "--weight 0.4: --method first takes 0.5 to 10"),
        ("second", {"weight": 4.1}, "--weight 4.1: --method second takes 0 to 4"),
    ],
)
def test_what_a_method_does_not_take_is_refused(method, given, message):
    with pytest.raises(PeriscopyError, match=message):
        settings_for(method, given, TWO)


def test_command_is_given_an_argument_for_each_name_with_the_widest_bounds():
    def command(photo: str, **options: float | None) -> None:
        """Do it."""

    signature = inspect.signature(takes_options_of(TWO)(command))
    assert list(signature.parameters) == ["photo", "weight", "l"]
    weight = signature.parameters["weight"]
    (option,) = weight.annotation.__metadata__
    assert weight.default is None and (option.min, option.max) == (0, 10)
    assert option.help == "How much. Default: 1 by first (in kg); 3 by second."


def test_help_names_every_method():
    assert all(f"{name}: {METHODS[name].help}" in method_help(FOR_STILLS) for name in METHODS)
    assert "iterative" not in method_help(FOR_VIDEOS)


def test_certainty_is_promised_for_stills_alone():
    assert "(with standard errors)" in method_help(FOR_STILLS)
    assert "(with" not in method_help(FOR_VIDEOS)


def test_help_says_whose_a_coupling_is():
    assert coupling_help() == "l1; none; total-variation (preconditioned alone)"


def test_weights_of_another_coupling_are_left_out():
    for method in FOR_VIDEOS:
        for coupling in METHODS[method].video.couplings:
            check_coupling(method, coupling)
            settings = settings_for(method, {}, FOR_VIDEOS, coupling)
            assert ("l1_weight" in settings) == (coupling == "l1")
    assert {"l1", "none", "total-variation"} == set(COUPLINGS)
