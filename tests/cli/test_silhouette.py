import json

import numpy as np
import pytest

from tests.scenes.silhouette import (  # noqa: F401 (fixtures)
    FLAG,
    SCENE,
    flagged,
    images,
    photographs,
    plane,
    scenario,
    scene,
)

pytestmark = pytest.mark.usefixtures("jit", "folder")
COMMAND = ("--scene", "scene.xml", "--hidden", "6x7", "--out", "out/found.xml")
KNOWN = ("y0.npy", "y1.npy", "--shown", "f0.npy", "--shown", "f1.npy")


@pytest.fixture
def folder(photographs, images, tmp_path):  # noqa: F811
    (tmp_path / "scene.xml").write_text(SCENE)
    for k, (y, f) in enumerate(zip(photographs, images, strict=True)):
        np.save(tmp_path / f"y{k}.npy", y)
        np.save(tmp_path / f"f{k}.npy", f)


def test_a_scene_with_the_silhouette_is_one_that_commands_take(succeeds, tmp_path):
    succeeds("calibrate", *KNOWN, *COMMAND, "--silhouette", "card", "--cells", "8x8")
    out = tmp_path / "out"
    files = {"found.xml", "found.json", "found_card.ply", "found_silhouette.png"}
    assert {file.name for file in out.iterdir()} == files
    record = json.loads((out / "found.json").read_text())
    opaque = np.array([[cell == "#" for cell in row] for row in record["opaque"]])
    assert np.mean(opaque == FLAG) > 0.95
    assert record["trusted"]
    scene = ("--scene", "out/found.xml", "--hidden", "6x7")  # noqa: F811
    succeeds("reconstruct", "y0.npy", *scene, "--out", "image")
    assert (tmp_path / "image" / "reconstruction.npy").is_file()


def test_what_cannot_be_done_exits_2_and_writes_nothing(refused, tmp_path):
    for arguments, name in [
        (("--silhouette", "wall"), "wall"),
        (("--silhouette", "card", "-D", "depth=1.2"), "card"),
        (("--silhouette", "card", "--cells", "40x40"), "40x40"),
        (("--silhouette", "card", "--free", "shift"), "--free"),
        (("--cells", "8x8"), "--cells"),
    ]:
        assert name in refused("calibrate", "y0.npy", *COMMAND, *arguments)
        assert not (tmp_path / "out").exists()
