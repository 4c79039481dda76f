from types import SimpleNamespace

import numpy as np
import pytest

from experiments.validation import coverage


def test_numbers_are_of_errors_over_standard_errors():
    truth = np.ones((2, 2, 3))
    image = truth + np.array([0.5, -1.5, 0, 4])[:, None].reshape(2, 2, 1)
    method = SimpleNamespace(
        solve=lambda _: SimpleNamespace(image=image), standard_errors=lambda _: np.ones_like(truth)
    )
    found = coverage.numbers(method, np.zeros(0), truth)
    assert found == pytest.approx([0.5, 0.75, (0.25 + 2.25 + 16) / 4, 4, 1.75])
