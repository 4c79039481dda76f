"""Entries, the objective and the page, on a case of a few pixels; they need benchopt."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("benchopt")

import pandas

from benchmarks.cases import Case
from benchmarks.entry import Entry, outcome
from benchmarks.objective import Objective
from benchmarks.page import gain
from benchmarks.solvers.least_squares import Solver as LeastSquares
from benchmarks.suites import SUITES

SHAPE = (8, 9)


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    A = rng.random((144, 72), np.float32)
    truths = rng.random((3, *SHAPE, 3))
    light = np.stack([A @ truth.reshape(-1, 3) for truth in truths]).reshape(3, 12, 12, 3)
    scene = SimpleNamespace(channel_gain=np.ones(3), hidden=SHAPE)
    names = ("one", "two", "three")
    return Case(SUITES["still"], scene, A, rng.random((144, 5)), light, truths, names)


class Scripted(Entry):
    name = "scripted"

    def fit(self, *_):
        images = iter(self.images)

        def reconstruct(_):
            image = next(images)
            if isinstance(image, BaseException):
                raise image
            return image

        return SimpleNamespace(reconstruct=reconstruct)


def rows_of(entry, case):
    objective = Objective()
    objective.set_data(case, geometry=0)
    entry.set_objective(**objective.get_objective())
    entry.run(None)
    return objective.evaluate_result(**entry.get_result())


def scripted(*images):
    entry = Scripted()
    entry.images = images
    return entry


def test_the_template_recovers_the_truth(case):
    rows = rows_of(LeastSquares(), case)
    assert [row["failure"] for row in rows] == ["", "", ""]
    assert min(row["psnr"] for row in rows) > 40
    assert rows[0]["label"] == "least-squares"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.full((*SHAPE, 3), np.nan), "NaN"),
        (np.zeros((9, 8, 3)), "shape"),
        (np.zeros((*SHAPE, 3), complex), "real numbers"),
        (None, "nothing"),
        ([[1.0, 2.0], [3.0]], "ValueError"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
        (SystemExit(3), "SystemExit"),
    ],
)
def test_a_bad_cell_fails_with_its_message_and_the_rest_goes_on(case, bad, message):
    good = np.ones((*SHAPE, 3))
    before, failed, after = rows_of(scripted(good, bad, good), case)
    assert message in failed["failure"]
    assert np.isnan(failed["psnr"])
    assert before["failure"] == after["failure"] == ""
    assert np.isfinite([before["psnr"], after["psnr"]]).all()


def test_a_method_cannot_change_what_the_next_one_gets(case):
    A = case.A.copy()

    class Vandal(Entry):
        def fit(self, _, A, B):
            A[:], B[:] = 0, 0
            return SimpleNamespace(reconstruct=lambda photograph: photograph.fill(0))

    outcome(Vandal(), case)
    np.testing.assert_array_equal(case.A, A)
    assert case.B.any()
    assert case.photographs.any()


def test_gains_are_of_the_same_cells_and_leave_failures_out():
    def cell(label, number, registered, failure=""):
        own = {"geometry": number % 2, "cell": f"image {number}", "failure": failure}
        return {"label": label, "registered": registered, **own}

    levels = 10.0, 20.0, 30.0, 40.0
    rows = [cell("noise-aware", number, level) for number, level in enumerate(levels)]
    rows += [cell("mine", number, level + 1) for number, level in enumerate(levels[1:], 1)]
    rows.append(cell("mine", 0, np.nan, "returned NaN"))
    table = pandas.DataFrame(rows[::-1])
    assert gain(table, "mine") == "+1.00 [+1.00, +1.00]"  # the levels themselves vary by 10 dB
    assert gain(table, "noise-aware") == gain(table, "absent") == "-"
