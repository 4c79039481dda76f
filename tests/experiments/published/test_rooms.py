import numpy as np
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


@pytest.mark.thorough
def test_the_same_room_under_more_light_is_recognized(setting, monkeypatch):
    monkeypatch.setattr(rooms, "HIDDEN", (12, 14))
    monkeypatch.setattr(rooms, "NOISE", 0.01)
    scene = ps.load_scenario(rooms.SCENE, (12, 14), {"film": 24})
    A, B = ps.transport(scene, noise=0.01), ps.point_light_backgrounds(scene)
    room, rng = np.random.default_rng(0).random((168, 3)), np.random.default_rng(1)
    light = A @ room
    more = light + (B @ rng.random(B.shape[1]) * light.mean() / B.sum(axis=1).mean())[:, None]
    named = {"AmbientLight/twoman0bg": light, "AmbientLight/twoman1bg": more}
    taken = {
        name: (y + 1e-4 * light.mean() * rng.standard_normal(y.shape)).reshape(24, 24, 3)
        for name, y in named.items()
    }
    monkeypatch.setattr(rooms, "_photographs", lambda: (taken, []))
    section = rooms.run(setting)
    (claim,) = section.claims
    assert float(claim.measured) > 0.9
    linear = min(section.tables[1].rows, key=lambda row: float(row[1]))
    assert linear[0] == "2.2"  # the photographs as they were taken
    assert section.pictures[0].file.is_file()
