import pytest

import periscopy_sim as ps
from periscopy_sim.photographs import film_size
from periscopy_sim.photographs.film_size import (
    PIXELS_IN_STEP,
    choose_film,
    films_of_blocks,
    films_of_marks,
    shadow_step,
)


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario("chair", (1, 1), {"resolution": 63})


def test_step_of_the_chairs_shadow_is_that_of_similar_triangles(scenario):
    """Patches of 10.54 mm in height; the chair stands 0.361 to 0.436 m from the wall of 1.03 m."""
    step = shadow_step(scenario, (29, 36))
    height = 0.305789 / 29
    assert height * 0.361 / 0.669 <= step <= height * 0.436 / 0.594
    assert shadow_step(scenario, (58, 72)) == pytest.approx(step / 2, rel=1e-6)


def test_without_a_shadow_in_the_field_of_view_there_is_no_step():
    away = ps.load_scenario("chair", (1, 1), {"resolution": 63, "occluder_dx": 3})
    assert shadow_step(away, (29, 36)) is None
    assert choose_film(away, (29, 36), [(20, 20), (63, 63), (126, 126)]) == (63, 63)


def test_the_coarsest_film_that_is_fine_enough_is_chosen(scenario, monkeypatch):
    films = films_of_blocks((1008, 1008))
    chosen = choose_film(scenario, (29, 36), films)
    finest_pixel = shadow_step(scenario, (29, 36)) / PIXELS_IN_STEP
    side = 0.401  # metres of the wall that the camera sees
    assert side / chosen[0] <= finest_pixel
    assert side / max(film for film in films if film < chosen)[0] > finest_pixel
    assert choose_film(scenario, (29, 36), [(8, 8), (9, 9)]) == (9, 9)  # none is: the finest
    monkeypatch.setattr(film_size, "has_memory", lambda size: size < 3e9)
    small = choose_film(scenario, (290, 360), films)
    assert small == (28, 28)  # 0.6 GB and 25 bytes for each entry of A


@pytest.mark.parametrize(
    ("coverage", "placement", "finest"),
    [(100, 0.25, 2), (100, 0.5, 1), (100, 3.0, 1), (9, 0.1, 3), (9, 0.0, 3), (0.25, 0.0, 0.5)],
)
def test_marks_and_photograph_bound_the_film(coverage, placement, finest):
    """Placed to half of its pixels at best, but for films as coarse as the scene's own."""
    films = films_of_marks((60, 80), coverage, placement)
    assert max(films) == (60 * finest, 80 * finest)
    assert all(rows * 4 == columns * 3 for rows, columns in films) and (30, 40) in films


def test_films_of_blocks_divide_both_sides():
    films = films_of_blocks((800, 1200))
    assert (100, 150) in films and films[0] == (800, 1200) and films[-1] == (2, 3)
    assert all(800 % rows == 0 and columns * 2 == rows * 3 for rows, columns in films)


def test_step_does_not_depend_on_the_film(scenario):
    finer = ps.load_scenario("chair", (1, 1), {"resolution": 126})
    assert shadow_step(finer, (29, 36)) == pytest.approx(shadow_step(scenario, (29, 36)), rel=0.02)
