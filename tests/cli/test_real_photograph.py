import json
from pathlib import Path

import numpy as np
import pytest

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit")

SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "chair_mushroom.npz"


@pytest.mark.thorough
@pytest.mark.skipif(not SHARED.is_file(), reason="the real photograph is not at hand")
def test_real_photograph_shows_the_mushroom_by_the_defaults(periscopy, tmp_path):
    given = ("--scene", "chair", "--hidden", "29x36", "--truth", SHARED)
    outcome = periscopy("reconstruct", SHARED, *given, "--out", "out")
    assert outcome.code == 0
    image = np.load(tmp_path / "out" / "reconstruction.npy").astype(np.float64)
    sent = np.load(SHARED)["hidden"] / 255
    truth = np.where(sent <= 0.04045, sent / 12.92, ((sent + 0.055) / 1.055) ** 2.4)
    psnr = ps.registered(image, truth).psnr
    assert psnr >= 15.5
    assert psnr > ps.registered(image[:, ::-1], truth).psnr + 0.5
    assert psnr > ps.registered(image[::-1], truth).psnr + 0.5
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["pixels_left_out"] == 0 and summary["diagnosis"] == "does_not_fit"
    assert summary["psnr_registered"] == pytest.approx(psnr, abs=0.01)
