import csv
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import OpenEXR
import pytest
import typer
import xarray as xr
from PIL import Image, ImageSequence

import periscopy_sim as ps
from periscopy_sim.cli import scene as scenes
from periscopy_sim.cli import video as command
from periscopy_sim.reconstruction.video import Video

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

SCENE = ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5")
TINY = (*SCENE, "--samples", "4")
PLAIN = ("--tv-weight", "0", "--repair-threshold", "1e9")  # P y alone
RNG = np.random.default_rng(22)
FIRST = RNG.uniform(0.1, 1, (4, 5, 3))
CLIP = np.stack([np.roll(FIRST, k, axis=1) for k in range(9)])
FILES = {"frames", "frames.npy", "metrics.csv", "summary.json", "video.png"}


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})


@pytest.fixture(scope="module")
def transport(scenario):
    return ps.render_transport(scenario, samples=4)


@pytest.fixture(scope="module")
def light(transport):
    """Photographs of CLIP, as the scene's own matrix has them, and noise of 40 dB."""
    signal = (transport.astype(np.float64) @ CLIP.reshape(9, 20, 3)).reshape(9, 24, 24, 3)
    noise = 0.01 * np.sqrt(np.mean(signal**2))
    return signal + np.random.default_rng(5).normal(0, noise, signal.shape)


@pytest.fixture(scope="module")
def few(light):
    return light[:3]


@pytest.fixture
def video(succeeds, tmp_path):
    """Reconstruct a sequence into `out`; return the frames, the summary and the table."""

    def run(given, *options):
        succeeds("video", given, *TINY, *options, "--out", "out")
        return results(tmp_path / "out")

    return run


def results(folder):
    with (folder / "metrics.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    return np.load(folder / "frames.npy"), json.loads((folder / "summary.json").read_text()), table


def fitted(transport, scenario, **settings):
    B = ps.point_light_backgrounds(scenario)
    return ps.Periscope.for_scene(scenario, transport, B, **settings)


def next_frames(photographs, periscope, **settings):
    """What the method makes of photographs that come one at a time."""
    method = Video(periscope, **settings)
    return np.array([method.next_frame(y) for y in photographs])


def column(table, name):
    return np.array([float(row[name]) for row in table])


def animation(path):
    with Image.open(path) as picture:
        shown = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(picture)]
        return shown, dict(picture.info)


def linear(codes):
    shown = codes / 255
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


# -- what is recovered and written ---------------------------------------------------------------


def test_hidden_video_is_recovered(light, video, tmp_path):
    np.save(tmp_path / "y.npy", light)
    frames, _, _ = video("y.npy", *PLAIN)
    assert frames.shape == (9, 4, 5, 3) and frames.dtype == np.float32
    assert np.corrcoef(frames.ravel(), CLIP.ravel())[0, 1] > 0.95


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), {"coupling": "l1"}),
        (("--l1-weight", "0.2"), {"l1_weight": 0.2}),
        (("--coupling", "total-variation"), {"coupling": "total-variation"}),
        (
            ("--coupling", "total-variation", "--temporal-weight", "3"),
            {"coupling": "total-variation", "temporal_weight": 3.0},
        ),
        (("--coupling", "none"), {"coupling": "none"}),
    ],
)
def test_frames_are_those_of_the_coupling_asked_for(
    options, settings, few, transport, scenario, video, tmp_path
):
    np.save(tmp_path / "y.npy", few)
    frames, summary, _ = video("y.npy", *options, "--batch", "2")
    expected = next_frames(few, fitted(transport, scenario), **settings)
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())
    assert summary["explicit"] is True
    assert {name: summary[name] for name in settings} == settings
    weight = {"total-variation": {"temporal_weight"}, "l1": {"l1_weight"}, "none": set()}
    assert {"temporal_weight", "l1_weight"} & summary.keys() == weight[summary["coupling"]]


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (("--tv-weight", "0"), {"tv_weight": 0.0}),
        (("--tv-weight", "5"), {"tv_weight": 5.0}),
        (("--repair-threshold", "1e9"), {"repair_threshold": 1e9}),
        (("--rank-tolerance", "1e-3"), {"tolerance": 1e-3}),
    ],
)
def test_preconditioner_and_weights_follow_their_options(
    options, settings, few, transport, scenario, video, tmp_path
):
    np.save(tmp_path / "y.npy", few)
    frames, summary, _ = video("y.npy", *options)
    periscope = fitted(transport, scenario, **settings)
    assert summary["background_rank"] == periscope.preconditioner.Q.shape[1]
    expected = next_frames(few, periscope)
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())
    if "tolerance" not in settings:
        default = next_frames(few, fitted(transport, scenario))
        assert np.abs(default - expected).max() > 0.02 * expected.max()


