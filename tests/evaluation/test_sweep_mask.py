"""Sweeps whose wall is used in part."""

from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.evaluation.sweep import Sweep, run_sweep

RNG = np.random.default_rng(5)
SIGNAL = RNG.uniform(0.5, 1, (6, 7, 3))
TRUTH = RNG.uniform(0, 1, (3, 4, 3))
LIGHTS = {"sun": RNG.uniform(5, 9, (6, 7, 3))}
MASK = np.random.default_rng(9).random((6, 7)) > 0.3


class Dark:
    def reconstruct(self, photograph):
        return np.zeros((3, 4, 3)) + photograph.max()


def sweep_of(**changes):
    return replace(Sweep(SIGNAL, TRUTH, LIGHTS, {"dark": Dark()}, [0.5, 1], seed=7), **changes)


def test_only_what_the_mask_leaves_is_exposed_and_noisy():
    y = sweep_of(mask=MASK, snr=20).photograph("sun", 0.5, 0)
    clean = sweep_of(mask=MASK, snr=300).photograph("sun", 0.5, 0)
    signal, light = SIGNAL[MASK], LIGHTS["sun"][MASK]
    expected = signal / signal.mean() + light / light.mean() / 0.5
    assert np.allclose(clean[MASK], expected / expected.mean(), rtol=1e-12)
    noise = np.std(y[MASK] - clean[MASK]) / np.sqrt(np.mean(clean[MASK] ** 2))
    # About 90 normal values: the standard error of their deviation is 7.5 %.
    assert noise == pytest.approx(0.1, rel=0.35)
    assert y.shape == SIGNAL.shape and not y[~MASK].any() and not clean[~MASK].any()


def test_whatever_lies_under_the_mask_changes_no_measurement():
    spoilt = [np.where(MASK[..., None], y, [np.nan, np.inf, -1e9]) for y in (SIGNAL, LIGHTS["sun"])]
    found = sweep_of(mask=MASK, signal=spoilt[0], backgrounds={"sun": spoilt[1]})
    expected = sweep_of(mask=MASK).photograph("sun", 1, 0)
    assert np.array_equal(found.photograph("sun", 1, 0), expected)
    with pytest.raises(PeriscopyError, match="must be finite"):
        sweep_of(signal=spoilt[0])


def test_another_mask_is_another_sweep(tmp_path):
    assert "mask_sha256" not in sweep_of().configuration()
    run_sweep(sweep_of(mask=~MASK), tmp_path)
    with pytest.raises(OutputError, match=r"holds another sweep \(mask_sha256"):
        run_sweep(sweep_of(mask=MASK), tmp_path)


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (MASK.T, r"mask has shape \(7, 6\)"),
        (MASK * 1.0, "type float64; give truth values"),
        (MASK & False, "leaves out every pixel"),
    ],
)
def test_mask_that_does_not_fit_is_refused(mask, message):
    with pytest.raises(PeriscopyError, match=message):
        sweep_of(mask=mask)
