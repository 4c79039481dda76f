import operator
import pickle
import re
import warnings
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import periscopy_sim as ps
from periscopy_sim.calibration import moving_scene
from periscopy_sim.calibration.moving_scene import MovingScene
from periscopy_sim.calibration.prior import SceneCovariance
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.measurement import add_noise
from periscopy_sim.memo import Memo
from periscopy_sim.scene import EmissionProfile
from periscopy_sim.view import rises, wall_frame

pytestmark = pytest.mark.usefixtures("quick_light")


def hemisphere(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(3, count))
    directions[2] = np.abs(directions[2])
    return directions


def field(rows=3, columns=4):
    """Points of a wall at y = 2 as seen by a viewer who looks along y with z up."""
    x, z = np.meshgrid(np.linspace(1.0, 2.2, columns), np.linspace(1.5, 0.7, rows))
    points = np.stack([x, np.full_like(x, 2.0), z], axis=-1).reshape(-1, 3)
    return points, np.tile([0.0, -1.0, 0.0], (len(points), 1))


@pytest.mark.parametrize("exponents", [(18, 1), (20, 0), (0, 2.5), (0, 0)])
def test_profile_is_a_power_of_the_cosine_of_each_angle(exponents):
    across, up, normal = hemisphere(500)
    vertical, horizontal = np.arctan2(up, normal), np.arctan2(across, normal)
    expected = np.cos(vertical) ** exponents[0] * np.cos(horizontal) ** exponents[1]
    np.testing.assert_allclose(EmissionProfile(*exponents)(across, up, normal), expected, 1e-9)


@pytest.mark.parametrize("exponents", [(18, 1), (0, 0)])
def test_nothing_is_emitted_backwards_or_within_the_screens_plane(exponents):
    across, up, normal = hemisphere(100)
    profile = EmissionProfile(*exponents)
    np.testing.assert_array_equal(profile(across, up, -normal), 0)
    in_plane = np.array([[1.0, 0, 0], [0, 1, 0], [1, 1, 0]]).T
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(profile(*in_plane), 0)


