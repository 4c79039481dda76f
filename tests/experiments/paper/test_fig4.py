"""Fig. 4's numbers and labels, from results that are known."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from experiments.paper import fig4
from experiments.report import Verdict
from experiments.sweeps import errors_of

SBRS = np.array(fig4.SBRS)
LIGHTS = [f"{name}{flip}" for name in ("a", "b") for flip in ("", " up-down")]
BOUND = {"bound": list(1 / SBRS), "P y": list(2 / SBRS)}


def results(**errors):
    """Mean squared errors by method (in identifiers), (SBRs,) or (SBRs, backgrounds)."""
    named = {
        name.replace("_", " ").replace("noise aware", "noise-aware"): e
        for name, e in errors.items()
    }
    values = [np.broadcast_to(np.transpose(e), (len(LIGHTS), len(SBRS))) for e in named.values()]
    error = np.stack(values)[..., None]
    dims = ("algorithm", "background", "sbr", "seed")
    return xr.Dataset(
        {
            "mean_squared_error": (dims, error),
            "psnr_registered": (dims, -10 * np.log10(error / 2)),
        },
        {"algorithm": list(named), "background": LIGHTS, "sbr": SBRS, "seed": [0]},
    )


def flat(level):
    return np.full(len(SBRS), level)


@pytest.fixture
def found():
    steep = 0.01 * (SBRS[-1] / SBRS) ** 0.5
    main = results(preconditioned=flat(0.04), differencing=steep, noise_aware=flat(0.004))
    exact = results(
        preconditioned=flat(0.04),
        differencing=steep,
        noise_aware=flat(0.004),
        without_repair=2 * steep,
    )
    return {"path-traced": main, fig4.EXACT: exact}


def test_errors_are_those_of_the_method_by_sbr_background_and_draw():
    by_light = np.arange(1.0, 5) * np.ones((len(SBRS), 1))
    data = results(preconditioned=by_light, differencing=flat(7.0))
    error = errors_of(data.transpose("seed", "sbr", "background", "algorithm"), "preconditioned")
    assert error.shape == (len(SBRS), len(LIGHTS), 1)
    np.testing.assert_array_equal(error[..., 0], by_light)
    np.testing.assert_allclose(errors_of(data, "preconditioned", registered=True), error / 2)


def test_verdicts_follow_the_growth_of_the_errors(found):
    whole, published, better, exact, ours = fig4._claims(found, BOUND)
    assert [claim.verdict for claim in (whole, published)] == [Verdict.AGREES] * 2
    assert published.measured.startswith("error at SBR 0.2 over that at 10: mean 7.07")
    assert better.verdict == Verdict.DIFFERS and better.measured == "at SBR 0.5 and below"
    assert "without repair 7.1; the bound 50.0; P y over the bound 2.000" in exact.measured
    assert ours.measured.startswith("0.10 to 0.10") and ours.verdict == Verdict.MEASURED
    # One of four backgrounds in which the error grows is enough.
    error = np.full((len(SBRS), len(LIGHTS)), 0.04)
    error[fig4.SBRS.index(0.2), 3] *= 1.5
    grown = results(preconditioned=error, differencing=flat(0.1), noise_aware=flat(0.1))
    claims = fig4._claims({**found, "path-traced": grown}, BOUND)
    assert [claim.verdict for claim in claims[:3]] == [
        Verdict.DIFFERS,
        Verdict.DIFFERS,
        Verdict.AGREES,
    ]


def test_every_curve_is_named_at_its_end_and_no_two_names_overlap(found):
    ax = Figure().subplots()
    fig4._curves(ax, found["path-traced"], "a")
    ax.set_ylim(1e-3, 1)
    fig4._label_ends(ax, {"x": (0.01, "black"), "y": (0.0101, "red"), "z": (0.3, "blue")})
    texts = {text.get_text(): text for text in ax.texts}
    assert sorted(texts) == ["x", "y", "z"]
    heights = np.log([texts[name].xyann[1] for name in "xyz"])
    assert np.diff(heights).min() >= 0.07 * np.log(1e3)
    assert heights[[0, 2]] == pytest.approx(np.log([0.01, 0.3]))
    drawn = {line.get_color(): line.get_ydata() for line in ax.lines}
    assert len(drawn) == 3
    np.testing.assert_allclose(drawn[fig4.COLORS["noise-aware"]], 0.004)
