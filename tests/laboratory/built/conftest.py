import pytest

from periscopy_sim.laboratory.document import build_laboratory
from periscopy_sim.scenario import load_scenario
from tests.scenes.laboratory import HIDDEN


@pytest.fixture
def built(tmp_path):
    """Build a laboratory and load its scene."""

    def build(*parts, hidden=HIDDEN, **options):
        (tmp_path / "lab.yaml").write_text("".join(parts))
        scene, *_ = build_laboratory(tmp_path / "lab.yaml", tmp_path / "lab.xml")
        return load_scenario(scene, hidden, **options)

    return build