@pytest.mark.parametrize("seed", range(4))
def test_frame_follows_the_photograph_however_the_wall_stands(seed):
    points, normals = field()
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    shift = np.array([3.0, -5.0, 0.5])
    frame = wall_frame(points @ turn.T + shift, normals @ turn.T, (3, 4))
    np.testing.assert_allclose(frame.center, turn @ [1.6, 2.0, 1.1] + shift, atol=1e-12)
    np.testing.assert_allclose(frame.across, turn @ [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(frame.normal, turn @ [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(frame.up, turn @ [0, 0, 1], atol=1e-12)


@settings(deadline=None)
@given(
    shape=st.tuples(st.integers(1, 6), st.integers(2, 6)),
    seed=st.integers(0, 10_000),
    roughness=st.floats(0, 0.05),
    distance=st.floats(0, 1e3),
)
def test_frame_holds_every_point_of_any_wall(shape, seed, roughness, distance):
    rng = np.random.default_rng(seed)
    points, normals = field(*shape)
    points = Rotation.random(rng=rng).apply(points + roughness * rng.normal(size=points.shape))
    normals = Rotation.random(rng=rng).apply(normals + 0.2 * rng.normal(size=normals.shape))
    points += distance * rng.normal(size=3)
    frame = wall_frame(points, normals / np.linalg.norm(normals, axis=1, keepdims=True), shape)
    axes = np.stack([frame.across, frame.up, frame.normal])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    coordinates = (points - frame.center) @ axes.T
    np.testing.assert_allclose(coordinates.mean(axis=0), 0, atol=1e-9 * (1 + distance))
    np.testing.assert_allclose(
        frame.center + coordinates @ axes, points, atol=1e-9 * (1 + distance)
    )


def test_rolled_cameras_columns_say_what_is_across():
    points, normals = field()
    rolled = points.reshape(3, 4, 3).transpose(1, 0, 2)[:, ::-1].reshape(-1, 3)
    frame = wall_frame(rolled, normals, (4, 3))
    np.testing.assert_allclose(frame.across, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(frame.up, [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_frame_without_columns_or_of_some_pixels_turns_with_the_scene(seed):
    points, normals = field()
    some, corners = [3, 5, 6, 10], points[[0, 3, 11, 8]]
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    for frame in (
        wall_frame(points[::4] @ turn.T, normals[::4] @ turn.T, (3, 1)),
        wall_frame(points[some] @ turn.T, normals[some] @ turn.T, (3, 4), corners @ turn.T),
    ):
        np.testing.assert_allclose(frame.across, turn @ [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(frame.up, turn @ [0, 0, 1], atol=1e-12)
    frame = wall_frame(points[:1], normals[:1], (1, 1))
    assert abs(frame.across @ frame.normal) < 1e-12


def test_neighbours_rise_above_a_wall_that_bends_towards_the_room_and_not_else():
    angle = np.linspace(-0.2, 0.2, 5)
    up = np.arange(3.0)
    grid = np.stack(
        np.broadcast_arrays(2 * np.sin(angle), 2 - 2 * np.cos(angle), up[:, None]), axis=-1
    )
    normals = np.stack(np.broadcast_arrays(-np.sin(angle), np.cos(angle), 0 * up[:, None]), axis=-1)
    points, normals = grid.reshape(-1, 3), normals.reshape(-1, 3)
    # A neighbour is 0.1 rad away on a circle of radius 2.
    np.testing.assert_allclose(rises(points, normals, (3, 5)), 2 * (1 - np.cos(0.1)), rtol=1e-12)
    np.testing.assert_allclose(rises(points, -normals, (3, 5)), 0, atol=1e-12)
    flat = np.stack(np.meshgrid(angle, [1.0], up), axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(rises(flat, np.tile([0, -1.0, 0], (15, 1)), (3, 5)), 0)
    assert rises(points[:1], normals[:1], (1, 1)) == [0]


LIT = np.linspace(1, 2, 576)[:, None]  # ambient light in place of Eq. 4's 512 columns
RAYS = ps.Light(by="rays", samples=4, ambient=(LIT,))
FREE = {"by": None, "samples": None}


def chair(light=RAYS, seed=0, **parameters):
    return ps.load_scenario(
        "chair", (4, 5), {"resolution": 24, **parameters}, light=light, seed=seed
    )


@pytest.fixture
def wall(jit):  # noqa: ARG001
    """A chair and a photograph of it, without noise."""
    scene = chair()
    f = np.random.default_rng(3).uniform(0.1, 1, (20, 3))
    y = (scene.A.astype(float) @ f).reshape(24, 24, 3) + LIT.reshape(24, 24, 1) * scene.A.mean()
    return scene, ps.Photograph.of(y)


OWN = """
import periscopy_sim as ps

def own(scenario, A, B):
    return ps.NoiseAware.for_scene(scenario, A, B)
"""


def test_a_method_is_kept_until_what_it_depends_on_changes(wall, tmp_path, monkeypatch):
    scene, y = wall
    mask = np.ones((24, 24), bool)
    mask[3:9, 4:8] = False
    changes = {"samples": 8}, {"ambient": (LIT**2,)}, {"strata": "gauss"}
    lights = [replace(RAYS, **each) for each in (*changes, {"matrix": scene.A, **FREE})]
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own.py"
    own.write_text(OWN)

    def fitted():
        yield scene.method("noise-aware", y)
        yield scene.method("noise-aware", y, tv_weight=0.1)
        yield scene.method("differencing", y)
        yield scene.method("noise-aware", replace(y, mask=mask))
        yield scene.method("noise-aware", replace(y, monitor_off={"off": y.values**2}))
        yield scene.method("noise-aware", y, errors={})
        yield scene.method("noise-aware", y, errors={"occluder_dx": 0.01})
        yield scene.method("noise-aware", y, errors={"occluder_dx": 0.02})
        yield scene.at(occluder_dx=0.01).method("noise-aware", y)
        yield replace(scene, seed=1).method("noise-aware", y)
        for light in lights:
            yield replace(scene, light=light).method("noise-aware", y)
        yield scene.method("own.py:own", y)
        own.write_text(OWN + "# edited")
        yield scene.method("own.py:own", y)

    first, again = [*fitted()], [*fitted()]
    assert len({*first}) == len(first)
    assert all(map(operator.is_, first[:-2], again))


@pytest.mark.usefixtures("jit")
def test_the_noise_decides_how_fine_a_matrix_is():
    scene = chair(ps.Light(by="rays", ambient=(LIT,)))
    fine, coarse = (scene.plan(noise).samples for noise in (1e-2, 1.0))
    assert fine > coarse and scene.transport(1e-2) is not scene.transport(1.0)
    assert scene.method("noise-aware", noise=1e-2) is not scene.method("noise-aware", noise=1.0)
    np.testing.assert_array_equal(
        scene.transport_of(np.ones((1, 20, 3)), 1.0)[1], scene.transport(1.0)
    )


def test_a_scenario_elsewhere_shares_what_is_kept(wall):
    scene, _ = wall
    moved = scene.at(occluder_dx=0.01)
    assert scene.at(occluder_dx=0.01).A is moved.A is not scene.A
    assert moved.at(occluder_dx=0).A is scene.at(occluder_dx=0).A
    np.testing.assert_array_equal(moved.A, chair(occluder_dx=0.01).A)


@pytest.mark.usefixtures("jit")
def test_an_edited_scene_is_not_served_from_what_is_kept(tmp_path):
    """Nothing but the file knows how the screen emits."""
    file, memo, found = tmp_path / "mine.xml", Memo(), []
    text = ps.find_scene("plate").read_text()
    for exponent in (18, 2):
        file.write_text(text.replace('_exponent" value="18"', f'_exponent" value="{exponent}"'))
        scene = ps.load_scenario(file, (4, 5), {"resolution": 21})
        found.append(replace(scene, memo=memo).A)
    assert not np.allclose(*found, rtol=1e-3)


def test_a_pickled_scenario_makes_the_same_anew(wall):
    scene, y = wall
    other = pickle.loads(pickle.dumps(scene))
    assert other.A is not scene.A
    np.testing.assert_array_equal(other.A, scene.A)
    found = (each.method("noise-aware", y).reconstruct(y) for each in (scene, other))
    np.testing.assert_array_equal(*found)


def test_a_given_matrix_is_used(wall):
    scene, y = wall
    A = np.ascontiguousarray(scene.A[:, ::-1])
    given = replace(
        scene, light=ps.Light(ambient=(LIT,), matrix=A, record={"transport_error": 0.25})
    )
    assert given.A is A and given.plan().by == "file" and given.plan().error == 0.25
    plain = {"tv_weight": 0, "repair_threshold": 1e9}
    images = [each.method("preconditioned", y, **plain).reconstruct(y) for each in (given, scene)]
    np.testing.assert_allclose(images[0][::-1, ::-1], images[1], rtol=1e-3)


def test_a_given_matrix_stays_with_its_scene(wall):
    scene, y = wall
    given = replace(scene, light=ps.Light(ambient=(LIT,), matrix=scene.A))
    with pytest.raises(PeriscopyError, match="one scene"):
        given.at(occluder_dx=0.03)
    given.method("noise-aware", y)  # counts errors of the scene's numbers


def test_derivatives_for_declared_errors_are_held_a_band_at_a_time(monkeypatch):
    """Three rows of pixels at once, of 24."""
    scene, held, linearized = chair(), [], MovingScene.linearized

    def watched(moving, values):
        light, derivatives = linearized(moving, values)
        held.append(derivatives.nbytes)
        return light, derivatives

    monkeypatch.setattr(MovingScene, "linearized", watched)
    size = 4 * scene.photograph_shape[1] * scene.hidden.patches
    image = np.random.default_rng(0).random((*scene.hidden_shape, 3))
    lights = []
    for rows in (scene.photograph_shape[0], 3):
        monkeypatch.setattr(moving_scene, "MOST_BYTES", rows * size)
        held.clear()
        uncertain = moving_scene.uncertain_transport(scene, {"occluder_dx": 0.005})
        lights.append(uncertain.slopes(image))
        assert max(held) <= rows * size
    np.testing.assert_allclose(lights[1], lights[0], rtol=1e-5, atol=1e-6 * lights[0].max())


def test_a_given_matrix_with_bounces_lacks_no_light_that_bounces(wall):
    scene, _ = wall
    A = replace(scene, light=replace(RAYS, bounces=2)).A
    image = scene.image("mushroom")
    y = ps.Photograph(add_noise(scene.photograph(image, bounces=2).values, 60, 1))
    codes = []
    for matrix in (scene.A, A):
        given = replace(scene, light=ps.Light(ambient=(LIT,), matrix=matrix))
        fitted = given.method("preconditioned", y)
        codes.append([note.code for note in given.judge(y, fitted.solve(y), fitted).warnings])
    assert "bounces" in codes[0] and "bounces" not in codes[1]


@pytest.mark.usefixtures("jit")
def test_what_is_kept_is_nobodys_to_change():
    """Nor a scenario's of another light: planning A by areas makes it, and both take it."""
    scene = chair(ps.Light(ambient=(LIT,)))
    bounced = replace(scene, light=replace(scene.light, bounces=2))
    before = scene.A.copy()
    assert bounced.A.mean.sum() > before.sum()
    np.testing.assert_array_equal(scene.A, before)
    for kept in (scene.A, bounced.A.mean, scene.B):
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 0


def test_a_solution_of_another_photograph_or_scenario_is_not_judged(wall):
    scene, y = wall
    others = ps.Photograph(y.values[..., :1]), replace(y, mask=np.eye(24) == 0)
    for name, other in zip(("truncated-svd", "noise-aware"), others, strict=True):
        method = scene.method(name, other)
        with pytest.raises(PeriscopyError, match="another photograph or scenario"):
            scene.judge(y, method.solve(other), scene.method(name, y))
        for solution in (scene.method("differencing", y).solve(y), np.ones((4, 5, 3))):
            with pytest.raises(PeriscopyError, match=name):
                scene.judge(y, solution, name)


@pytest.mark.usefixtures("jit")
def test_a_photograph_says_what_the_reader_of_its_light_assumed(tmp_path):
    np.save(tmp_path / "light.npy", np.full((24, 24, 3), 200, np.uint8))
    y = chair().photograph(np.ones((4, 5, 3)), ambient=tmp_path / "light.npy", sbr=1, bounces=1)
    assert "light.npy" in y.warnings[0]


@pytest.mark.usefixtures("jit")
def test_what_a_calibration_knows_moves_with_the_scenario(monkeypatch):
    """Its errors count, or are said to be of other values, instead of the ruler's."""
    known = SceneCovariance(("occluder_dx",), np.array([0.01]), np.eye(1) * 1e-6, True, np.zeros(1))
    found = SimpleNamespace(values={"occluder_dx": 0.01}, scene_covariance=known, scenario=None)
    monkeypatch.setattr("periscopy_sim.calibration.calibrate.calibrate", lambda *_, **__: found)
    monkeypatch.setattr("periscopy_sim.scenario.replace", replaced(found))
    scenario = chair().calibrate(np.ones((24, 24, 3))).scenario
    assert scenario.uncertainty()[0].names == ("occluder_dx",)
    assert scenario.at(monitor_dx=0.002).uncertainty()[0].names == ("occluder_dx",)
    codes = [note.code for note in scenario.at(occluder_dx=0.0).uncertainty()[1]]
    assert codes == ["uncounted"]


def replaced(stand_in):
    """Return `replace` that also sets a value of a stand-in."""

    def set_or_replace(value, **changes):
        if value is stand_in:
            return SimpleNamespace(**{**vars(value), **changes})
        return replace(value, **changes)

    return set_or_replace


@pytest.mark.usefixtures("jit")
def test_sizes_pictures_and_light_are_taken_in_each_of_their_forms(tmp_path):
    scenes = [
        ps.load_scenario("chair", hidden, photograph=film)
        for hidden, film in (
            ((4, 5), (24, 24)),
            ("4x5", "24X24"),
            (np.array([4, 5]), [24, 24]),
            ({"monitor": "4x5"}, (24.0, 24)),
        )
    ]
    assert {str(each) for each in scenes} == {str(scenes[0])}
    np.testing.assert_array_equal(*(ps.Hidden.of(size).centers for size in ((4, 5), "4x5")))
    scene, bars = chair(), ps.read_hidden_image("scenes/images/bars.png", "8x10")
    image = scene.image(bars)
    np.testing.assert_allclose(image, scene.image("bars"), atol=1e-6)
    pictures = "bars", {"monitor": "bars"}, image, {"monitor": scene.image("bars")}
    mono = np.eye(3)
    ys = [
        scene.photograph(each, ambient=light, bounces=1, colour_matrix=mono)
        for each, light in zip(pictures, (None, "none", None, "none"), strict=True)
    ]
    for y in ys:
        np.testing.assert_allclose(y.values, ys[0].values, rtol=1e-5)
    light = np.linspace(1, 2, 24 * 24 * 3).reshape(24, 24, 3)
    np.save(tmp_path / "light.npy", light)
    lit = [
        scene.photograph("bars", ambient=each, sbr=1, bounces=1).values
        for each in (light, ps.Photograph.of(light), tmp_path / "light.npy")
    ]
    np.testing.assert_array_equal(lit[0], lit[1])
    np.testing.assert_array_equal(lit[0], lit[2])
    assert not scene.ambient("none").photograph.any()
    assert isinstance(ys[0].colour_matrix, ps.ColourMatrix)


@dataclass
class Unhashable:
    image: object

    def __call__(self, scenario, A, B):  # noqa: ARG002
        return SimpleNamespace(reconstruct=lambda _: self.image)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda _: ps.load_scenario("chair", 9), "'9' is not a size"),
        (lambda _: ps.load_scenario("chair", (9.5, 9)), "9.5"),
        (lambda _: ps.load_scenario("chair", (True, 9)), "True"),
        (lambda _: ps.load_scenario("chair", (9, 9), photograph=24), "'24'"),
        (lambda _: ps.load_scenario(1, (9, 9)), "int"),
        (lambda _: ps.find_image(1), "int"),
        (lambda _: ps.flips(np.ones((2, 2, 3))), "by name"),
        (lambda _: ps.make_dataset("nowhere.yaml", "out"), r"nowhere\.yaml"),
        (lambda _: ps.Light(matrix=np.ones((2, 2)), samples=4), "samples"),
        (lambda s: s.photograph(np.zeros((4, 5, 3))), "black"),
        (lambda s: s.photograph("bars", ambient="none", sbr=1), "SBR"),
        (lambda s: s.photograph("bars", ambient=np.ones((2, 2, 3)), sbr=1), "2 x 2"),
        (lambda s: s.photograph({"card": "bars"}), "card"),
        (lambda s: s.photograph("bars", colour_matrix=np.ones(3)), "colour matrix"),
        (lambda s: ps.sweep(s, np.ones((4, 5, 3))), "ndarray"),
        (lambda s: ps.sweep(s, "bars", ambient=np.ones((24, 24, 3))), "ndarray"),
    ],
)
def test_the_door_names_what_it_cannot_take(call, named, jit):  # noqa: ARG001
    with pytest.raises(PeriscopyError, match=named):
        call(chair())


@pytest.mark.parametrize("shape", [(4, 4, 3), (4, 5)])
def test_a_method_that_returns_another_shape_is_named_with_both(wall, shape):
    scene, y = wall
    own = Unhashable(np.ones(shape))
    fitted = scene.method(own, y)
    assert scene.method(own, y) is fitted and scene.method(Unhashable(0), y) is not fitted
    with pytest.raises(PeriscopyError, match=re.escape(str(shape))) as raised:
        fitted.solve(y)
    assert "Unhashable" in str(raised.value) and "(4, 5, 3)" in str(raised.value)
