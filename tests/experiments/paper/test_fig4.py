"""Fig. 4's errors and verdicts, from results that are known."""

import numpy as np
import xarray as xr

from experiments.paper import fig4
from experiments.sweeps import errors_of

SBRS = np.array(fig4.SBRS)
LIGHTS = [f"{name}{flip}" for name in ("a", "b") for flip in ("", " up-down")]
BOUND = {"bound": list(1 / SBRS), "P y": list(2 / SBRS)}
FLAT = np.full(len(SBRS), 0.04)
STEEP = 0.01 * (SBRS[-1] / SBRS) ** 0.5


def results(**errors):
    """Mean squared errors by method (in identifiers), (SBRs,) or (SBRs, backgrounds)."""
    names = {"noise_aware": "noise-aware", "without_repair": "without repair"}
    values = [np.broadcast_to(np.transpose(e), (len(LIGHTS), len(SBRS))) for e in errors.values()]
    error = np.stack(values)[..., None]
    dims = ("algorithm", "background", "sbr", "seed")
    methods = [names.get(name, name) for name in errors]
    return xr.Dataset(
        {
            "mean_squared_error": (dims, error),
            "psnr_registered": (dims, -10 * np.log10(error / 2)),
        },
        {"algorithm": methods, "background": LIGHTS, "sbr": SBRS, "seed": [0]},
    )


def test_errors_are_those_of_the_method_by_sbr_background_and_draw():
    by_light = np.arange(1.0, 5) * np.ones((len(SBRS), 1))
    data = results(preconditioned=by_light, differencing=FLAT)
    error = errors_of(data.transpose("seed", "sbr", "background", "algorithm"), "preconditioned")
    assert error.shape == (len(SBRS), len(LIGHTS), 1)
    np.testing.assert_array_equal(error[..., 0], by_light)
    np.testing.assert_allclose(errors_of(data, "preconditioned", registered=True), error / 2)
