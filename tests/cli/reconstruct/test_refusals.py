"""Options and places that are refused before anything is written."""

import numpy as np
import pytest

from periscopy_sim.cli import inputs

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

COUNTS = np.random.default_rng(21).integers(9000, 65536, (24, 24, 3)).astype(np.uint16)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "magic"), "no method 'magic'; use noise-aware, preconditioned, "),
        (("--method", "mine.py:Mine"), "there is no file mine.py"),
        (
            ("--method", "differencing", "--repair-threshold", "1"),
            "--repair-threshold belongs to --method preconditioned, truncated-svd or pseudoinverse,"
            " not to differencing; leave it out",
        ),
        (("--method", "noise-aware", "--tv-weight", "0"), "--method noise-aware takes 1e-09 to"),
        (("--method", "pseudoinverse", "--rank-tolerance", "1e-3"), "--rank-tolerance belongs to"),
        (("--method", "differencing", "--repair-threshold", "0.1"), "--repair-threshold belongs"),
        (("--model", "guessed"), "'guessed' is not one of 'rendered', 'analytic'"),
        (("--tv-weight", "-1"), "'--tv-weight'"),
        (("--tv-weight", "inf"), "'--tv-weight'"),
        (("--tv-weight", "heavy"), "'--tv-weight'"),
        (("--repair-threshold", "-1"), "'--repair-threshold'"),
        (("--repair-threshold", "inf"), "'--repair-threshold'"),
        (("--rank-tolerance", "0"), "'--rank-tolerance'"),
        (("--rank-tolerance", "1"), "'--rank-tolerance'"),
        (("--hidden", "24x24"), "full column rank"),
        (("--hidden", "24x25"), "24x25 hidden patches are more than the 24x24 pixels"),
        (("--scene", "sofa"), "'sofa' does not exist; name a file or a shipped scene: bright_room"),
        (("--truth", "sofa"), "'sofa' does not exist; name a file or a shipped image: bars"),
        (("--transport", "none.npy"), "none.npy: no such file"),
    ],
)
def test_impossible_option_is_refused(options, message, refused, setting, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    assert message in refused("reconstruct", "y.npy", *setting, *options, "--out", "out")


def test_place_that_cannot_be_written_is_refused_before_rendering(
    refused, monkeypatch, setting, tmp_path
):
    monkeypatch.setattr(inputs, "load", None)
    (tmp_path / "file").write_text("kept")
    for out in ("file", "file/new", "file/new/deep"):
        line = refused("reconstruct", "y.npy", *setting, "--out", out)
        assert f"cannot write {out}: " in line


def test_method_that_knows_one_size_is_refused_before_anything_is_rendered(refused, monkeypatch):
    from periscopy_sim.cli.fitting.transport_matrix import AskedTransport

    monkeypatch.setattr(AskedTransport, "matrix", lambda *_: pytest.fail("rendered"))
    line = refused("reconstruct", "y.exr", "--scene", "chair", "-D", "resolution=24", "--hidden",
                   "4x5", "--method", "unrolled", "--out", "out")  # fmt: skip
    assert "method 'unrolled' learned from hidden images of 29x36 patches alone" in line
    assert "--hidden 29x36" in line and "make learned" in line