def test_couplings_and_weights_differ(few, video, tmp_path):
    np.save(tmp_path / "y.npy", few)
    found = [
        video("y.npy", *options)[0]
        for options in (
            ("--coupling", "none"),
            (),
            ("--l1-weight", "9"),
            ("--coupling", "total-variation"),
            ("--coupling", "total-variation", "--temporal-weight", "0.1"),
        )
    ]
    scale = np.abs(found[0]).max()
    for k, frames in enumerate(found):
        assert np.allclose(frames[0], found[0][0], atol=1e-6 * scale)  # the first is a still
        for others in found[:k]:
            assert np.abs(frames[1:] - others[1:]).max() > 1e-3 * scale


@pytest.mark.parametrize("batch", [1, 3, 64])
def test_size_of_the_batch_does_not_matter(batch, few, transport, scenario, video, tmp_path):
    np.save(tmp_path / "y.npy", few)
    frames, summary, _ = video("y.npy", "--batch", batch)
    expected = next_frames(few, fitted(transport, scenario))
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())
    assert summary["batch"] == batch


def test_memory_too_small_for_the_preconditioner_keeps_it_in_factors(
    few, video, monkeypatch, tmp_path
):
    np.save(tmp_path / "y.npy", few)
    expected, summary, _ = video("y.npy")
    assert summary["explicit"] is True
    monkeypatch.setattr(command.os, "sysconf", lambda _: 100)
    frames, summary, _ = video("y.npy")
    assert summary["explicit"] is False and not np.array_equal(frames, expected)
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())


