import numpy as np
import pytest
from periscopy_sim.calibration.calibrate_levels import _evened
from periscopy_sim.calibration.explanation import resolution_level
from periscopy_sim.calibration.explanation.discrepancy import Whitening
from periscopy_sim.calibration.explanation.resolution_level import Rays, Resolution, ResolutionLevel

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.shipped import find_scene

NAMES = ("occluder_dx", "occluder_dz")
COARSE = Resolution(18, 6, 1, Rays(4, 4), Rays(4, 4))


def anything_goes(scenario):
    assert scenario.photograph_shape


def level(
    photograph,
    backgrounds=(),
    prior=None,
    resolution=COARSE,
    mask=None,
    check=anything_goes,
    by_area=False,
):
    given = {"resolution": str(len(photograph)), "occluder_turn": "1"}
    return ResolutionLevel(
        find_scene("chair"), given, NAMES, prior or Prior.none(2), photograph, backgrounds, mask,
        (29, 36), resolution, 0, check, by_area,
    )  # fmt: skip


@pytest.fixture
def photograph():
    return 1 + np.random.default_rng(0).random((36, 36, 3))


@pytest.mark.usefixtures("jit")
def test_light_of_a_photograph_with_the_monitor_off_changes_nothing(photograph):
    off = 1 + 0.3 * np.random.default_rng(1).random((36, 36, 3))  # unlike any far light
    values = np.zeros(2)
    for background, alike in (([], False), ([off], True)):
        plain, lit = (
            level(y, background).explain(values).evidence for y in (photograph, photograph + off)
        )
        assert (abs(lit - plain) < 1e-3 * abs(plain)) == alike


@pytest.mark.usefixtures("jit")
def test_a_place_is_rendered_once_for_a_level_and_all_that_are_made_of_it(photograph, monkeypatch):
    rendered = []

    def counted(scenario, finer):
        rendered.append(scenario.parameters)
        return area_transport(scenario, finer)

    monkeypatch.setattr(resolution_level, "area_transport", counted)
    here, there = level(photograph, by_area=True), np.array([0.001, 0.0])
    A = here.matrix(np.zeros(2))
    np.testing.assert_array_equal(here.reseeded(7).overdispersed(2.0).matrix(np.zeros(2)), A)
    assert len(rendered) == 1
    assert (here.matrix(there) != A).any()
    assert (here.varying(NAMES[::-1]).matrix(there) != here.matrix(there)).any()
    np.testing.assert_array_equal(level(photograph, by_area=True).matrix(np.zeros(2)), A)
    assert len(rendered) == 4


@pytest.mark.usefixtures("jit")
def test_the_evidence_holds_the_rulers_penalty(photograph):
    prior = Prior(np.array([0.0, 0.01]), np.array([0.005, np.inf]))
    values = np.array([0.01, 0.0])
    alone, ruled = (level(photograph, prior=p).explain(values) for p in (None, prior))
    assert ruled.evidence - alone.evidence == pytest.approx(4)
    np.testing.assert_array_equal(ruled.images, alone.images)


