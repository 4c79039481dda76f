from dataclasses import replace

import numpy as np

from periscopy_sim.live.sheet import draw_sheet, hidden_pixels, photograph_pixels
from periscopy_sim.photograph import Photograph


def never():
    return False


def test_every_picture_is_on_the_sheet(level, choice):
    pictures = level().pictures(choice, never)
    sheet, captions = draw_sheet(pictures)
    half = len(sheet) // 2
    for rows in (slice(half), slice(half, None)):
        for columns in (slice(half), slice(half, None)):
            assert len(np.unique(sheet[rows, columns].reshape(-1, 3), axis=0)) > 20
    assert f"{pictures.psnr:.1f} dB" in " ".join(captions)
    without = draw_sheet(replace(pictures, report=replace(pictures.report, standard_errors=None)))
    assert without[0].shape == sheet.shape


def test_residual_takes_the_place_of_what_nobody_knows(level, choice):
    values = level().pictures(choice, never).photograph.values
    used = np.ones((24, 24), bool)
    used[:6] = False
    pictures = level(photograph=Photograph(values, used)).pictures(replace(choice, image=""), never)
    assert np.all(photograph_pixels(pictures)[:6] == 150)
    assert hidden_pixels(pictures)["monitor"].shape == (6, 8, 3)  # the reconstruction
    assert "Unexplained" in " ".join(draw_sheet(pictures)[1])
