"""Checkerboards that plain Mitsuba renders 60 degrees off the wall's normal, rectified."""

import itertools

import mitsuba as mi
import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.photographs.develop import sensor_image
from periscopy_sim.photographs.prepare import prepare
from periscopy_sim.photographs.wall_view import WallPoints
from periscopy_sim.rendering.variant import use_variant

WALL = np.array([0.1, 1.0, 0.3])  # its middle; it faces the camera at smaller y
WIDTH, HEIGHT, SQUARE = 1.2, 0.8, 0.1
EYE = WALL + 1.6 * np.array([np.sin(np.radians(60)), -np.cos(np.radians(60)), 0.1])
FIELD = 38.0  # degrees across
SIZE = (400, 600)
DARK, LIGHT = np.array([0.2, 0.3, 0.4]), np.array([1.0, 0.9, 0.8])

SCENE = """<scene version="3.0.0">
<default name="height" value="80"/><default name="width" value="120"/>
<default name="bend" value="0"/>
<sensor type="orthographic" id="camera">
  <transform name="to_world"><scale x="0.45" y="0.45"/>
    <lookat origin="0.1, 0.5, 0.3" target="0.1, 1, 0.3" up="0, 0, 1"/></transform>
  <film type="hdrfilm"><integer name="width" value="$width"/>
    <integer name="height" value="$height"/></film>
</sensor>
WALL
<shape type="rectangle" id="monitor">
  <transform name="to_world"><scale value="0.2"/><rotate x="1" angle="90"/>
    <rotate z="1" angle="180"/><translate x="-0.3" y="0" z="0.3"/></transform>
  <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
</scene>"""
PLANE = """<shape type="rectangle" id="wall"><transform name="to_world">
  <rotate x="1" angle="90"/><scale x="3" z="3"/><translate x="0.1" y="1" z="0.3"/>
  </transform></shape>"""
CURVED = """<shape type="sphere" id="wall"><point name="center" x="0.1" y="-4" z="0.3"/>
  <float name="radius" value="5"/><boolean name="flip_normals" value="true"/></shape>"""


@pytest.fixture(scope="module", autouse=True)
def vectorized(jit):  # noqa: ARG001
    use_variant()


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "lab.xml"
    path.write_text(SCENE.replace("WALL", PLANE))
    return ps.load_scenario(path, (1, 1))


def seen(points):
    """Column and row of (n, 3) points, by a pinhole camera that is written out."""
    forward = (WALL - EYE) / np.linalg.norm(WALL - EYE)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    rays = points - EYE
    focal = SIZE[1] / 2 / np.tan(np.radians(FIELD / 2))
    across, down = focal * (rays @ right) / (rays @ forward), focal * (rays @ up) / (rays @ forward)
    return np.stack([SIZE[1] / 2 + across, SIZE[0] / 2 - down], axis=1)


@pytest.fixture(scope="module")
def photograph():
    """A checkerboard that glows, as the slanted camera sees it."""
    to_world = mi.ScalarTransform4f
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "direct"},
        "wall": {
            "type": "rectangle",
            "to_world": to_world().translate(list(WALL)).rotate([1, 0, 0], 90)
            .scale([WIDTH / 2, HEIGHT / 2, 1]),
            "emitter": {
                "type": "area",
                "radiance": {
                    "type": "checkerboard",
                    "color0": {"type": "rgb", "value": DARK.tolist()},
                    "color1": {"type": "rgb", "value": LIGHT.tolist()},
                    "to_uv": to_world().scale([WIDTH / SQUARE / 2, HEIGHT / SQUARE / 2, 1]),
                },
            },
        },
        "camera": {
            "type": "perspective", "fov": FIELD, "fov_axis": "x",
            "to_world": to_world().look_at(origin=list(EYE), target=list(WALL), up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE[1], "height": SIZE[0],
                     "rfilter": {"type": "box"}},
            "sampler": {"type": "stratified", "sample_count": 64},
        },
    })  # fmt: skip
    return np.array(mi.render(scene))


def checkerboard(scenario):
    """The board averaged over the film's pixels in closed form, (rows, columns)."""
    rows, columns = scenario.photograph_shape
    grid = scenario.view.centers.reshape(rows, columns, 3)
    across, up = grid[0, :, 0] - WALL[0] + WIDTH / 2, grid[:, 0, 2] - WALL[2] + HEIGHT / 2
    side = abs(across[1] - across[0])

    def sign(middles):  # mean over each pixel of +1 and -1 in turn, from its integral
        ends = np.stack([middles - side / 2, middles + side / 2]) / SQUARE
        periods, rest = np.divmod(ends, 2)
        integral = np.where(rest < 1, rest, 2 - rest) + 0 * periods
        return (integral[1] - integral[0]) * SQUARE / side

    return (1 - np.outer(sign(up), sign(across))) / 2


def clicked(count, seed, noise=0.0):
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-0.5, 0.5, (count, 2)) * [1.0, 0.65]
    points = WALL + np.stack([offsets[:, 0], np.zeros(count), offsets[:, 1]], axis=1)
    return WallPoints(seen(points) + rng.normal(0, noise, (count, 2)), points)


