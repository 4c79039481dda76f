"""How many times light is reflected: its words and numbers."""

import pytest

from periscopy_sim.rendering.transport.bounces import (
    MOST_BOUNCES,
    bounces_in_words,
    bounces_of_words,
    check_bounces,
)


@pytest.mark.parametrize(
    ("bounces", "words"),
    [(1, "direct"), (None, "all"), (2, "2"), (MOST_BOUNCES, str(MOST_BOUNCES))],
)
def test_words_name_a_number_of_reflections(bounces, words):
    assert bounces_in_words(bounces) == words
    assert bounces_of_words(words) == bounces == check_bounces(bounces)


@pytest.mark.parametrize("words", ["1", "01"])
def test_one_reflection_is_direct_light_however_it_is_written(words):
    assert bounces_in_words(bounces_of_words(words)) == "direct"


@pytest.mark.parametrize("words", ["0", "-1", "1.5", "", "All", "two", "²", str(MOST_BOUNCES + 1)])
def test_other_words_are_refused(words):
    with pytest.raises(ValueError, match=f"'{words}': give direct, all, or a whole number"):
        bounces_of_words(words)
