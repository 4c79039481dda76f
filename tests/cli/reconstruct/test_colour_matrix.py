"""`--colour-matrix` of `periscopy photograph` and `reconstruct`."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples")
M = [[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]]


def test_what_a_camera_mixes_a_reconstruction_unmixes(succeeds, tmp_path):
    (tmp_path / "m.json").write_text(json.dumps(M))
    images = []
    for name, option in (("plain", ()), ("mixed", ("--colour-matrix", "m.json"))):
        photo = f"{name}.exr"
        succeeds("photograph", "chair", "mushroom", *TINY, "1024", *option, "--out", photo)
        succeeds(
            "reconstruct", photo, "--scene", "chair", *TINY, "16", *option, "--truth", "mushroom",
            "--out", name,
        )  # fmt: skip
        images.append(np.load(tmp_path / name / "reconstruction.npy"))
    plain, mixed = (
        json.loads((tmp_path / n / "summary.json").read_text()) for n in ("plain", "mixed")
    )
    assert plain["colour_matrix"] is None and mixed["colour_matrix"] == M
    assert mixed["psnr"] == pytest.approx(plain["psnr"], abs=1)
    assert plain["psnr_colour_matched"] >= plain["psnr"] - 0.1
    assert np.sqrt(np.mean((images[1] - images[0]) ** 2)) < 0.1 * np.sqrt(np.mean(images[0] ** 2))


def test_a_matrix_that_is_none_is_refused(refused, tmp_path):
    (tmp_path / "m.csv").write_text("1,2\n3,4\n")
    np.save(tmp_path / "y.npy", np.ones((24, 24, 3)))
    for command in (
        ("photograph", "chair", "mushroom"),
        ("reconstruct", "y.npy", "--scene", "chair"),
    ):
        line = refused(*command, *TINY, "4", "--colour-matrix", "m.csv", "--out", "new.exr")
        assert line.startswith("m.csv: ")
