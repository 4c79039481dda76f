from base64 import b64decode
from io import BytesIO
from types import SimpleNamespace

import numpy as np
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.live.panels import as_source, hidden_pixels, panels_of
from periscopy_sim.live.pictures import Choice, SizedLaboratory
from periscopy_sim.live.room import images_in, occluders_in, pixel_corners, room_of
from tests.scenes.cards import SIZES, write_cards


def test_photograph_covers_what_its_pixels_see():
    """Corners in the middle of four centres, and at the border half a pixel beyond them."""
    v, u = np.mgrid[0:20, 0:30] / 19 - 0.5
    local = np.stack([u * (1 + 0.5 * v), 0 * u, -v], axis=-1)  # a trapezoid of the wall
    corners = pixel_corners(SimpleNamespace(centers=local.reshape(-1, 3), shape=(20, 30)))
    assert corners.shape == (21, 31, 3)
    inner = (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:] + corners[:-1, :-1]) / 4
    np.testing.assert_allclose(inner, local, atol=1e-9)
    np.testing.assert_allclose(corners[[0, -1], :, 2].T, [[0.5 + 0.5 / 19, -0.5 - 0.5 / 19]] * 31)


def test_images_stand_upright_where_they_are_in_the_scene(level, choice):
    pictures = level().pictures(choice, lambda *_: None)
    scene, things = pictures.scenario, images_in(pictures)
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
    for shown, occluder in zip(
        occluders_in(pictures)["occluders"], scene.scene.occluders, strict=True
    ):
        vertices = np.reshape(shown["vertices"], (-1, 3))
        np.testing.assert_allclose(vertices, occluder.vertices, atol=1e-5)
        assert max(shown["faces"]) == len(vertices) - 1


def test_each_of_several_surfaces_shows_its_image_where_it_is(tmp_path):
    scene = ps.load_scenario(write_cards(tmp_path), SIZES)
    pictures = SizedLaboratory(scene, is_coarse=True).pictures(Choice({}, "bars"), lambda *_: None)
    assert {name: image.shape[:2] for name, image in pictures.image.items()} == SIZES
    assert pictures.psnr > 20
    things = images_in(pictures)["hidden"]
    for (name, surface), shown in zip(scene.hidden.items(), things, strict=True):
        np.testing.assert_allclose(shown["grid"], surface.vertices)
        assert hidden_pixels(pictures)[name].shape == (*surface.shape, 3)
    for panel in panels_of(pictures)[1:]:
        assert [each.shape[:2] for each in panel.pictures] == [*SIZES.values()]
    assert "monitor 3 x 4, hidden_card 3 x 2 patches" in panels_of(pictures)[1].caption


def test_the_first_view_sees_the_wall_from_its_front():
    scene = ps.load_scenario("plate", (3, 4), photograph=(10, 12))
    view = room_of(scene)["view"]
    azimuth, elevation = np.radians([view["azimuth"], view["elevation"]])
    x, y = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    eye = np.array(view["target"]) + view["distance"] * np.array([x, y, np.sin(elevation)])
    assert ((eye - scene.view.centers) @ scene.view.frame.normal > 0).all()


def test_a_source_holds_the_image():
    pixels = np.random.default_rng(0).integers(0, 256, (3, 5, 4), np.uint8)
    kind, _, text = as_source(pixels).partition(",")
    assert kind == "data:image/png;base64"
    np.testing.assert_array_equal(np.asarray(Image.open(BytesIO(b64decode(text)))), pixels)
