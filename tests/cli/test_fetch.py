from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat

import periscopy_sim as ps
from periscopy_sim.cli import fetch
from periscopy_sim.storage.published import published_sets


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """No server answers, and nothing is cached."""
    for variable in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.setenv(variable, "http://127.0.0.1:9")
    monkeypatch.setenv("PERISCOPY_DATA", str(tmp_path / "cache"))
    monkeypatch.setattr("pooch.core.time.sleep", lambda _: None)


def test_sets_are_listed_without_a_name(succeeds):
    assert [line.split()[0] for line in succeeds("fetch").splitlines()] == [*published_sets()]


@pytest.mark.usefixtures("nowhere")
def test_no_network_is_one_line(periscopy):
    outcome = periscopy("fetch", "saunders2019-chair", "--out", "out")
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1 and "saunders2019" in outcome.told


def test_folder_holds_captures_and_what_reconstruct_reads(succeeds, tmp_path, monkeypatch):
    name, known = next(iter(published_sets().items()))
    image = np.tile([[2.0, 4.0], [4.0, 6.0]], (126, 126))
    (tmp_path / "cache" / "a").mkdir(parents=True)
    savemat(
        tmp_path / "cache" / "a" / "b.mat", {"image": image, "shutter_speed": 1, "iterations": 1}
    )
    small = replace(known, files={"a/b.mat": ""}, layout="captures")
    monkeypatch.setattr(fetch, "published_sets", lambda: {name: small})
    monkeypatch.setattr(fetch, "fetch_set", lambda *_: tmp_path / "cache")
    succeeds("fetch", name, "--out", "out")
    assert {file.name for file in (tmp_path / "out" / "a").iterdir()} == {"b.mat", "b.npz"}
    assert ps.read_photograph(tmp_path / "out" / "a" / "b.npz", (126, 126)).values.min() == 2
