import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.photographs.develop import sensor_image
from periscopy_sim.photographs.prepare import PAPER_SIDE, PlacedFilm, place_film
from periscopy_sim.photographs.wall_view import Marks, WallPoints, fit_view, wall_plane

SIDE, MARGIN = 6, np.array([10.0, 4.0])  # of a pixel of the film; to the left and above the film
SIZE = (24 * SIDE + 8, 24 * SIDE + 20)
OFFSETS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario("chair", (1, 1), {"resolution": 24})


@pytest.fixture(scope="module")
def points(scenario):
    """Where the photograph shows pixels of the film, in a lattice."""
    row, column = np.indices(scenario.photograph_shape)[:, 2::7, 1::7].reshape(2, -1)
    on_film = np.stack([column, row], axis=1) + 0.5
    positions = scenario.view.centers.reshape(*scenario.photograph_shape, 3)[row, column]
    return WallPoints(SIDE * on_film + MARGIN, positions)


def corners_on_film(cell=1):
    column, row = np.meshgrid(np.arange(25.0), np.arange(25.0))
    return (SIDE * np.stack([column, row], axis=-1) + MARGIN) / cell


@pytest.mark.parametrize("cell", [1, 2])
def test_film_is_where_the_points_place_it(scenario, points, cell):
    """A cell of a mosaic is two pixels wide, but marks are the sensor's."""
    rows, columns = SIZE
    light = sensor_image(np.ones((rows // cell, columns // cell)), "y", cell=cell)
    film = place_film(light, scenario, points)
    assert np.abs(film.corners - corners_on_film(cell)).max() < 1e-3
    assert film.coverage == pytest.approx((SIDE / cell) ** 2, rel=1e-4)
    whole = place_film(sensor_image(np.ones(SIZE), "y"), scenario, points)
    assert film.placement == pytest.approx(whole.placement) and not film.missing
    assert not film.beneath_tags().any()


def test_pixels_that_the_paper_of_a_tag_touches_are_beneath_it(scenario):
    plane = wall_plane(scenario)
    places, turns = np.array([[-0.08, 0.05], [0.09, -0.07], [0.19, 0.19]]), [0.0, 0.5, 0.2]
    to_pixels = np.linalg.inv(plane.film)

    def on_film(wall):
        image = np.column_stack([wall, np.ones(len(wall))]) @ to_pixels.T
        return image[:, :2] / image[:, 2:]

    squares = []
    for place, angle in zip(places, turns, strict=True):
        cos, sin = np.cos(angle), np.sin(angle)
        squares.append(place + 0.03 * OFFSETS @ np.array([[cos, sin], [-sin, cos]]))
    seen = np.array([SIDE * on_film(square) + MARGIN for square in squares])
    view = fit_view(Marks.of_tags(seen, places, np.full(3, 0.03), list("abc")), SIZE)
    hidden = PlacedFilm(view, plane, corners_on_film(), SIDE**2, 0.0).beneath_tags()
    touched = np.zeros_like(hidden)
    part = np.linspace(0, 1, 200)[:, np.newaxis]
    for square in squares:
        paper = square.mean(axis=0) + PAPER_SIDE * (square - square.mean(axis=0))
        edge = paper + part[..., np.newaxis] * (np.roll(paper, -1, axis=0) - paper)
        inside = np.floor(on_film(edge.reshape(-1, 2))).astype(int)
        inside = inside[((inside >= 0) & (inside < 24)).all(axis=1)]
        touched[inside[:, 1], inside[:, 0]] = True
    assert touched.any() and hidden[touched].all()
    assert hidden.sum() < 3 * (PAPER_SIDE * 0.03 * np.sqrt(2) / (0.401 / 24) + 2) ** 2
