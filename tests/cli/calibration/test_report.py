"""What is said of a calibration: who knows each number, what is tied, far off, or left."""

import numpy as np
import pytest
from periscopy_sim.calibration.consider_analysis import UncertainParameters

from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.cli.calibration.report import say_found


def calibrated(*parameters, correlation=None, gain=None, **more):
    """A calibration of some parameters in which nothing else is of interest."""
    count = len(parameters)
    uncertain = UncertainParameters((), np.empty(0), np.empty(0))
    left = np.ones(3), np.ones(3), np.ones((2, 2, 3)), np.ones((2, 2, 3))
    gain = np.ones((2, 2)) if gain is None else gain
    errors = np.eye(count) if correlation is None else correlation
    return Calibration(parameters, uncertain, np.empty((count, 0)), errors, (), *left, gain, **more)


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


@pytest.mark.parametrize(("corner", "told"), [(0.8, True), (0.99, False)])
def test_a_gain_over_the_wall_is_told_where_there_is_one(capsys, corner, told):
    gain = np.array([[1.0, 1.0], [1.01, corner]])
    say_found(calibrated(Parameter("dx", 0, 0, 0.1, 0.1, 1, 1), gain=gain), has_backgrounds=False)
    assert ("0.80 to 1.01 times the monitor's light" in capsys.readouterr().out) == told
