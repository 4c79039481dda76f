import pytest

import periscopy_sim as ps
from periscopy_sim.analytic import area_transport
from periscopy_sim.calibration import problem, search
from tests.scenes.calibration import HIDDEN, SIDE, SIZE, Small, picture


@pytest.fixture
def quick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Use all pixels, 9 wall points in each; follow two of four draws.

    But for thorough tests, descend from less hot, and look a patch aside.
    """
    monkeypatch.setattr(area_transport, "PIXEL_POINTS", 3 * SIDE)
    monkeypatch.setattr(problem, "COARSE_PIXELS", SIDE**2)
    monkeypatch.setattr(search, "DRAWS", 4)
    monkeypatch.setattr(search, "PROPOSED", 2)
    if not request.node.get_closest_marker("thorough"):
        monkeypatch.setattr(search, "HOTTEST", 4.0)
        monkeypatch.setattr(search, "SHIFTS", (0.5, 1.0))


@pytest.fixture
def small(jit: None, quick: None) -> Small:  # noqa: ARG001
    scenario = ps.load_scenario("chair", HIDDEN, SIZE)
    return Small(scenario, [picture(1), picture(2)])