def test_folder_holds_frames_pictures_table_and_summary(light, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", light)
    arguments = ("video", "y.npy", *TINY, "--seed", "3", "--rate", "25", "--out", "new/out")
    out = succeeds(*arguments)
    folder = tmp_path / "new" / "out"
    assert {path.name for path in folder.iterdir()} == FILES
    assert {path.name for path in (folder / "frames").iterdir()} == {
        f"{k:04d}.png" for k in range(9)
    }
    assert out.startswith("wrote new/out/frames, new/out/frames.npy, ")
    assert "9 frames, " in out and "in batches of 16" in out
    _, summary, table = results(folder)
    expected = {
        "photographs": "y.npy",
        "frames": 9,
        "photograph_shape": [24, 24],
        "hidden_shape": [4, 5],
        "model": "rendered",
        "transport": None,
        "samples": 4,
        "tv_weight": 1.0,
        "repair_threshold": 0.1,
        "rank_tolerance": 1e-10,
        "coupling": "l1",
        "l1_weight": Video(None).l1_weight,
        "batch": 16,
        "rate": 25.0,
        "warnings": [],
        "truth": None,
    }
    assert {name: summary[name] for name in expected} == expected
    assert "temporal_weight" not in summary
    assert list(table[0]) == ["frame", "name", "seconds", "noise", "lambda", "kappa"]
    assert [row["frame"] for row in table] == [row["name"] for row in table]
    assert [int(row["frame"]) for row in table] == list(range(9))
    for name in ("seconds", "noise", "lambda", "kappa"):
        assert summary["median"][name] == np.median(column(table, name)) > 0
    rates = summary["frames_per_second"]
    assert rates["batch"] == pytest.approx(9 / column(table, "seconds").sum())
    assert rates["live"] > 0
    provenance = summary["provenance"]
    assert provenance["command"] == "periscopy " + " ".join(arguments)
    assert provenance["seed"] == 3 and provenance["parameters"] == {"resolution": "24"}
    for name in ("video.png", "frames/0003.png"):
        with Image.open(folder / name) as picture:
            assert picture.info["scene_sha256"] == provenance["scene_sha256"]
    _, info = animation(folder / "video.png")
    assert info["duration"] == pytest.approx(40)


def test_table_tells_the_noise_and_the_weights_of_each_frame(
    light, transport, scenario, video, tmp_path
):
    louder = light.copy()
    louder[6] += np.random.default_rng(1).normal(0, 0.1 * light.mean(), light[6].shape)
    np.save(tmp_path / "y.npy", louder)
    _, _, table = video("y.npy")
    periscope = fitted(transport, scenario)
    stills = [periscope.solve(y) for y in louder]
    noise = [np.sqrt(np.mean(still.noise**2)) for still in stills]
    weight = [np.sqrt(np.mean(still.weight**2)) for still in stills]
    assert np.allclose(column(table, "noise"), noise, rtol=1e-3)
    assert np.allclose(column(table, "lambda"), weight, rtol=1e-3)
    assert column(table, "noise").argmax() == 6
    assert column(table, "kappa")[0] == pytest.approx(stills[0].threshold, rel=1e-3)


def test_pictures_share_one_white(light, video, tmp_path):
    dimmed = light * np.linspace(1, 0.2, 9)[:, None, None, None]
    np.save(tmp_path / "y.npy", dimmed)
    frames, summary, _ = video("y.npy")
    assert summary["white"] == pytest.approx(np.percentile(frames, 99.5), rel=1e-6)
    for k, image in enumerate(frames):
        with Image.open(tmp_path / "out" / "frames" / f"{k:04d}.png") as picture:
            pixels = np.asarray(picture)
        assert pixels.shape == (4 * 144, 5 * 144, 3)
        shown = linear(pixels[72::144, 72::144])
        assert np.allclose(shown, np.clip(image / summary["white"], 0, 1), atol=0.006)


def test_animation_shows_every_photograph_beside_its_frame(light, video, tmp_path):
    np.save(tmp_path / "y.npy", light)
    frames, summary, _ = video("y.npy")
    shown, info = animation(tmp_path / "out" / "video.png")
    assert len(shown) == 9 and info["loop"] == 0
    white = np.percentile(light, 99.5)
    for picture, photograph, image in zip(shown, light, frames, strict=True):
        inside = np.nonzero((picture != 255).any(axis=2).all(axis=1))[0]  # rows of panels
        assert inside.size == 0 or np.ptp(inside) < 245
        # Margins of 12 pixels, titles of 34; patches of 10 and of 60 pixels.
        wall = linear(picture[34:274, 12:252][5::10, 5::10])
        assert np.allclose(wall, np.clip(photograph / white, 0, 1), atol=0.006)
        hidden = linear(picture[34:274, 264:564][30::60, 30::60])
        assert np.allclose(hidden, np.clip(image / summary["white"], 0, 1), atol=0.006)


def save_exr(path, clip):
    parts = [
        OpenEXR.Part(
            {"name": f"t{k}"}, {c: y[..., i].astype(np.float32) for i, c in enumerate("RGB")}
        )
        for k, y in enumerate(clip)
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(path))


def save_zarr(path, clip):
    dimensions = ("frame", "row", "column", "channel")
    xr.Dataset({"photograph": (dimensions, clip)}).to_zarr(path, zarr_format=3, consolidated=False)


def save_folder(path, clip):
    path.mkdir()
    for k, y in enumerate(clip):
        np.save(path / f"y{k}.npy", y)


WRITERS = {
    "y.npy": np.save,
    "y.npz": lambda path, clip: np.savez(path, photograph=clip),
    "y.zarr": save_zarr,
    "y.exr": save_exr,
    "folder": save_folder,
}


def test_every_form_gives_the_same_video(few, video, tmp_path):
    clip = few.astype(np.float32)
    found = {}
    for form, write in WRITERS.items():
        write(tmp_path / form, clip)
        found[form], _, table = video(form)
        names = {"y.exr": "t{}", "folder": "y{}.npy"}.get(form, "{}")
        assert [row["name"] for row in table] == [names.format(k) for k in range(3)]
    assert all(np.array_equal(frames, found["y.npy"]) for frames in found.values())


def test_same_command_gives_the_same_frames_and_pictures(few, video, tmp_path):
    np.save(tmp_path / "y.npy", few)
    contents = []
    for _ in range(2):
        video("y.npy", "--truth", "bars")
        names = ("frames.npy", "video.png", "frames_sheet.png", "frames/0002.png")
        contents.append([(tmp_path / "out" / name).read_bytes() for name in names])
    assert contents[0] == contents[1]


def test_one_photograph_is_a_video_too(light, video, tmp_path):
    np.save(tmp_path / "y.npy", light[:1])
    frames, summary, table = video("y.npy", "--truth", "bars")
    assert len(frames) == summary["frames"] == len(table) == 1


def test_transport_file_and_model_serve_like_in_reconstruct(few, video, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", few)
    rendered, _, _ = video("y.npy")
    tiny = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
    succeeds("transport", "chair", *tiny, "--out", "A.npy")
    frames, summary, _ = video("y.npy", "--transport", "A.npy")
    assert np.array_equal(frames, rendered)
    assert (summary["model"], summary["transport"], summary["samples"]) == ("file", "A.npy", None)
    analytic, summary, _ = video("y.npy", "--model", "analytic", "--rank-tolerance", "1e-4")
    assert summary["model"] == "analytic" and not np.allclose(analytic, rendered, rtol=1e-3)
    assert summary["rank_tolerance"] == 1e-4


def test_matrix_without_its_record_is_warned_of(few, periscopy, transport, tmp_path):
    np.save(tmp_path / "y.npy", few)
    np.save(tmp_path / "A.npy", transport)
    outcome = periscopy("video", "y.npy", *SCENE, "--transport", "A.npy", "--out", "out")
    assert outcome.code == 0 and outcome.err.startswith("periscopy: warning: A.npy has no JSON")


# -- against the truth ---------------------------------------------------------------------------


def own_metrics(frames, truth):
    errors = []
    for image, wanted in zip(np.maximum(frames.astype(np.float64), 0), truth, strict=True):
        matched = np.empty_like(image)
        for c in range(3):
            x, y = image[..., c].ravel(), wanted[..., c].ravel()
            gain = np.linalg.lstsq(x[:, None], y, rcond=None)[0]
            matched[..., c] = np.clip(gain * image[..., c], 0, 1)
        errors.append(np.mean((matched - wanted) ** 2))
    return np.array(errors)


@pytest.mark.parametrize("given", ["clip.npy", "one.npy", "folder", "bars"])
def test_truth_adds_metrics_and_a_contact_sheet(given, light, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", light)
    np.save(tmp_path / "clip.npy", CLIP)
    np.save(tmp_path / "one.npy", FIRST)
    (tmp_path / "folder").mkdir()
    codes = np.random.default_rng(0).integers(0, 256, (9, 4, 5, 3)).astype(np.uint8)
    for k, code in enumerate(codes):
        Image.fromarray(code).save(tmp_path / "folder" / f"{k}.png")
    bars = ps.read_hidden_image(ps.find_image("bars"), (4, 5))
    truth = {
        "clip.npy": CLIP,
        "one.npy": np.stack([FIRST] * 9),
        "folder": linear(codes),
        "bars": np.stack([bars] * 9),
    }[given]
    out = succeeds("video", "y.npy", *TINY, "--truth", given, "--out", "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"frames_sheet.png"}
    frames, summary, table = results(tmp_path / "out")
    errors = own_metrics(frames, truth)
    assert np.allclose(column(table, "mean_squared_error"), errors, rtol=1e-4)
    assert np.allclose(column(table, "psnr"), -10 * np.log10(errors), atol=1e-3)
    assert summary["median"]["psnr"] == pytest.approx(np.median(-10 * np.log10(errors)), abs=1e-3)
    assert summary["truth"] == given
    assert f"median gain-matched PSNR {summary['median']['psnr']:.2f} dB" in out
    shown, _ = animation(tmp_path / "out" / "video.png")
    for picture, wanted in zip(shown, truth, strict=True):
        assert np.allclose(linear(picture[34:274, 576:876][30::60, 30::60]), wanted, atol=0.006)


def test_contact_sheet_has_at_most_eight_columns(light, video, monkeypatch, tmp_path):
    from periscopy_sim.evaluation import contact_sheet

    np.save(tmp_path / "y.npy", light)
    np.save(tmp_path / "clip.npy", CLIP)
    drawn = {}

    def draw(path, rows, **rest):
        path.write_bytes(b"")
        drawn.update(rest, rows=dict(rows))

    monkeypatch.setattr(contact_sheet, "draw_contact_sheet", draw)
    frames, _, table = video("y.npy", "--truth", "clip.npy")
    chosen = [int(title.removeprefix("frame ")) for title in drawn["titles"]]
    assert len(chosen) == 8 and chosen[0] == 0 and chosen[-1] == 8
    errors = column(table, "mean_squared_error")
    assert drawn["notes"] == [f"MSE {errors[k]:.4f}" for k in chosen]
    assert list(drawn["rows"]) == ["measurement", "truth", "reconstruction"]
    assert np.allclose(drawn["rows"]["truth"], CLIP[chosen])
    for k, image in zip(chosen, drawn["rows"]["reconstruction"], strict=True):
        # What is shown has the error that is written beneath.
        assert np.mean((image - CLIP[k]) ** 2) == pytest.approx(errors[k], rel=1e-4)
    assert frames.shape[0] == 9


# -- what is told --------------------------------------------------------------------------------


def test_what_holds_for_many_photographs_is_said_once(periscopy, tmp_path):
    (tmp_path / "y").mkdir()
    for k in range(5):
        codes = np.random.default_rng(k).integers(99, 256, (24, 24, 3)).astype(np.uint8)
        Image.fromarray(codes).save(tmp_path / "y" / f"{k}.png")
    (tmp_path / "y" / "notes.txt").write_text("x")
    outcome = periscopy("video", "y", *TINY, "--out", "out")
    left_out, gamma = outcome.err.splitlines()
    assert outcome.code == 0 and left_out == "periscopy: warning: y: left out notes.txt"
    assert gamma.startswith("periscopy: warning: y/0.png: 8-bit PNG, which is normally gamma")
    assert gamma.endswith(" (likewise 4 more)")
    _, summary, _ = results(tmp_path / "out")
    said = [f"periscopy: warning: {warning}" for warning in summary["warnings"]]
    assert said == [left_out, gamma]


def test_terminal_shows_how_many_frames_a_second(few, periscopy, monkeypatch, tmp_path):
    np.save(tmp_path / "y.npy", few)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "100")
    outcome = periscopy("video", "y.npy", *TINY, "--out", "out")
    assert outcome.code == 0
    assert "reconstructing" in outcome.err and "frames/s" in outcome.err
    assert "3/3" in outcome.err


# -- what is refused -----------------------------------------------------------------------------


def with_frame(k, value):
    clip = np.random.default_rng(0).uniform(1, 2, (9, 24, 24, 3)).astype(np.float32)
    clip[k, 3, 4, 1] = value
    return clip


@pytest.mark.parametrize("form", WRITERS)
def test_bad_frame_is_refused_before_rendering(form, refused, monkeypatch, tmp_path):
    monkeypatch.setattr(scenes, "transport", None)
    place = "folder/y7.npy" if form == "folder" else f"{form}, frame 7"
    black = with_frame(0, 1)
    black[7] = 0
    for clip, said in [
        (with_frame(7, np.nan), "1 values are NaN or infinite, the first at row 3, column 4, chan"),
        (with_frame(7, -np.inf), "1 values are NaN or infinite, the first at row 3, column 4, cha"),
        (black, "every value is zero; check the exposure"),
    ]:
        where = tmp_path / form
        if where.is_dir():
            where.rename(tmp_path / f"old{len(list(tmp_path.iterdir()))}")
        WRITERS[form](where, clip)
        line = refused("video", form, *TINY, "--out", "out")
        assert line.startswith(f"{place}: {said}")


def test_sequence_that_is_none_is_refused(refused, tmp_path):
    np.save(tmp_path / "still.npy", np.ones((24, 24, 3)))
    np.save(tmp_path / "large.npy", np.ones((2, 48, 48, 3)))
    (tmp_path / "empty").mkdir()
    (tmp_path / "mixed").mkdir()
    np.save(tmp_path / "mixed" / "a.npy", np.ones((24, 24, 3)))
    Image.new("RGB", (24, 24)).save(tmp_path / "mixed" / "b.png")
    save_exr(tmp_path / "y.exr", with_frame(0, 1))
    content = (tmp_path / "y.exr").read_bytes()
    (tmp_path / "y.exr").write_bytes(content[: len(content) * 2 // 3])
    for name, message in {
        "none": "none: no such file",
        "still.npy": "still.npy: has shape (24, 24, 3); give a stack (frames, rows, columns, 3)",
        "large.npy": "large.npy: 48 x 48 pixels (rows x columns), but the scene's camera has 24 x",
        "empty": "empty: holds no file named *.exr, *.npy",
        "mixed": "mixed: holds NPY (a.npy), PNG (b.png); keep frames of one format alone there",
        "mixed/b.png": "mixed/b.png: is a single PNG file; give a folder of photographs",
        "y.exr": "y.exr, frame 5: truncated or damaged EXR; save or copy it again",
    }.items():
        assert refused("video", name, *TINY, "--out", "out").startswith(message)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--coupling", "magic"), "'total-variation', 'l1', 'none'"),
        (
            ("--coupling", "l1", "--temporal-weight", "1"),
            "--temporal-weight belongs to --coupling t",
        ),
        (
            ("--coupling", "total-variation", "--l1-weight", "1"),
            "--l1-weight belongs to --coupling l1, not to total-variation",
        ),
        (("--coupling", "none", "--l1-weight", "1"), "--l1-weight belongs to --coupling l1"),
        (("--temporal-weight", "-1"), "'--temporal-weight'"),
        (("--temporal-weight", "nan"), "'--temporal-weight'"),
        (("--coupling", "l1", "--l1-weight", "inf"), "'--l1-weight'"),
        (("--tv-weight", "-1"), "'--tv-weight'"),
        (("--tv-weight", "nan"), "'--tv-weight'"),
        (("--repair-threshold", "nan"), "'--repair-threshold'"),
        (("--rank-tolerance", "0"), "'--rank-tolerance'"),
        (("--rate", "0"), "'--rate'"),
        (("--rate", "nan"), "'--rate'"),
        (("--batch", "0"), "'--batch'"),
        (("--hidden", "24x24"), "full column rank"),
        (("--hidden", "24x25"), "24x25 hidden patches are more than the 24x24 pixels"),
        (("--scene", "sofa"), "'sofa' does not exist; name a file or a shipped scene: chair"),
        (("--truth", "sofa"), "'sofa' does not exist; name a file or a shipped image: bars"),
        (("--truth", "three.npy"), "three.npy: holds 3 hidden images for 9 photographs"),
        (("--truth", "dark.npy"), "dark.npy, frame 4: has negative, NaN or infinite values"),
        (("--truth", "empty"), "empty: holds no file named"),
        (("--transport", "none.npy"), "none.npy: no such file"),
    ],
)
def test_impossible_option_is_refused(options, message, refused, tmp_path):
    np.save(tmp_path / "y.npy", with_frame(0, 1))
    np.save(tmp_path / "three.npy", CLIP[:3])
    np.save(tmp_path / "dark.npy", np.where(np.arange(9)[:, None, None, None] == 4, -1, CLIP))
    (tmp_path / "empty").mkdir()
    assert message in refused("video", "y.npy", *TINY, *options, "--out", "out")


def test_nan_is_refused_whatever_the_parser_thinks_of_it():
    assert command._not_nan(0.5) == 0.5 and command._not_nan(None) is None
    with pytest.raises(typer.BadParameter, match="nan is not a number"):
        command._not_nan(float("nan"))


def test_pictures_of_a_longer_video_are_not_mixed_with_this_one(light, video, refused, tmp_path):
    np.save(tmp_path / "y.npy", light)
    np.save(tmp_path / "short.npy", light[:4])
    video("y.npy")
    line = refused("video", "short.npy", *TINY, "--out", "out")
    assert line.startswith("out/frames/0004.png is of a longer video; remove out/frames")
    frames, _, _ = video("y.npy", "--coupling", "none")  # the same length may replace it
    assert len(frames) == 9


def test_interruption_leaves_nothing(light, tmp_path):
    np.save(tmp_path / "y.npy", light[np.arange(4000) % 9])
    before = sorted(tmp_path.iterdir())
    run = subprocess.Popen(
        [sys.executable, "-m", "periscopy_sim", "video", "y.npy", *TINY, "--out", "deep/out"],
        cwd=tmp_path, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not list(tmp_path.glob("deep/.*/frames.npy")) and run.poll() is None:
        time.sleep(0.01)
    # While numba compiles, an interrupt may be lost in one of its callbacks: press again.
    for _ in range(5):
        run.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            out, err = run.communicate(timeout=15)
            break
    else:
        run.kill()
        run.communicate()
        pytest.fail("five interrupts were ignored")
    assert (run.returncode, out) == (130, "")
    assert err.endswith("periscopy: error: interrupted; nothing was written\n")
    assert sorted(tmp_path.iterdir()) == before
