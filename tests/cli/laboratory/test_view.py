import json
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from dataclasses import replace

import numpy as np
import psutil
import pytest

from periscopy_sim.cli.laboratory.view import write_view
from periscopy_sim.live.choice import Choice
from periscopy_sim.live.level import Level
from periscopy_sim.reconstruction.report import Report
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.formats.exr import read_exr

pytestmark = pytest.mark.usefixtures("jit")
SIZE = ("--hidden", "3x4")


@pytest.fixture
def viser():
    return pytest.importorskip("viser")


def test_missing_extra_is_named(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "'.[live]'" in refused("view", "plate", *SIZE)


@pytest.mark.usefixtures("viser")
def test_what_cannot_be_viewed_is_refused_in_a_line(refused, tmp_path):
    np.save(tmp_path / "small.npy", np.ones((20, 30, 3)))
    (tmp_path / "taken").write_text("")
    for options, offender in {
        ("plate", "--ambient", "mars"): "'mars'",
        ("plate", "--method", "magic"): "'magic'",
        ("plate", "--image", "none"): "'none'",
        ("plate", "--hidden", "0x4"): "0x4",
        ("plate", "small.npy"): "20 x 30",
        ("plate", "small.npy", "--ambient", "overcast"): "--ambient",
        ("plate", "--out", "taken"): "taken",
    }.items():
        assert offender in refused("view", *SIZE, *options)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert f"127.0.0.1:{port}" in refused("view", "plate", *SIZE, "--port", port)
    assert not (tmp_path / "view").exists()


def pictures_of(photograph=None, **values):
    path = find_scene("plate")
    sizes = (24, 24), (3, 4)
    given = {"resolution": "24"}
    level = Level(path, given, sizes, lambda _: None, photograph, is_coarse=False)
    choice = Choice(values, "" if photograph else "mushroom", "", 0.5, 60.0, "noise-aware")
    return level.pictures(choice, lambda: False)


def test_scene_is_written_as_it_is_set(tmp_path, capsys):
    pictures = pictures_of(occluder_dx=0.0123)
    write_view(tmp_path / "view", pictures, {"resolution": "24"}, None)
    written = {file.name for file in (tmp_path / "view").iterdir()}
    assert written == {
        "scene.xml", "photograph.exr", "reconstruction.npy", "standard_error.npy",
        "reconstruction.png", "pictures.png", "certainty.png", "view.json",
    }  # fmt: skip
    assert "scene.xml" in capsys.readouterr().out
    defaults = read_document(tmp_path / "view" / "scene.xml").defaults
    assert defaults["occluder_dx"] == "0.0123" and defaults["resolution"] == "24"
    y, metadata = read_exr(tmp_path / "view" / "photograph.exr")
    np.testing.assert_allclose(y, pictures.photograph, rtol=1e-6)
    assert "scene_sha256" in metadata
    record = json.loads((tmp_path / "view" / "view.json").read_text())
    assert record["values"] == {"occluder_dx": 0.0123} and record["psnr"] == pictures.psnr


def test_a_given_photograph_is_written_as_what_is_left_of_it(tmp_path):
    taken = pictures_of(occluder_dx=0.01).photograph
    write_view(tmp_path / "view", pictures_of(taken), {"resolution": "24"}, "wall.exr")
    assert (tmp_path / "view" / "residual.png").is_file()
    assert not (tmp_path / "view" / "photograph.exr").exists()
    record = json.loads((tmp_path / "view" / "view.json").read_text())
    assert record["unexplained"] > 0 and record["photograph"] == "wall.exr"


def test_what_other_pictures_left_in_the_folder_is_removed(tmp_path):
    pictures = pictures_of()
    write_view(tmp_path / "view", pictures, {"resolution": "24"}, None)
    (tmp_path / "view" / "notes.txt").write_text("mine", "utf-8")
    plain = replace(pictures, report=Report())
    write_view(tmp_path / "view", plain, {"resolution": "24"}, None)
    written = {file.name for file in (tmp_path / "view").iterdir()}
    assert written == {
        "scene.xml", "photograph.exr", "reconstruction.npy", "reconstruction.png", "pictures.png",
        "view.json", "notes.txt",
    }  # fmt: skip


@pytest.mark.thorough
@pytest.mark.usefixtures("viser")
def test_interrupt_ends_it_and_leaves_nothing_behind(tmp_path):
    """Also while light is being rendered in a process of its own."""
    command = [sys.executable, "-m", "periscopy_sim", "view", "plate", *SIZE]
    running = subprocess.Popen(
        [*command, "--ambient", "overcast", "--port", "0"], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    record = running.stdout.readline()
    address = record.split()[0]
    assert address.startswith("http://127.0.0.1:") and "plate.xml" in record
    with urllib.request.urlopen(address) as page:
        assert b"<html" in page.read()
    process = psutil.Process(running.pid)
    children = []
    # At work, not half started: the light takes seconds.
    while not any(sum(each.cpu_times()[:2]) > 0.3 for each in children):
        assert running.poll() is None
        children = process.children()
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=120)
    assert running.returncode == 0 and out == "closed\n" and "Traceback" not in err
    psutil.wait_procs(children, timeout=20)
    assert not any(each.is_running() for each in children)
    assert not list(tmp_path.iterdir())
