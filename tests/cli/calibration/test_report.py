"""What is said of a calibration: who knows each number, what is tied, far off, or left."""

from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.cli.calibration.calibrate import DISTRUSTED, UNTOLD
from periscopy_sim.cli.calibration.report import _open, say_found


@pytest.mark.parametrize(
    ("alone", "correlation", "why"),
    [
        (0.1, 0.9, "would determine dx if turn were better known"),
        (2.0, 0.9, "is tied to dy (correlation 0.90); leave one of them out"),
        (2.0, 0.5, "does not determine dx; leave it out"),
    ],
)
def test_why_a_parameter_is_open_is_told(alone, correlation, why):
    parameters = [
        SimpleNamespace(name="dx", scale=1.0, statistical_error=alone),
        SimpleNamespace(name="dy", scale=1.0, statistical_error=0.1),
    ]
    errors = np.array([[1, correlation], [correlation, 1]])
    assert why in _open(SimpleNamespace(parameters=parameters, correlation=errors), 0, "turn")


def calibrated(*parameters, correlation=None, gain=None, **more):
    """A calibration of some parameters in which nothing else is of interest."""
    count = len(parameters)
    uncertain = UncertainParameters((), np.empty(0), np.empty(0))
    left = np.ones(3), np.ones(3), np.ones((2, 2, 3)), np.ones((2, 2, 3))
    gain = np.ones((2, 2)) if gain is None else gain
    errors = np.eye(count) if correlation is None else correlation
    return Calibration(parameters, uncertain, np.empty((count, 0)), errors, (), *left, gain, **more)


@pytest.mark.parametrize(
    ("value", "told"),
    [(0.0, "those at the start, which stay"), (0.1, "no more than chance gains")],
)
def test_it_is_told_whether_values_stay_that_nothing_betters(capsys, value, told):
    parameter = Parameter("dx", 0.0, value, 0.1, 0.1, 1.0, 1.0, np.inf if value else 0.1)
    say_found(calibrated(parameter, moved=False), has_backgrounds=False)
    assert told in capsys.readouterr().out


@pytest.mark.parametrize(
    ("ruler", "mark"),
    [(0.01, "<-- 2.9 of the ruler's errors off"), (0.015, ""), (np.inf, "")],
)
def test_values_that_end_far_from_the_ruler_are_marked(capsys, ruler, mark):
    say_found(
        calibrated(Parameter("dz", 0.343, 0.314, 0.005, 0.005, 1.0, 1.0, ruler)),
        has_backgrounds=False,
    )
    line, *rest = capsys.readouterr().out.splitlines()
    assert line.startswith("dz") and line.endswith(mark) and ("<--" in line) == bool(mark)
    assert "<--" not in "".join(rest)


@pytest.mark.parametrize(("count", "told"), [(1, False), (2, True)])
def test_more_far_values_than_right_ones_have_are_named(capsys, count, told):
    near = [Parameter(name, 0, 0.1, 0.05, 0.05, 1, 1, 0.1) for name in "abcd"]
    far = [Parameter(name, 0, 0.25, 0.05, 0.05, 1, 1, 0.1) for name in "yz"[:count]]
    say_found(calibrated(*near, *far), has_backgrounds=False)
    assert ("measure y, z again" in capsys.readouterr().out) == told


def test_two_far_values_of_many_are_no_cause_to_measure_again(capsys):
    near = [Parameter(f"n{k}", 0, 0.1, 0.05, 0.05, 1, 1, 0.1) for k in range(22)]
    far = [Parameter(name, 0, 0.25, 0.05, 0.05, 1, 1, 0.1) for name in "yz"]
    say_found(calibrated(*near, *far), has_backgrounds=False)
    assert "again" not in capsys.readouterr().out


@pytest.mark.parametrize("error", [0.1, 0.15])
def test_values_less_sure_than_by_the_ruler_are_told(capsys, error):
    known = Parameter("known", 0, 0.1, 0.02, 0.02, 1, 1, 0.1)
    moved = Parameter("moved", 0, 0.1, error, error, 1, 1, 0.1)
    say_found(calibrated(known, moved), has_backgrounds=False)
    first, second, *rest = capsys.readouterr().out.splitlines()
    assert first.endswith("by the photograph")
    assert second.endswith("less sure than by the ruler" if error > 0.1 else "as the ruler said")
    assert any("less sure than by the ruler: moved;" in line for line in rest) == (error > 0.1)


def test_pairs_that_are_hardly_told_apart_are_named_the_closest_first(capsys):
    parameters = [Parameter(name, 0, 0, 0.1, 0.1, 1, 1, 0.1) for name in "abcde"]
    errors = np.eye(5)
    for j, k, correlation in ((0, 1, 0.91), (2, 3, -0.99), (1, 4, 0.97), (0, 4, 0.92), (0, 2, 0.8)):
        errors[j, k] = errors[k, j] = correlation
    say_found(calibrated(*parameters, correlation=errors), has_backgrounds=False)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "apart" in line]
    assert line.startswith(
        "can hardly be told apart (correlation of their errors): c and d (-0.99), b and e (0.97), "
        "a and e (0.92); "
    )
    apart = np.where(abs(errors) > 0.9, 0.8, errors)
    say_found(calibrated(*parameters, correlation=apart), has_backgrounds=False)
    assert "apart" not in capsys.readouterr().out


@pytest.mark.parametrize("has_backgrounds", [False, True])
def test_paint_is_blamed_only_where_no_photograph_shows_it(capsys, has_backgrounds):
    for discrepancy, first in (
        (1.04, "nothing in that is more than 1.0 times"),
        (17.4, "not all of"),
    ):
        found = calibrated(Parameter("dx", 0, 0, 0.1, 0.1, 1, 1), discrepancy=discrepancy)
        say_found(found, has_backgrounds=has_backgrounds)
        told = [line for line in capsys.readouterr().out.splitlines() if "noise" in line]
        assert len(told) == 1 and told[0].startswith(first)
    assert "17 times as strong" in told[0] and "periscopy reconstruct" in told[0]
    assert ("--background" in told[0]) == ("uneven paint" in told[0]) == (not has_backgrounds)
    advice = DISTRUSTED.format(UNTOLD[has_backgrounds])
    assert ("--monitor-off" in advice) == (not has_backgrounds) and "--free" in advice


@pytest.mark.parametrize(("corner", "told"), [(0.8, True), (0.99, False)])
def test_a_gain_over_the_wall_is_told_where_there_is_one(capsys, corner, told):
    gain = np.array([[1.0, 1.0], [1.01, corner]])
    say_found(calibrated(Parameter("dx", 0, 0, 0.1, 0.1, 1, 1), gain=gain), has_backgrounds=False)
    assert ("0.80 to 1.01 times the monitor's light" in capsys.readouterr().out) == told
