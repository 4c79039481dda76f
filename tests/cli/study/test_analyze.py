import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.study.analyze import MEANINGS
from periscopy_sim.evaluation.diagnostics import diagnose

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


def test_numbers_are_those_of_the_diagnosis(succeeds, tmp_path):
    options = ("--seed", "3", "--rank-tolerance", "1e-4", "--out", "analysis")
    printed = succeeds("analyze", "chair", *TINY, *options)
    folder = tmp_path / "analysis"
    names = {"summary.json", "bounds.png", "bounds.npy", "bounds_without_background.npy"}
    assert {path.name for path in folder.iterdir()} == names
    assert all(name.replace("_", " ") in printed for name in MEANINGS)
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["model"], summary["samples"]) == ("rendered", 4)
    scenario = ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})
    A = ps.render_transport(scenario, samples=4, strata="gauss", seed=3)
    expected = diagnose(
        A, ps.point_light_backgrounds(scenario), (24, 24), (4, 5), rank_tolerance=1e-4
    )
    assert expected.background_rank > 3 and summary["identity_error"] < 1e-10
    for name in MEANINGS.keys() - {"identity_error"}:
        assert summary[name] == pytest.approx(getattr(expected, name), rel=1e-6), name
    for name in ("bounds", "bounds_without_background"):
        np.testing.assert_allclose(np.load(folder / f"{name}.npy"), getattr(expected, name))


def test_patches_that_cannot_be_told_apart_are_refused(refused):
    assert "chair.xml" in refused("analyze", "chair", *TINY, "--hidden", "24x24", "--out", "out")
