import numpy as np
import pytest
import tifffile
from PIL import Image

from periscopy_sim.storage.photographs import read_mask
from periscopy_sim.storage.rasters import read_exr

pytestmark = pytest.mark.usefixtures("jit")

RNG = np.random.default_rng(6)
SCENE = ("--scene", "chair", "-D", "resolution=24")
LIGHT = RNG.normal(3000, 20, (96, 96, 3)).round()
MEANS = LIGHT.reshape(24, 4, 24, 4, 3).mean(axis=(1, 3))


@pytest.fixture
def photo(tmp_path):
    """A 14-bit TIFF with a black level of 512."""
    return save(tmp_path / "y.tif", LIGHT + 512)


def save(path, counts):
    tifffile.imwrite(path, counts.astype(np.uint16), photometric="rgb")
    return path.name


def wall_points(count=8, seed=1):
    """Points of the chair's wall, and where a camera that looks at it aslant shows them."""
    rng = np.random.default_rng(seed)
    across, up = rng.uniform(-0.2, 0.2, (2, count))
    points = np.stack([0.7435 + across, np.full(count, 1.03), 0.2645 + up], axis=1)
    depth = 1 + 0.4 * across
    pixels = np.stack([48 + 190 * across / depth, 48 - 200 * up / depth], axis=1)
    return np.hstack([pixels, points])