@pytest.mark.usefixtures("jit")
def test_pixels_of_a_small_photograph_are_averaged_as_finely_as_those_of_a_large_one(photograph):
    coarse, fine = (
        level(photograph, resolution=Resolution(longest, 6, 1, Rays(1, 1), Rays(1, 1)))
        for longest in (36, 144)
    )
    assert coarse.photograph_shape == fine.photograph_shape == (36, 36)
    exact = level(photograph, resolution=Resolution(36, 6, 1, Rays(16, 64), Rays(16, 64))).matrix(
        np.zeros(2)
    )
    errors = [np.linalg.norm(each.matrix(np.zeros(2)) - exact) for each in (coarse, fine)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.usefixtures("jit")
def test_overdispersion_tempers_the_likelihood_not_the_ruler(photograph):
    prior = Prior(np.zeros(2), np.array([0.005, 0.005]))
    here = level(photograph, prior=prior)
    values = np.array([0.005, 0.0])
    assert here.overdispersed(9.0).explain(values).overdispersion == 9
    assert here.overdispersion == 1
    plain, tempered = (each.explain(values) for each in (here, here.overdispersed(9.0)))
    assert tempered.noise == pytest.approx(plain.noise, rel=0.2)
    darkness = [each.darkness for each in (plain, tempered)]
    assert darkness[1] == pytest.approx(darkness[0] / 9)


@pytest.mark.usefixtures("jit")
def test_paint_that_a_photograph_with_the_monitor_off_shows_is_divided_out():
    values, random = np.zeros(2), np.random.default_rng(3)
    resolution = Resolution(36, 6, 1, Rays(4, 4), Rays(4, 4))
    A = level(np.ones((36, 36, 3)), resolution=resolution).matrix(values)
    signal = (A @ (1 + random.random((A.shape[1], 3)))).reshape(36, 36, 3)
    signal /= signal.mean()
    ambient = 1 + 0.5 * np.linspace(-1, 1, 36)[:, None, None] * np.ones((36, 36, 3))
    paint = 1 + 0.01 * random.standard_normal((36, 36, 1))
    noise = 1e-3
    on, off = (
        light * paint + noise * random.standard_normal(light.shape)
        for light in (signal + ambient, ambient)
    )
    painted = level(on, [off], resolution=resolution)
    evened = painted.evened(painted.explain(values))
    before, after = (each.explain(values).noise.mean() for each in (painted, evened))
    assert before > 4 * noise  # of the columns of B alone
    assert after < 2.5 * noise  # the noise of both photographs
    anew = _evened(level(on, [off], resolution=resolution), values)  # looked at by copies alone
    assert anew.explain(values).noise.mean() < 2.5 * noise
    even = level((signal + ambient) * 1.0, resolution=resolution)
    assert even.evened(even.explain(values)) is even


def test_how_strong_errors_are_in_light_that_is_free_does_not_matter(photograph):
    """The mean over the wall is free; by whatever it is divided, the evidence stays."""
    plain = level(photograph, by_area=True)
    plain._background = np.full((18 * 18, 1), 1 / 18)
    values, found = np.zeros(2), []
    for strength in (1.0, 100.0):
        spectrum = np.ones((18, 18))
        spectrum[0, 0] = strength
        plain._whitening = Whitening(plain.used, spectrum)
        found.append(plain.explain(values))
    assert found[1].evidence == pytest.approx(found[0].evidence, abs=0.01)
    assert found[1].darkness == pytest.approx(found[0].darkness, abs=0.01)


def test_derivatives_are_of_the_pixels_used_and_to_one_side_where_the_other_is_not_physical(
    photograph,
):
    mask = np.ones((36, 36), bool)
    mask[:8, 4:] = False
    offsets, values = np.diag([1e-3, 1e-3]), np.zeros(2)
    free = level(photograph, mask=mask, by_area=True)
    centre = free.scenario(values).occluders[0].vertices.mean(axis=0)

    def left_alone(scenario):
        if scenario.occluders[0].vertices.mean(axis=0)[0] > centre[0] + 5e-4:
            raise SceneError("the chair is in the wall")

    held = level(photograph, mask=mask, by_area=True, check=left_alone)
    both, one = (each.derivatives(values, offsets) for each in (free, held))
    assert both.shape == one.shape == (2, free.used.sum(), 30)
    # Where it stands goes in proportion: one side tells what both do, but for rounding.
    np.testing.assert_allclose(one, both, atol=1e-3 * np.abs(both).max())
    here, there = free.matrix(values), free.matrix(np.array([1e-4, 0.0]))
    expected = (there - here) / 1e-4
    assert np.linalg.norm(both[0] - expected) < 0.05 * np.linalg.norm(expected)
    nowhere = level(photograph, by_area=True, check=lambda _: left_alone(free.scenario([1, 0])))
    with pytest.raises(SceneError, match="in the wall"):
        nowhere.derivatives(values, offsets)