def test_checkerboard_is_where_it_is_and_keeps_its_light(photograph, scenario):
    found = prepare(photograph, scenario, marks=clicked(8, 1))
    assert found.mask.mean() > 0.98 and found.defects == 0
    board = checkerboard(scenario)[..., np.newaxis]
    truth = DARK + board * (LIGHT - DARK)
    light = found.values[found.mask].mean(axis=0) / truth[found.mask].mean(axis=0)
    assert np.abs(light - 1).max() < 2e-4
    # The light from the middle of a square to that of the next tells where the edge between is.
    off = (found.values - truth)[..., 0] / (LIGHT - DARK)[0]
    shifts = [
        *edge_shifts(off, found.mask, board[..., 0]),
        *edge_shifts(off.T, found.mask.T, board[..., 0].T),
    ]
    assert len(shifts) > 45
    assert np.abs(shifts).max() < 0.01, "of a new pixel"
    pixel = 0.9 / 120
    spacing = np.linalg.norm(seen(WALL[np.newaxis]) - seen(WALL[np.newaxis] + [0, 0, pixel]))
    assert 3 < spacing < 5  # so they are right to 0.05 pixels of the photograph


def edge_shifts(off, mask, board):
    """How far each edge across the rows of a board is from its place, in pixels.

    `off` is what is too bright, over the step of the edges.
    """
    for square in squares(board[:, 0]):
        rows = square[1:-1]  # a pixel of the photograph may reach into the next square
        for left, right in itertools.pairwise(squares(board[rows[0]])):
            edge = np.ix_(rows, np.arange(left[len(left) // 2], right[len(right) // 2]))
            if mask[edge].all():
                yield off[edge].sum() / len(rows)


def squares(line):
    """Pixels of each square along a line; those at the ends may be cut and are left out."""
    parts = np.split(np.arange(len(line)), np.flatnonzero(np.diff(line)) + 1)
    return [part for part in parts if line[part[0]] in (0, 1)][1:-1]


def test_a_curved_wall_and_a_scene_behind_the_camera_are_refused(photograph, tmp_path):
    path = tmp_path / "curved.xml"
    path.write_text(SCENE.replace("WALL", CURVED))
    with pytest.raises(PeriscopyError, match="the wall is curved"):
        prepare(photograph, ps.load_scenario(path, (1, 1)), marks=clicked(6, 1))


def test_saturated_light_and_what_a_mask_leaves_out_are_not_measured(photograph, scenario):
    mask = np.ones(SIZE, bool)
    mask[:, :250] = False
    marks, light = clicked(8, 1), sensor_image(photograph, "y", white=0.99)
    found = prepare(light, scenario, marks=marks, mask=mask)
    board = checkerboard(scenario)
    saturated = ~prepare(light, scenario, marks=marks).mask
    masked = ~prepare(photograph, scenario, marks=marks, mask=mask).mask
    assert saturated[(board == 1) & ~masked].mean() > 0.95
    assert saturated[board == 0].mean() < 0.35  # those that share a pixel with a light one
    assert masked.any() and not (found.mask & (masked | saturated)).any()
    assert np.isnan(found.values[~found.mask]).all() and np.isfinite(found.values[found.mask]).all()
    rows, columns = np.nonzero(found.mask)
    on_film = scenario.view.centers.reshape(80, 120, 3)[rows, columns]
    assert seen(on_film)[:, 0].min() > 250


def test_a_mask_of_the_film_counts_too(photograph, scenario):
    mask = np.ones(scenario.photograph_shape, bool)
    mask[:10] = False
    found = prepare(photograph, scenario, marks=clicked(8, 1), mask=mask)
    assert not found.mask[:10].any() and found.mask[10:].mean() > 0.97


def test_whole_blocks_are_averaged_where_the_camera_is_the_scenes(scenario):
    light = np.random.default_rng(0).uniform(1, 2, (240, 360, 3))
    found = prepare(light, scenario)
    expected = light.reshape(80, 3, 120, 3, 3).mean(axis=(1, 3))
    assert np.allclose(found.values, expected, rtol=1e-6) and found.mask.all()
    assert found.view is None and found.coverage == 9
    with pytest.raises(PeriscopyError, match=r"240 x 300 .* 80 x 120 of the scene's camera"):
        prepare(light[:, :300], scenario)
    with pytest.raises(PeriscopyError, match="40 x 60 pixels"):
        prepare(light[:40, :60], scenario)


def test_hot_pixels_are_left_out_of_the_averages(scenario):
    light = np.random.default_rng(0).normal(1000, 10, (240, 360, 3))
    spoiled = light.copy()
    spoiled[100, 100] = 9000
    spoiled[50, 60] = 0
    sound, found = prepare(light, scenario), prepare(spoiled, scenario)
    assert found.defects == 2 and found.mask.all()
    assert np.abs(found.values - sound.values).max() < 10  # the mean of 8 of 9 pixels


def test_a_black_level_above_the_light_causes_a_warning(scenario):
    light = np.random.default_rng(0).normal(1000, 10, (240, 360, 3))
    assert prepare(light, scenario).warnings == ()
    light[:60] -= 1100
    (warning,) = prepare(light, scenario).warnings
    assert warning.startswith("25 % of the pixels are below the black level")