def write_points(path, rows, header="column,row,x,y,z"):
    lines = [",".join(f"{value:.6f}" for value in row) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path.name


def test_blocks_are_averaged_to_the_scenes_film(photo, succeeds, tmp_path):
    succeeds("prepare", photo, *SCENE, "--black", 512, "--out", "new/wall.exr")
    assert {path.name for path in (tmp_path / "new").iterdir()} == {
        "wall.exr", "wall_mask.png", "wall_preview.png"
    }  # fmt: skip
    pixels, metadata = read_exr(tmp_path / "new" / "wall.exr")
    assert np.allclose(pixels, MEANS, rtol=1e-6)
    assert len(metadata["photographs_sha256"]) == 64
    assert metadata["command"].startswith("periscopy prepare y.tif --scene chair")
    assert metadata["pixels_left_out"] == "0" and len(metadata["scene_sha256"]) == 64
    mask = np.asarray(Image.open(tmp_path / "new" / "wall_mask.png"))
    assert mask.shape == (24, 24, 3) and (mask == 255).all()


def test_dark_frames_and_flat_fields_are_averaged_and_taken_off(succeeds, tmp_path):
    for k, level in enumerate((500, 524)):
        save(tmp_path / f"dark{k}.tif", np.full(LIGHT.shape, level))
    fall = np.linspace(0.8, 1.2, 96)[:, None, None] * np.ones(LIGHT.shape)
    save(tmp_path / "bright.tif", 512 + LIGHT * fall)
    save(tmp_path / "flat.tif", 512 + 5000 * fall)
    options = ("--dark", "dark0.tif", "--dark", "dark1.tif", "--flat", "flat.tif")
    succeeds("prepare", "bright.tif", *SCENE, *options, "--out", "wall.exr")
    pixels, _ = read_exr(tmp_path / "wall.exr")
    assert np.allclose(pixels, MEANS, rtol=1e-3)


def test_points_rectify(succeeds, tmp_path):
    light = np.full((96, 96, 3), 2000.0) + RNG.normal(0, 10, (96, 96, 3))
    save(tmp_path / "y.tif", light)
    write_points(tmp_path / "p.csv", wall_points())
    printed = succeeds("prepare", "y.tif", *SCENE, "--points", "p.csv", "--out", "wall.exr")
    assert "points            8, fit to 0.00 pixels" in printed
    pixels, metadata = read_exr(tmp_path / "wall.exr")
    assert np.nanmean(pixels) == pytest.approx(2000, rel=1e-3)
    assert metadata["view_distortion"] == "none"
    assert len(metadata["view_homography"].split()) == 9
    assert float(metadata["view_residual_pixels"]) < 1e-3


def test_bin_sets_the_films_size_and_says_how(photo, succeeds, tmp_path):
    printed = succeeds("prepare", photo, "--scene", "chair", "--bin", 8, "--out", "wall.exr")
    assert "-D resolution=12" in printed
    pixels, metadata = read_exr(tmp_path / "wall.exr")
    assert pixels.shape == (12, 12, 3) and "resolution" in metadata["parameters"]
    write_points(tmp_path / "p.csv", wall_points())
    given = ("--bin", 4, "--points", "p.csv", "--out", "wall.exr")
    succeeds("prepare", photo, *SCENE[:2], *given)
    assert read_exr(tmp_path / "wall.exr")[0].shape == (20, 20, 3)


def test_bad_input_is_refused_by_one_line(photo, refused, tmp_path):
    bad, off = wall_points(), wall_points()
    bad[3, 0] += 9
    off[2, 3] = 1.3
    for name, rows in {"bad.csv": bad, "off.csv": off}.items():
        write_points(tmp_path / name, rows)
    Image.new("L", (5, 5), 255).save(tmp_path / "five.png")
    save(tmp_path / "five.tif", np.ones((5, 5, 3)))
    Image.new("L", (24, 24), 255).save(tmp_path / "wall_mask.png")
    for options, offender in [
        (("--points", "bad.csv"), "bad.csv, line 5"),
        (("--points", "off.csv"), "off.csv, line 4"),
        (("--points", "bad.csv", "--tags", "t.csv"), "--tags"),
        (("--dark", "five.tif"), "the dark frame: 5 x 5"),
        (("--bin", 7), "by whole square blocks"),
        (("--mask", "five.png"), "5 x 5"),
        (("--mask", "wall_mask.png"), "wall_mask.png"),
        (("-D", "resolution=25"), "25 x 25"),
    ]:
        scene = SCENE[:2] if "resolution" in str(options) or "--bin" in options else SCENE
        assert offender in refused("prepare", photo, *scene, *options, "--out", "wall.exr")


def test_tags_are_found_rectified_and_left_out(succeeds, refused, tmp_path):
    cv2 = pytest.importorskip("cv2")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # The film's 480 pixels and 20 beyond: on a picture's very border, a hundredth of one decides.
    picture = np.full((520, 520), 150, np.uint16)
    rows = []
    for number, (top, left) in enumerate(((30, 40), (350, 60), (60, 330), (340, 350))):
        picture[top - 12 : top + 92, left - 12 : left + 92] = 230
        picture[top : top + 80, left : left + 80] = (
            cv2.aruco.generateImageMarker(dictionary, number, 80) * 0.9
        )
        x, z = 0.543 + (left + 20) / 480 * 0.401, 0.465 - (top + 20) / 480 * 0.401
        rows.append(f"{number},{x},1.03,{z},{80 / 480 * 0.401}")
    save(tmp_path / "y.tif", np.repeat(picture[..., None], 3, axis=2) * 100)
    (tmp_path / "t.csv").write_text("\n".join(["id,x,y,z,size", *rows]) + "\n")
    printed = succeeds("prepare", "y.tif", *SCENE, "--tags", "t.csv", "--out", "wall.exr")
    mask = read_mask(tmp_path / "wall_mask.png")
    pixels, _ = read_exr(tmp_path / "wall.exr")
    assert "tags              4, fit to 0.0" in printed
    assert not mask[1:4, 2:4].any() and mask[9:13].all()
    assert np.allclose(pixels[mask], 15000, rtol=1e-3)
    more = [*rows, rows[0].replace("0,", "9,", 1)]
    (tmp_path / "t.csv").write_text("\n".join(["id,x,y,z,size", more[4]]) + "\n")
    given = ("prepare", "y.tif", *SCENE, "--tags", "t.csv", "--out", "other.exr")
    assert "t.csv" in refused(*given)
