from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import OutputError, SceneError
from periscopy_sim.evaluation.design import errors_of, grid_of, ranked, run_design

HIDDEN, SIDE = (3, 4), 12
RNG = np.random.default_rng(0)
A = RNG.uniform(0.2, 1, (SIDE * SIDE, 12))
B = RNG.uniform(0.2, 1, (SIDE * SIDE, 5))
POINTS = [{"a": "0", "b": "1.5"}, {"a": "1", "b": "-2"}, {"a": "2", "b": "0"}]


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario("chair", HIDDEN, {"resolution": SIDE})


@pytest.mark.parametrize("sbr", [0.5, np.inf])
def test_bound_is_that_of_least_squares_beside_the_ambient_light(scenario, sbr):
    """By the definition: the noise of the photograph, through the pseudoinverse of [A, B]."""
    light = (B / np.linalg.norm(B, axis=0)).sum(axis=1)
    white = A.sum(axis=1)
    photograph = white + light / light.mean() * white.mean() / sbr
    σ = 1e-3 * np.sqrt(np.mean(photograph**2))
    P = np.linalg.pinv(np.hstack([A, B]) if np.isfinite(sbr) else A)[:12]
    expected = σ * np.sqrt(np.mean(np.sum(P**2, axis=1)))
    assert errors_of(scenario, A, B, sbr=sbr) == {"bound": pytest.approx(expected, rel=1e-6)}


def test_nothing_is_won_by_units_or_by_cutting_pixels_in_two(scenario):
    """Twice the light is exposed for half as long; half a pixel has half of its electrons."""
    bound = pytest.approx(errors_of(scenario, A, B)["bound"], rel=1e-9)
    assert errors_of(scenario, 2 * A, B)["bound"] == bound
    finer = ps.load_scenario("chair", HIDDEN, {}, photograph=(2 * SIDE, SIDE))
    halves = np.repeat(A, 2, axis=0), np.repeat(B, 2, axis=0)
    assert errors_of(finer, *halves, pixels=len(A))["bound"] == bound


def test_undetermined_patches_have_an_infinite_bound(scenario):
    assert errors_of(scenario, A * (np.arange(12) != 3), B)["bound"] == np.inf


def test_errors_are_of_the_noise_aware_method_and_the_same_again(scenario):
    A, B = ps.render_transport(scenario, samples=4), ps.point_light_backgrounds(scenario)
    images = [np.full((*HIDDEN, 3), 0.5), np.eye(3, 4)[..., None] * np.ones(3)]
    quiet, again, loud = (errors_of(scenario, A, B, images, snr=snr) for snr in (80, 80, 40))
    assert quiet == again
    assert 0 < quiet["error"] < loud["error"]
    assert 0 < quiet["reported_error"] < loud["reported_error"]


def test_grid_combines_all_values_with_their_ends():
    points = grid_of({"a": (-1.0, 1.0), "b": (10.0, 20.0)}, 3)
    assert len(points) == 9
    assert points[:2] == [{"a": "-1", "b": "10"}, {"a": "-1", "b": "15"}]
    assert points[3] == {"a": "0", "b": "10"} and points[-1] == {"a": "1", "b": "20"}


def bounds(values):
    if values["a"] == "1":
        raise SceneError('it hides "all",\nor nearly')
    return {"bound": 1 / 3 if values["a"] == "2" else np.inf}


def test_design_resumes_from_its_table_and_ranks_what_is_finite(tmp_path):
    table = tmp_path / "design.csv"
    rows = run_design(POINTS, bounds, table)
    assert [row["bound"] for row in rows] == [np.inf, None, 1 / 3]
    assert rows[1]["failure"] == 'it hides "all", or nearly'
    assert [row["point"] for row in ranked(rows, "bound")] == [2]
    assert run_design(POINTS, None, table) == rows  # nothing is assessed again
    with pytest.raises(OutputError, match=r"design\.csv"):
        run_design([POINTS[0], POINTS[2]], bounds, table)
    table.write_text(table.read_text("utf-8").replace("inf", "x"), "utf-8")
    with pytest.raises(OutputError, match=r"design\.csv: is damaged"):
        run_design(POINTS, bounds, table)


def test_scene_as_it_stands_must_be_a_scene(tmp_path):
    with pytest.raises(ValueError, match="hides"):
        run_design(POINTS[1:], bounds, tmp_path / "design.csv")


@pytest.mark.usefixtures("jit")
def test_a_design_for_other_ambient_light_is_another(tmp_path):
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    lit = replace(scene, light=ps.Light(ambient=(np.ones((144, 1)),)))
    asked = {"vary": {"occluder_dx": (0, 0.01)}, "out": tmp_path, "grid": 2, "images": []}
    rows = ps.design(scene, **asked)
    assert ps.design(scene, **asked) == rows
    with pytest.raises(OutputError):
        ps.design(lit, **asked)
