import pytest

import periscopy_sim as ps
from experiments.published import rooms
from experiments.published.setting import PublishedSetting
from periscopy_sim.errors import PeriscopyError


@pytest.fixture
def setting(tmp_path):
    class Out(PublishedSetting):
        def __init__(self):
            self.out = tmp_path

    return Out()


def test_without_the_data_the_section_says_why(setting, monkeypatch):
    def refuse(_):
        raise PeriscopyError("no network")

    monkeypatch.setattr(ps, "fetch", refuse)
    (table,) = rooms.run(setting).tables
    assert {why for _, why in table.rows} == {"no network"}
    assert len(table.rows) == 3
