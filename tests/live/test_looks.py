import re
from base64 import b64decode
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.errors import SceneError
from periscopy_sim.live import looks
from periscopy_sim.live.pictures import Choice, SizedLaboratory
from periscopy_sim.photograph import Photograph
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import find_scene
from tests.scenes.cards import SIZES, write_cards


def found_in(path):
    return looks.find_movables(load_scenario(path, (3, 4), photograph=(16, 16)))


@pytest.fixture(scope="module")
def chair():
    movables, handles = found_in(find_scene("chair"))
    return {each.name: each for each in movables}, {each.name: each for each in handles}


def test_handles_move_what_the_parameters_move_as_one(chair):
    _, handles = chair
    assert {name: handle.names for name, handle in handles.items()} == {
        "chair": ("occluder_dx", "occluder_dy", "occluder_dz"),
        "monitor": ("monitor_dx", "monitor_dy", "monitor_dz"),
        "camera": ("camera_dx", "camera_dz"),
    }
    np.testing.assert_allclose(handles["chair"].directions, np.eye(3), atol=1e-3)
    assert not handles["camera"].directions[:, 1].any()


def test_values_bring_a_handle_to_its_position(chair):
    handle = chair[1]["chair"]
    position = handle.center + np.array([0.01, -0.02, 0.03])
    values = handle.values(position)
    moved = {"occluder_dx": 0.01, "occluder_dy": -0.02, "occluder_dz": 0.03}
    assert values == pytest.approx(moved, abs=1e-5)
    np.testing.assert_allclose(handle.position(values), position)
    camera = chair[1]["camera"]  # which does not move along y
    moved = camera.position(camera.values(camera.center + np.array([0.01, 0.5, 0.02])))
    np.testing.assert_allclose(moved, camera.center + np.array([0.01, 0, 0.02]), atol=1e-9)


def test_sizes_stay_positive_and_places_reach_to_either_side(chair):
    movables, _ = chair
    assert not {"resolution", "occluder_dx_error"} & movables.keys()
    assert {"occluder_turn", "seat_width", "vertical_exponent", "camera_stretch"} <= movables.keys()
    for each in movables.values():
        assert each.low < each.value < each.high
        if each.name.endswith(("thickness", "width", "stretch", "exponent")):
            assert each.low > 0, each
    assert movables["occluder_dx"].low == -movables["occluder_dx"].high <= -0.05


def test_a_scene_without_anything_to_move_is_refused(tmp_path):
    text = find_scene("plate").read_text()
    values = dict(re.findall(r'<default name="(\w+)" value="([^"]*)"/>', text))
    text = re.sub(r"<default [^>]*/>", "", text)
    for name in sorted(values, key=len, reverse=True):
        text = text.replace(f"${name}", values[name])
    fixed = tmp_path / "fixed.xml"
    fixed.write_text(text)
    with pytest.raises(SceneError, match="declares nothing that can be moved"):
        found_in(fixed)


def test_images_stand_upright_where_they_are_in_the_scene(level, choice):
    pictures = level().fit(choice).pictures()
    scene, things = pictures.scenario, looks.images_in(pictures)
    grid = np.array(things["hidden"][0]["grid"])
    corners = grid[[-1, -1, 0, 0], [0, -1, 0, -1]]
    centers = scene.hidden.centers.reshape(*scene.hidden_shape, 3)
    expected = centers[-1, 0], centers[-1, -1], centers[0, 0], centers[0, -1]
    half = np.linalg.norm(scene.hidden.across[0] + scene.hidden.up[0]) / 2
    np.testing.assert_allclose(np.linalg.norm(corners - expected, axis=1), half, rtol=1e-5)
    np.testing.assert_allclose(
        np.mean(things["photograph"]["grid"], axis=(0, 1)),
        scene.view.centers.mean(axis=0),
        atol=0.01,
    )
    for occluder in scene.scene.occluders:
        shown = looks.mesh_of(occluder)
        vertices = np.reshape(shown["vertices"], (-1, 3))
        np.testing.assert_allclose(vertices, occluder.vertices, atol=1e-5)
        assert max(shown["faces"]) == len(vertices) - 1


def decoded(source):
    """The picture of a source."""
    return np.asarray(Image.open(BytesIO(b64decode(source.partition(",")[2]))))


def test_each_of_several_surfaces_shows_its_image_where_it_is(tmp_path):
    scene = ps.load_scenario(write_cards(tmp_path), SIZES)
    pictures = SizedLaboratory(scene, is_coarse=True).fit(Choice({}, "bars")).pictures()
    assert {name: image.shape[:2] for name, image in pictures.image.items()} == SIZES
    assert pictures.psnr > 20
    things = looks.images_in(pictures)["hidden"]
    for (name, surface), shown in zip(scene.hidden.items(), things, strict=True):
        np.testing.assert_allclose(shown["grid"], surface.vertices)
        assert looks.hidden_pixels(pictures)[name].shape == (*surface.shape, 3)
    for panel in looks.panels_of(pictures)[1:]:
        assert [decoded(each["source"]).shape[:2] for each in panel["pictures"]] == [
            *SIZES.values()
        ]
    assert "monitor 3 x 4, hidden_card 3 x 2 patches" in looks.panels_of(pictures)[1]["caption"]


def test_the_first_view_sees_the_wall_from_its_front():
    scene = ps.load_scenario("plate", (3, 4), photograph=(10, 12))
    view = looks.room_of(scene)["view"]
    azimuth, elevation = np.radians([view["azimuth"], view["elevation"]])
    x, y = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    eye = np.array(view["target"]) + view["distance"] * np.array([x, y, np.sin(elevation)])
    assert ((eye - scene.view.centers) @ scene.view.frame.normal > 0).all()


def test_a_source_holds_the_image():
    pixels = np.random.default_rng(0).integers(0, 256, (3, 5, 4), np.uint8)
    assert looks.as_source(pixels).startswith("data:image/png;base64,")
    np.testing.assert_array_equal(decoded(looks.as_source(pixels)), pixels)


def test_every_picture_has_a_panel_and_false_colours_a_scale(level, choice):
    pictures = level().fit(choice).pictures()
    panels = looks.panels_of(pictures)
    assert [len(decoded(each["pictures"][0]["source"])) for each in panels] == [24, 6, 6, 6]
    assert f"{pictures.psnr:.1f} dB" in panels[1]["caption"]
    assert panels[3]["scale"]["high"].partition(" of")[0] in panels[3]["caption"]
    assert panels[3]["scale"]["colours"][0].startswith("#00000")  # magma's darkest
    without = replace(pictures, report=replace(pictures.report, standard_errors=None))
    assert not looks.panels_of(without)[3]["pictures"]
    assert len(looks.panels_of(replace(pictures, frame=0))) == 3


def test_residual_takes_the_place_of_what_nobody_knows(level, choice):
    values = level().fit(choice).pictures().photograph.values
    used = np.ones((24, 24), bool)
    used[:6] = False
    pictures = level(photograph=Photograph(values, used)).fit(replace(choice, image="")).pictures()
    residual = decoded(looks.panels_of(pictures)[2]["pictures"][0]["source"])
    for shown in looks.photograph_pixels(pictures), residual:
        np.testing.assert_array_equal(shown[..., 3], 255 * used)  # the page hatches the rest
    assert looks.hidden_pixels(pictures)["monitor"].shape == (6, 8, 3)  # the reconstruction
    assert "Unexplained" in looks.panels_of(pictures)[2]["caption"]
