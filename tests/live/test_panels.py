from dataclasses import replace

import numpy as np

from periscopy_sim.live.panels import hidden_pixels, panels_of, photograph_pixels
from periscopy_sim.photograph import Photograph


def never(*_):
    """No newer wish comes."""


def test_every_picture_has_a_panel_and_false_colours_a_scale(level, choice):
    pictures = level().pictures(choice, never)
    panels = panels_of(pictures)
    assert [len(each.pictures[0]) for each in panels] == [24, 6, 6, 6]
    assert f"{pictures.psnr:.1f} dB" in panels[1].caption
    assert panels[3].scale[2].partition(" of")[0] in panels[3].caption
    assert panels[3].look()["scale"]["colours"][0] == "#000004"  # magma's darkest
    without = replace(pictures, report=replace(pictures.report, standard_errors=None))
    assert not panels_of(without)[3].pictures
    assert len(panels_of(replace(pictures, frame=0))) == 3


def test_residual_takes_the_place_of_what_nobody_knows(level, choice):
    values = level().pictures(choice, never).photograph.values
    used = np.ones((24, 24), bool)
    used[:6] = False
    pictures = level(photograph=Photograph(values, used)).pictures(replace(choice, image=""), never)
    for shown in photograph_pixels(pictures), panels_of(pictures)[2].pictures[0]:
        np.testing.assert_array_equal(shown[..., 3], 255 * used)  # the page hatches the rest
    assert hidden_pixels(pictures)["monitor"].shape == (6, 8, 3)  # the reconstruction
    assert "Unexplained" in panels_of(pictures)[2].caption
