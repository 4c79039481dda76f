import re
from types import SimpleNamespace

import pytest

from periscopy_sim.cli.messages import note_sentence
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.judgement import check_memory
from periscopy_sim.numerics import machine


@pytest.mark.parametrize("method", ["", "noise-aware", "mine.py:Mine"])
def test_what_does_not_fit_in_memory_is_refused_with_advice(method, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 8 * 10**9)
    with pytest.raises(PeriscopyError, match=r"GB"):
        check_memory(SimpleNamespace(transport_shape=(960_000, 4096)), method)


def test_memory_of_several_views_is_that_of_all(monkeypatch):
    view = SimpleNamespace(transport_shape=(100_000, 1000))
    monkeypatch.setattr(machine, "available_memory", lambda: 8 * 10**9)
    check_memory(view, "noise-aware")
    with pytest.raises(PeriscopyError, match="200000 pixels x 1000 patches"):
        check_memory(view, "noise-aware", view)


@pytest.mark.parametrize(("patches", "count"), [(1044, 0), (14_400, 1)])
def test_fine_grid_is_noted_with_its_memory_and_time(patches, count, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 6 * 10**9)
    notes = check_memory(SimpleNamespace(transport_shape=(15_876, patches)), "noise-aware")
    assert len(notes) == count
    sentence = r"14,400 patches: .* [345]\.\d GB of memory; .* \d\d s"
    assert all(re.match(sentence, note_sentence(note)) for note in notes)
