"""Numbers as a ruler gives them, with units and errors."""

import pytest

from periscopy_sim.laboratory import entries


def length(given):
    return entries.parse_quantity(given, entries.LENGTHS, "12.5 cm +- 3 mm")


def test_length_is_read_in_metres_and_rounded_once():
    for text, value, error in [
        ("12.5 cm +- 3 mm", 0.125, 0.003),
        ("12.5cm±3mm", 0.125, 0.003),
        ("  -1.03 m +/- .5 cm ", -1.03, 0.005),
        ("12.5 +- 0.3 cm", 0.125, 0.003),
        ("43.6 cm", 0.436, None),
        ("+1e2 mm +- 0 mm", 0.1, 0),
        ("1 in", 0.0254, None),
        ("2 ft +- 1 in", 0.6096, 0.0254),
    ]:
        assert length(text) == entries.Measured(value, error)


def test_angles_and_bare_numbers():
    for text in ("-12 deg +- 1 deg", "-12° ± 1°", "-12 degrees +- 1 degree"):
        assert entries.parse_quantity(text, entries.ANGLES, "30 deg") == entries.Measured(-12, 1)
    assert entries.parse_quantity("18 +- 2", {}, "18 +- 2") == entries.Measured(18, 2)
    assert entries.parse_quantity(18, {}, "18 +- 2") == entries.Measured(18, None)


def test_what_is_no_length_is_refused():
    for given, said in [
        (1.03, "1.03 has no unit"),
        ("1.03", "1.03 has no unit"),
        ("1.03 m +- 3", "1.03 m [+]- 3 has no unit"),
        ("1.03 CM", "'CM'; there are m, cm, mm, in, ft"),
        ("12,5 cm", "is not a number with its unit"),
        ("nan cm", "is not a number"),
        ("1 m 3 cm", "is not a number"),
        ("1 m +- -3 mm", "the error in .* is negative"),
        ("", "is not a number"),
        (True, "is not a number"),
        ([1], "is not a number"),
    ]:
        with pytest.raises(ValueError, match=said):
            length(given)
