from dataclasses import replace

import numpy as np

from periscopy_sim.live.level import Shot
from periscopy_sim.live.sheet import draw_sheet, monitor_pixels, photograph_pixels


def never():
    return False


def test_every_picture_is_on_the_sheet(level, choice):
    pictures = level().pictures(choice, never)
    sheet = draw_sheet(pictures)
    rows, columns, _ = sheet.shape
    quarters = [
        sheet[r : r + rows // 2, c : c + columns // 2]
        for r in (0, rows // 2)
        for c in (0, columns // 2)
    ]
    for quarter in quarters:
        colours = np.unique(quarter[120:-60, 60:-60].reshape(-1, 3), axis=0)
        assert len(colours) > 20
    assert draw_sheet(replace(pictures, standard_errors=None)).shape == sheet.shape


def test_residual_takes_the_place_of_what_nobody_knows(level, choice):
    taken = level().pictures(choice, never).photograph
    used = np.ones((24, 24), bool)
    used[:6] = False
    pictures = level(shot=Shot(taken, used)).pictures(replace(choice, image=""), never)
    assert np.all(photograph_pixels(pictures)[:6] == 150)
    assert monitor_pixels(pictures).shape == (6, 8, 3)  # the reconstruction
    assert draw_sheet(pictures).any()
