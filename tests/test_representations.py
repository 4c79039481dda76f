import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.photograph import Photograph
from tests.scenes.calibration import calibration

SHAPES = {"hidden": (3, 4), "photograph_shape": (6, 8)}


@pytest.fixture(scope="module")
def transport():
    return np.random.default_rng(2).uniform(0, 1, (48, 12))


@pytest.fixture(scope="module")
def photograph(transport):
    rng = np.random.default_rng(3)
    return (transport @ rng.uniform(0, 1, (12, 3))).reshape(6, 8, 3) + rng.normal(
        0, 0.01, (6, 8, 3)
    )


def test_other_things_are_told_briefly(transport, photograph):
    still = ps.NoiseAware(transport, **SHAPES)
    values = photograph.copy()
    values[0] = np.nan  # masked
    for thing, words in [
        (ps.NoiseAwareVideo(still), "3x4 patches"),
        (ps.form_preconditioner(transport, None), "12 patches, 48 pixels"),
        (Photograph(values, warnings=("dim",)), f"6x8, mean {values[1:].mean():.3g}, 1 warnings"),
        (ps.Background(photograph, 3e-4, 2e-3), "relative_error=0.0003"),
        (
            calibration(("doubt",)),
            "dx=0.1±0.01, turn=1.6±0.5, unexplained 2.89 -> 1 %, not trusted",
        ),
    ]:
        line = repr(thing)
        assert line.startswith(f"{type(thing).__name__}(") and words in line
        assert "\n" not in line and "array" not in line and len(line) < 150
