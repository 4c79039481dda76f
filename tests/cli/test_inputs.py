"""Scenes and matrices as the commands are given them, mostly through `periscopy transport`."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli import inputs
from periscopy_sim.figures.laboratory import overview, projections
from periscopy_sim.rendering.variant import examine_variants

pytestmark = pytest.mark.usefixtures("jit")

HIDDEN = ("--hidden", "4x5", "--samples", "4")
TINY = ("-D", "resolution=24", *HIDDEN)
OUT = ("--out", "A.npy")


@pytest.mark.parametrize("name", ["wall", "monitor"])
def test_scene_without_a_shape_of_the_contract_is_refused(name, edited_scene, refused):
    scene = edited_scene((f'id="{name}"', 'id="poster"'))
    line = refused("transport", scene, *TINY, *OUT)
    assert f"'{scene}' has no shape with id '{name}'" in line
    assert "'poster'" in line and "'chair_back'" in line  # what it has instead


def test_scene_without_the_camera_is_refused(edited_scene, refused):
    scene = edited_scene(('id="camera"', 'id="eye"'))
    line = refused("transport", scene, *TINY, *OUT)
    assert f"'{scene}' has no sensor with id 'camera'" in line and "'eye'" in line


def test_pixel_that_misses_the_wall_is_counted_and_located(edited_scene, refused):
    # The wall reaches from x = -0.2565 to 1.7435; the camera now sees from -0.2865 to 2.1135.
    scene = edited_scene(
        ('<scale x="0.2005" y="0.2005"/>', '<scale x="1.2" y="0.2005"/>'),
        ("0.7435, 0.98, 0.2645", "0.9135, 0.98, 0.2645"),
        ("0.7435, 1.03, 0.2645", "0.9135, 1.03, 0.2645"),
    )
    x = 0.9135 + 1.2 * ((np.arange(24) + 0.5) / 12 - 1)
    missing = np.flatnonzero((x < -0.2565) | (x > 1.7435))
    line = refused("transport", scene, *TINY, *OUT)
    assert f"{24 * len(missing)} of 576 camera pixels miss the wall" in line
    assert f"the first at row 0, column {missing[0]}" in line


def test_monitor_that_faces_away_is_refused(edited_scene, refused):
    scene = edited_scene(('<rotate z="1" angle="180"/>', ""))
    assert "the monitor faces away" in refused("transport", scene, *TINY, *OUT)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "missing file"),
        (b"", "empty file"),
        (b"solid metal\n", "cannot be read"),
        (1500, "cannot be read"),
    ],
)
def test_unreadable_mesh_is_refused_by_name(content, message, edited_scene, refused, tmp_path):
    plant = '<shape type="ply" id="plant"><string name="filename" value="plant.ply"/></shape>'
    scene = edited_scene(("</scene>", f"{plant}</scene>"))
    sound = (ps.find_scene("plant").parent / "meshes" / "plant.ply").read_bytes()
    if content is not None:
        content = sound[:content] if isinstance(content, int) else content
        (tmp_path / "plant.ply").write_bytes(content)
    line = refused("transport", scene, *TINY, *OUT)
    assert scene in line and message in line and "plant.ply" in line


def test_file_that_is_no_scene_is_refused(edited_scene, refused, tmp_path):
    scene = edited_scene()
    whole = (tmp_path / "edited.xml").read_text()
    for content in (whole[: len(whole) // 2].encode(), bytes(range(256)), b""):
        (tmp_path / "edited.xml").write_bytes(content)
        line = refused("transport", scene, *TINY, *OUT)
        assert f"'{scene}' is not well-formed XML" in line


def test_plugin_that_does_not_exist_is_named_with_its_line(edited_scene, refused):
    scene = edited_scene(('type="orthographic"', 'type="pinhole"'))
    line = refused("transport", scene, *TINY, *OUT)
    assert scene in line and "pinhole" in line and "line" in line


def test_unknown_scene_is_answered_by_the_shipped_ones(refused):
    line = refused("transport", "sofa", *TINY, *OUT)
    assert "'sofa' does not exist" in line and "bright_room, chair, plant, plate" in line
    assert "is a folder" in refused("transport", ".", *TINY, *OUT)


def test_undeclared_parameter_is_answered_by_what_is_likely_meant(refused):
    line = refused("transport", "chair", "-D", "resolutio=24", *HIDDEN, *OUT)
    assert line.endswith("declares no parameter 'resolutio'; did you mean 'resolution'?")
    line = refused("transport", "chair", "-D", "occluder_d=0.1", *HIDDEN, *OUT)
    assert line.endswith("did you mean 'occluder_dx' or 'occluder_dy' or 'occluder_dz'?")


def test_undeclared_parameter_like_no_other_is_answered_by_the_declared_ones(refused):
    line = refused("transport", "chair", "-D", "pixels=24", *HIDDEN, *OUT)
    assert "declares no parameter 'pixels'" in line
    for name in ("occluder_dx (default 0)", "monitor_dz (default 0)", "resolution (default 126)"):
        assert name in line


@pytest.mark.parametrize(
    ("definition", "message"),
    [
        ("resolution", "-D 'resolution' is not of the form name=value"),
        ("=24", "-D '=24' is not of the form name=value"),
        ("resolution=", "-D 'resolution=' is not of the form name=value"),
        ("resolution=fine", 'could not parse integer value "fine", given as resolution=fine'),
        ("resolution=-24", "has width -24; give it a whole number from 1 on"),
        ("resolution=0", "has width 0; give it a whole number from 1 on"),
        ("occluder_dx=left", 'floating point value "left", given as occluder_dx=left'),
    ],
)
def test_malformed_parameter_is_refused(definition, message, refused):
    assert message in refused("transport", "chair", "-D", definition, *HIDDEN, *OUT)


def test_parameter_given_twice_is_refused(refused):
    line = refused("transport", "chair", "-D", "resolution=9", *TINY, *OUT)
    assert "-D resolution is given twice" in line


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ("0x5", "0x5 patches has none; give at least 1x1"),
        ("4x0", "4x0 patches has none; give at least 1x1"),
        ("20x29", "20x29 hidden patches are more than the 24x24 pixels"),
        ("5", "'5' is not a size; write ROWSxCOLUMNS"),
        ("4x5x3", "'4x5x3' is not a size"),
        ("-4x5", "'-4x5' is not a size"),
        ("4.5x5", "'4.5x5' is not a size"),
    ],
)
@pytest.mark.parametrize("command", ["transport", "analyze"])
def test_impossible_hidden_size_is_refused(command, size, message, refused):
    out = "A.npy" if command == "transport" else "folder"
    line = refused(command, "chair", "-D", "resolution=24", "--hidden", size, "--out", out)
    assert message in line


@pytest.mark.parametrize(
    ("variant", "message"),
    [
        ("pixar_rgb", "unknown Mitsuba variant 'pixar_rgb'; installed here: scalar_rgb"),
        ("scalar_spectral", "'scalar_spectral' is not an RGB variant"),
    ],
)
def test_wrong_variant_is_refused(variant, message, monkeypatch, refused):
    monkeypatch.setenv("PERISCOPY_VARIANT", variant)
    assert message in refused("transport", "chair", *TINY, *OUT)


def test_variant_that_does_not_work_here_is_refused_with_the_reason(monkeypatch, refused):
    broken = [report for report in examine_variants() if not report.works]
    if not broken:
        pytest.skip("every variant works here")
    monkeypatch.setenv("PERISCOPY_VARIANT", broken[0].name)
    line = refused("transport", "chair", *TINY, *OUT)
    assert broken[0].name in line and broken[0].reason in line


def test_scalar_variant_serves_too(tmp_path, monkeypatch, succeeds, complaints):
    monkeypatch.setenv("PERISCOPY_VARIANT", "scalar_rgb")
    command = ("transport", "chair", "-D", "resolution=16", "--hidden", "2x3", "--samples", "64")
    ended = subprocess.run(
        [sys.executable, "-m", "periscopy_sim", *command, "--out", "scalar.npy"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, complaints(ended.stderr)) == (0, "")
    monkeypatch.delenv("PERISCOPY_VARIANT")
    succeeds(*command, "--out", "A.npy")
    scalar, A = np.load(tmp_path / "scalar.npy"), np.load(tmp_path / "A.npy")
    assert scalar.dtype == A.dtype == np.float32 and scalar.shape == (256, 6)
    # Pixel centres against pixel areas: the sums differ little, the penumbrae more.
    assert np.allclose(scalar.sum(axis=0), A.sum(axis=0), rtol=0.03)


# -- shadows -------------------------------------------------------------------------------------


NO_SHADOW = "no occluder casts a shadow of the monitor"
BEHIND = ("--scene", "chair", "-D", "resolution=24", "-D", "occluder_dy=-0.8")


@pytest.mark.usefixtures("few_lights")
@pytest.mark.parametrize(
    "command",
    [
        ("draw", "chair", *BEHIND[2:], "--out", "lab.png"),
        ("prepare", "y.npy", *BEHIND, "--out", "wall.exr"),
        ("reconstruct", "y.npy", *BEHIND, *HIDDEN, "--out", "r"),
        ("video", "stack.npy", *BEHIND, *HIDDEN, "--out", "v"),
        ("analyze", "chair", *BEHIND[2:], *HIDDEN, "--out", "a"),
    ],
    ids=lambda command: command[0],
)
def test_every_command_says_that_no_shadow_falls_into_view(
    command, periscopy, monkeypatch, tmp_path
):
    monkeypatch.setattr(overview, "COLUMNS", {True: 160})
    monkeypatch.setattr(projections, "GRID", {True: 40})
    light = np.random.default_rng(3).uniform(1, 2, (24, 24, 3))
    np.save(tmp_path / "y.npy", light)
    np.save(tmp_path / "stack.npy", np.stack([light, light + 0.1]))
    outcome = periscopy(*command)
    # Without shadows and without noise of its own, A tells no patches apart.
    refused = command[0] == "analyze"
    assert outcome.code == (2 if refused else 0)
    assert ("not full column rank" in outcome.err) == refused
    (line,) = [line for line in outcome.err.splitlines() if NO_SHADOW in line]
    assert line.startswith(f"periscopy: warning: chair: {NO_SHADOW}")
    assert "'chair_seat' is 0.075 m large" in line and line.endswith("4 more")
    assert line.count("m: behind the monitor") == 3
    for folder in ("r", "v"):
        if (tmp_path / folder).is_dir():
            told = json.loads((tmp_path / folder / "summary.json").read_text())["warnings"]
            assert any(NO_SHADOW in warning for warning in told)


# -- what strangers mix up -----------------------------------------------------------------------


@pytest.mark.parametrize("command", ["transport", "draw"])
def test_measurements_in_the_place_of_a_scene_are_answered_by_lab(command, refused, tmp_path):
    (tmp_path / "mine.yaml").write_text("wall:\n  distance: 1 m\n")
    options = ("--out", "lab.png") if command == "draw" else (*TINY, *OUT)
    line = refused(command, "mine.yaml", *options)
    assert line == (
        "mine.yaml: measurements are no scene yet; make one of them: periscopy lab mine.yaml --out "
        "mine.xml"
    )
    assert "scene 'other.yaml' does not exist" in refused(command, "other.yaml", *options)


def test_missing_mask_is_answered_by_the_one_beside_it(refused, tmp_path):
    np.save(tmp_path / "y.npy", np.ones((24, 24, 3)))
    command = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--mask", "y.png", "--out", "r")
    assert "y.png" in refused(*command) and "is that meant" not in refused(*command)
    (tmp_path / "y_mask.png").write_bytes(b"")
    assert "y.png: no such file; there is y_mask.png: is that meant?" in refused(*command)


def test_photograph_without_its_mask_is_answered_by_the_one_beside_it(refused, tmp_path):
    light = np.ones((24, 24, 3))
    light[3, 4] = np.nan
    np.save(tmp_path / "y.npy", light)
    command = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--out", "r")
    assert refused(*command).endswith("leave them out by a mask")
    (tmp_path / "y_mask.png").write_bytes(b"")
    assert refused(*command).endswith("leave them out by a mask, such as --mask y_mask.png")


@pytest.mark.parametrize(
    ("hidden", "told"),
    [((15, 20), ""), ((20, 15), "is 15x20 meant?"), ((10, 20), ""), ((4, 5), ""), ((40, 40), "")],
)
def test_rows_and_columns_that_look_interchanged_are_told(hidden, told, capfd):
    """The monitor is 0.4 m x 0.3 m: 4 to 3, as 20 columns to 15 rows."""
    rows, columns = hidden
    scenario = SimpleNamespace(
        hidden_shape=hidden,
        patch_across=np.tile([-0.4 / columns, 0, 0], (rows * columns, 1)),
        patch_up=np.tile([0, 0, 0.3 / rows], (rows * columns, 1)),
    )
    lines = inputs.warn_of_long_patches(scenario, "lab.xml")
    assert ("".join(lines)[-len(told) :] if told else "".join(lines)) == told
    assert len(capfd.readouterr().err.splitlines()) == len(lines)
