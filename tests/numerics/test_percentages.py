"""Two parts of a whole in percent."""

import pytest

from periscopy_sim.model.residual import percentages


@pytest.mark.parametrize(
    ("parts", "most", "texts"),
    [
        ((0.01234, 0.01534), 4, ("1.23", "1.53")),
        ((0.001634, 0.001618), 4, ("0.163", "0.162")),
        ((0.001634, 0.001618), 2, ("0.16", "0.16")),
        ((0.5, 0.5), 4, ("50.00", "50.00")),
        ((0.00123412, 0.00123411), 4, ("0.12", "0.12")),
        ((0.0, float("nan")), 4, ("0.00", "nan")),
    ],
)
def test_percentages_have_as_many_digits_as_tell_them_apart(parts, most, texts):
    assert percentages(*parts, most) == texts
