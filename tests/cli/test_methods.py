import numpy as np
import pytest

from periscopy_sim.reconstruction.registry import METHODS

THOROUGH = pytest.mark.thorough

pytestmark = pytest.mark.usefixtures("jit", "few_lights")


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(name, marks=[] if name in ("noise-aware", "truncated-svd") else THOROUGH)
        for name in METHODS
        if name != "preconditioned"
    ],
)
def test_other_method_writes_its_image_and_what_it_reports(
    method, light, reconstruct, hidden, tmp_path
):
    np.save(tmp_path / "y.npy", light[0])
    np.save(tmp_path / "hidden.npy", hidden)
    _, summary = reconstruct("y.npy", "--method", method, "--truth", "hidden.npy")
    entry = METHODS[method]
    files = {"stages.png"} if method in ("truncated-svd", "pseudoinverse") else set()
    files |= {"certainty.png", "standard_error.npy"} if method == "noise-aware" else set()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("reconstruction.npy", "reconstruction.png", "summary.json", "comparison.png"),
        "residual.png",
        *files,
    }
    assert summary["method"] == method
    options = {option.name: option.default for option in entry.options}
    assert {name: summary.get(name) for name in options} == options
    # The others repair what they take for outliers in an image that is noise.
    assert summary["psnr"] > (25 if "differencing" in method else 10)
    assert summary["psnr_registered"] >= summary["psnr"] - 1e-9 and len(summary["shift"]) == 2
