import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.analyze import MEANINGS

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


@pytest.fixture
def model():
    """A and B of the same scene."""
    scenario = ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})
    A = ps.render_transport(scenario, samples=4, strata="gauss", seed=3).astype(np.float64)
    return A, ps.point_light_backgrounds(scenario)


def kept_range(B, tolerance):
    U, σ, _ = np.linalg.svd(B / np.linalg.norm(B, axis=0), full_matrices=False)
    return U[:, σ > tolerance * σ[0]]


def test_numbers_are_those_of_dense_linear_algebra(succeeds, model, tmp_path):
    options = ("--seed", "3", "--rank-tolerance", "1e-4", "--out", "analysis")
    printed = succeeds("analyze", "chair", *TINY, *options)
    folder = tmp_path / "analysis"
    names = {"summary.json", "bounds.png", "bounds.npy", "bounds_without_background.npy"}
    assert {path.name for path in folder.iterdir()} == names
    assert all(name.replace("_", " ") in printed for name in MEANINGS)
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["model"], summary["samples"]) == ("rendered", 4)
    A, B = model
    Q = kept_range(B, 1e-4)
    A_perp = A - Q @ (Q.T @ A)
    P = np.linalg.pinv(A_perp)
    assert summary["background_rank"] == Q.shape[1] > 3
    σ = np.linalg.svd(A, compute_uv=False)
    assert summary["condition_A"] == pytest.approx(σ[0] / σ[-1], rel=1e-6)
    # Down the columns of the photograph, across their ends, and the last pixel as it is.
    by_columns = A.reshape(24, 24, 20).transpose(1, 0, 2).reshape(576, 20)
    D = np.eye(576, k=1) - np.eye(576)
    D[-1, -1] = 1
    σ = np.linalg.svd(D @ by_columns, compute_uv=False)
    assert summary["condition_DA"] == pytest.approx(σ[0] / σ[-1], rel=1e-6)
    U = np.linalg.svd(A, full_matrices=False)[0]
    cosines = np.linalg.svd(Q.T @ U, compute_uv=False)
    assert summary["smallest_angle"] == pytest.approx(np.degrees(np.arccos(cosines[0])), rel=1e-6)
    assert summary["largest_angle"] == pytest.approx(np.degrees(np.arccos(cosines[-1])), rel=1e-6)
    left = np.linalg.norm(P @ B, axis=0) / np.linalg.norm(B, axis=0) / np.linalg.norm(P, 2)
    assert summary["residual_background"] == pytest.approx(100 * left.mean(), rel=1e-3)
    assert summary["identity_error"] < 1e-10
    alone, beside = (np.linalg.inv(M.T @ M).diagonal() for M in (A, A_perp))
    assert summary["bound_ratio"] == pytest.approx(alone.sum() / beside.sum(), rel=1e-6)
    assert summary["bound_ratio"] < 1
    bounds, without = (np.load(folder / f"bounds{n}.npy") for n in ("", "_without_background"))
    assert bounds.shape == without.shape == (4, 5)
    assert np.allclose(bounds.ravel(), np.sqrt(beside), rtol=1e-6)
    assert np.allclose(without.ravel(), np.sqrt(alone), rtol=1e-6)


def test_patches_that_cannot_be_told_apart_are_refused(refused):
    assert "chair.xml" in refused("analyze", "chair", *TINY, "--hidden", "24x24", "--out", "out")
