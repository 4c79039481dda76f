from types import SimpleNamespace

import numpy as np
import pytest

from experiments.validation import coverage


def test_fields_are_the_rougher_the_smaller_the_exponent():
    roughness = [
        np.mean([np.diff(f, axis=1).std() / f.std() for f in coverage.images(kind)])
        for kind in ("smooth (1/f³)", "natural (1/f)", "white noise")
    ]
    assert (np.diff(roughness) > 0).all()
    assert roughness[2] == pytest.approx(np.sqrt(2), rel=0.05)


def test_numbers_are_of_errors_over_standard_errors():
    truth = np.ones((2, 2, 3))
    image = truth + np.array([0.5, -1.5, 0, 4])[:, None].reshape(2, 2, 1)
    method = SimpleNamespace(
        solve=lambda _: SimpleNamespace(image=image), standard_errors=lambda _: np.ones_like(truth)
    )
    found = coverage.numbers(method, np.zeros(0), truth)
    assert found == pytest.approx([0.5, 0.75, (0.25 + 2.25 + 16) / 4, 4, 1.75])
