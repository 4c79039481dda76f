"""A scene in perspective."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.figures.space import draw_space
from tests.scenes.cards import SIZES, write_cards
from tests.scenes.pictures import covers, read
from tests.scenes.two_walls import write_two_walls

pytestmark = pytest.mark.usefixtures("jit")


def test_each_patch_has_its_colour_in_its_place(tmp_path):
    scenario = ps.load_scenario(write_cards(tmp_path), SIZES)
    images = {name: np.zeros((*size, 3)) for name, size in SIZES.items()}
    images["monitor"][0, :, 0], images["monitor"][2, 0] = 1, (0, 0, 1)
    images["hidden_card"][..., 1] = 1
    photograph = np.broadcast_to([1.0, 0, 1], (24, 24, 3))
    draw_space(tmp_path / "space.png", scenario, images, photograph, {"seed": "3"})
    text, pixels = read(tmp_path / "space.png")
    assert text["seed"] == "3"
    red, blue, green = (covers(pixels, 255 * np.eye(3)[k]) for k in (0, 2, 1))
    for seen in (red, blue, green):
        assert seen.sum() > 1000
    # A viewer's top left is at the top left.
    (red_rows, red_columns), (blue_rows, blue_columns) = map(np.nonzero, (red, blue))
    assert red_rows.mean() < blue_rows.mean() and blue_columns.mean() < red_columns.mean()


def test_photograph_is_on_the_wall_that_the_camera_sees(tmp_path):
    scenario = ps.load_scenario(write_two_walls(tmp_path), (3, 4), camera="left")
    photograph = np.broadcast_to([1.0, 0, 1], (24, 24, 3))
    draw_space(tmp_path / "space.png", scenario, {"monitor": np.zeros((3, 4, 3))}, photograph)
    red, green, blue = np.moveaxis(read(tmp_path / "space.png")[1][..., :3].astype(int), -1, 0)
    assert np.count_nonzero((red - green > 60) & (blue - green > 60)) > 1000
