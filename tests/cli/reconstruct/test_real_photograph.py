import json
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("jit")

SHARED = Path(__file__).parents[3].parent / "shared" / "data" / "chair_mushroom.npz"


def best_psnr(estimate, truth):
    """Gain-matched PSNR after the best shift of at most 2 patches, in half patches."""

    def half_shifted(image, halves, axis):
        whole, half = divmod(halves, 2)
        padded = np.pad(image, [(3, 3) if axis == a else (0, 0) for a in range(3)])
        moved = np.roll(padded, whole, axis)
        moved = (moved + np.roll(moved, 1, axis)) / 2 if half else moved
        return np.take(moved, range(3, 3 + image.shape[axis]), axis)

    found = []
    for down in range(-4, 5):
        for right in range(-4, 5):
            moved = np.maximum(half_shifted(half_shifted(estimate, down, 0), right, 1), 0)
            gain = np.sum(moved * truth, axis=(0, 1)) / np.sum(moved**2, axis=(0, 1))
            found.append(np.mean((np.clip(gain * moved, 0, 1) - truth) ** 2))
    return -10 * np.log10(min(found))


@pytest.mark.thorough
@pytest.mark.skipif(not SHARED.is_file(), reason="the real photograph is not at hand")
def test_real_photograph_shows_the_mushroom_by_the_defaults(periscopy, tmp_path):
    given = ("--scene", "chair", "--hidden", "29x36", "--truth", SHARED)
    outcome = periscopy("reconstruct", SHARED, *given, "--out", "out")
    assert outcome.code == 0
    image = np.load(tmp_path / "out" / "reconstruction.npy").astype(np.float64)
    sent = np.load(SHARED)["hidden"] / 255
    truth = np.where(sent <= 0.04045, sent / 12.92, ((sent + 0.055) / 1.055) ** 2.4)
    psnr = best_psnr(image, truth)
    assert psnr >= 15.5
    assert psnr > best_psnr(image[:, ::-1], truth) + 0.5
    assert psnr > best_psnr(image[::-1], truth) + 0.5
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["pixels_left_out"] == 0 and summary["diagnosis"] == "does_not_fit"
    assert summary["psnr_registered"] == pytest.approx(psnr, abs=0.01)
