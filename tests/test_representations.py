"""What Python prints of public things: one line of sizes and numbers, never arrays."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.calibration.result import Parameter
from periscopy_sim.photograph import Photograph

SHAPES = {"hidden_shape": (3, 4), "photograph_shape": (6, 8)}


@pytest.fixture(scope="module")
def transport():
    return np.random.default_rng(2).uniform(0, 1, (48, 12))


@pytest.fixture(scope="module")
def photograph(transport):
    rng = np.random.default_rng(3)
    return (transport @ rng.uniform(0, 1, (12, 3))).reshape(6, 8, 3) + rng.normal(
        0, 0.01, (6, 8, 3)
    )


def told_briefly(thing):
    line = repr(thing)
    assert "\n" not in line and "array" not in line and len(line) < 150
    assert line.startswith(f"{type(thing).__name__}(")
    return line


@pytest.mark.parametrize(
    "kind", [ps.NoiseAware, ps.Periscope, ps.TruncatedSVD, ps.IterativePeriscope]
)
def test_methods_tell_their_sizes_and_solutions_noise_and_weight(transport, photograph, kind):
    method = kind(transport, **SHAPES)
    assert told_briefly(method) == f"{kind.__name__}(3x4 patches, 6x8 pixels)"
    found = method.solve(photograph)
    line = told_briefly(found)
    assert f"(3x4, noise {found.noise.mean():.3g}, weight {np.mean(found.weight):.3g})" in line


def test_differencing_too(transport, photograph):
    method = ps.Differencing(transport, **SHAPES)
    assert told_briefly(method) == "Differencing(3x4 patches, 6x8 pixels)"
    assert told_briefly(method.solve(photograph)).startswith("DifferencingResult(3x4, noise ")


def test_method_whose_photographs_have_no_known_shape_tells_their_pixels(transport):
    assert told_briefly(ps.NoiseAware(transport, hidden_shape=(3, 4))).endswith(
        "patches, 48 pixels)"
    )


def test_videos_and_preconditioners_tell_their_sizes(transport):
    still = ps.NoiseAware(transport, **SHAPES)
    assert "3x4 patches, coupling '" in told_briefly(ps.NoiseAwareVideo(still))
    line = "Preconditioner(12 patches, 48 pixels, backgrounds of rank 0)"
    assert told_briefly(ps.form_preconditioner(transport, None)) == line


def test_photographs_and_backgrounds_tell_their_size(photograph):
    values = photograph.copy()
    values[0] = np.nan  # masked
    line = told_briefly(Photograph(values, warnings=("dim",)))
    assert line == f"Photograph(6x8, mean {values[1:].mean():.3g}, 1 warnings)"
    assert (
        told_briefly(Photograph(np.full((2, 3, 3), np.nan)))
        == "Photograph(2x3, mean nan, 0 warnings)"
    )
    background = ps.Background(photograph, 3e-4, 2e-3)
    assert told_briefly(background) == "Background(6x8, relative error 0.03 %, brightness 0.2 %)"


def test_calibration_tells_values_and_whether_they_are_trusted(photograph):
    dx = Parameter("dx", 0.0, 0.0123, 1e-4, 2e-4, 0.01, 0.1)
    found = {
        "parameters": (dx,),
        "uncertain": UncertainParameters((), np.zeros(0), np.zeros(0)),
        "moves": np.zeros((1, 0)),
        "correlation": np.eye(1),
        "path": (),
        "noise_before": np.array([0.02, 0.03, 0.0]),  # (13e-4 / 3) ** 0.5
        "noise": np.full(3, 0.01),
        "residual_before": photograph,
        "residual": photograph,
        "gain": np.ones((6, 8)),
    }
    line = "Calibration(dx=0.0123±0.0002, unexplained 2.08 -> 1.00 %, trusted)"
    assert told_briefly(ps.Calibration(**found)) == line
    assert ps.Calibration(**found).unexplained == pytest.approx(((13e-4 / 3) ** 0.5, 0.01))
    doubted = ps.Calibration(**found, doubts=("it left its prior",))
    assert told_briefly(doubted) == line.replace("trusted", "not trusted")
