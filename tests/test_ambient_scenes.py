"""The lighting conditions under ``scenes/ambient`` keep their contract and are what they claim."""

import os
import xml.etree.ElementTree as ET
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.variant import OVERRIDE, examine_variants, mi, use_variant
from periscopy_sim.rendering.wall import camera_of, shape_of
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, find_scene

SCENES = Path(__file__).parents[1] / "scenes"
AMBIENT = SCENES / "ambient"
IN_SUN = ["high_sun", "low_sun", "snow"]
BEHIND_WINDOWS = ["window_left", "window_right"]
NAMES = [*REALISTIC, *ADVERSARIAL]
PIXELS = 32


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    best = next(report.name for report in examine_variants() if report.works)
    use_variant(os.environ.get(OVERRIDE) or best)


vectorized = pytest.mark.usefixtures("jit")


@lru_cache(maxsize=1)  # every scene that is alive makes kernels slower to compile
def place(name: str) -> Any:
    """The Mitsuba scene, its camera's film cut down."""
    nodes = SceneNodes(
        AMBIENT / f"{name}.xml", required={"wall": "Shape", "camera": "Sensor", "wide": "Sensor"}
    )
    nodes.average_pixels((PIXELS, PIXELS))
    return nodes.instantiate()


@cache
def direct(name: str) -> np.ndarray:
    """The wall by direct light, (32, 32, 3), scaled to unit mean."""
    picture = render(name, 2, 1024)
    return picture / picture.mean()


def render(name: str, depth: int, samples: int) -> np.ndarray:
    scene = place(name)
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    camera = camera_of(scene)
    picture = mi.render(scene, sensor=camera, integrator=integrator, spp=samples, seed=1)
    return np.array(picture, dtype=np.float64)


def steps(picture: np.ndarray) -> float:
    """The largest step between neighbouring pixels of a channel, as a share of its mean."""
    relative = picture / picture.mean(axis=(0, 1))
    return max(np.abs(np.diff(relative, axis=axis)).max() for axis in (0, 1))


def roughness(picture: np.ndarray) -> float:
    """The share of a picture that no polynomial of degree 5 in x and y explains."""
    rows, columns = (np.linspace(-1, 1, n) for n in picture.shape[:2])
    basis = np.polynomial.polynomial.polyvander2d(*np.meshgrid(rows, columns), (5, 5))
    basis = basis.reshape(-1, 36)
    flat = picture.reshape(-1, 3)
    left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(flat))


def meet_wall(name: str, film: np.ndarray, sensor: str = "camera") -> tuple[np.ndarray, np.ndarray]:
    """Where a sensor's rays through film points (n, 2) end, and whether that is on the wall."""
    scene = place(name)
    sensors = {each.id(): each for each in scene.sensors()}
    rays, _ = sensors[sensor].sample_ray(
        0.0, 0.0, mi.Point2f(film.T.astype(np.float32)), mi.Point2f(0.5, 0.5)
    )
    hit = scene.ray_intersect(rays)
    on_wall = hit.is_valid() & (hit.shape == mi.ShapePtr(shape_of(scene, "wall")))
    return np.array(hit.p).T, np.array(on_wall)


def grid(n: int, margin: float = 0.0) -> np.ndarray:
    """n x n points of the film, row by row, with those at its edges."""
    ticks = np.linspace(margin, 1 - margin, n)
    x, y = np.meshgrid(ticks, ticks)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_the_folder_holds_these_conditions() -> None:
    assert sorted(path.stem for path in AMBIENT.glob("*.xml")) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_condition_is_found_by_name_and_has_wall_and_cameras_but_no_monitor(name: str) -> None:
    path, required = find_scene(f"ambient/{name}"), {"wall": "Shape", "camera": "Sensor"}
    for parameters, pixels in ((None, 126), ({"resolution": "20"}, 20)):
        nodes = SceneNodes(path, parameters, required=required)
        shapes = [props.id() for props in nodes.of_type("Shape")]
        assert tuple(camera_of(nodes.instantiate()).film().size()) == (pixels, pixels)
    assert "monitor" not in shapes
    assert shapes.count("wall") == 1
    assert not any(shape.startswith("chair") for shape in shapes)


def elements(name: str) -> list[ET.Element]:
    """The elements of a scene file and of those it includes."""
    found = []
    for element in ET.parse(AMBIENT / f"{name}.xml").iter():
        if element.tag == "include":
            found += ET.parse(AMBIENT / element.get("filename", "")).iter()
        found.append(element)
    return found


@vectorized
@pytest.mark.parametrize("name", NAMES)
def test_camera_sees_the_wall_points_of_the_chair_scene(name: str) -> None:
    chair = load_scenario(find_scene("chair"), (2, 3), {"resolution": PIXELS})
    points, on_wall = meet_wall(name, grid(PIXELS, 0.5 / PIXELS))
    assert on_wall.all()
    np.testing.assert_allclose(points, chair.view.centers, atol=2e-6)


@pytest.mark.thorough
@vectorized
@pytest.mark.parametrize("name", REALISTIC)
def test_realistic_light_has_no_edge_in_the_field_of_view(name: str) -> None:
    picture = direct(name)
    assert np.isfinite(picture).all() and picture.min() > 0
    assert steps(picture) < 0.09
    assert roughness(picture) < 0.01


@vectorized
def test_stained_glass_casts_a_coloured_pattern() -> None:
    picture = direct("stained_glass")
    assert steps(picture) > 0.3
    assert roughness(picture) > 0.1
    # Colours change from place to place: the channels are not multiples of one another.
    red, green, blue = picture.reshape(-1, 3).T
    assert abs(np.corrcoef(red, blue)[0, 1]) < 0.5
    assert np.corrcoef(red, green)[0, 1] < 0.9


def sun_directions(name: str) -> np.ndarray:
    """Directions to the middle and to twelve points on the rim of the sun's disc, (13, 3)."""
    vector = next(e for e in elements(name) if e.get("name") == "sun_direction")
    sun = np.array([float(vector.get(axis, "nan")) for axis in "xyz"])
    sun /= np.linalg.norm(sun)
    across = np.cross(sun, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    turn = np.arange(12) * np.pi / 6
    rim = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(sun, across)
    return np.concatenate([sun[None], sun + np.tan(np.radians(0.27)) * rim])


@vectorized
@pytest.mark.parametrize(
    ("name", "expected"), [*((n, True) for n in IN_SUN), *((n, False) for n in BEHIND_WINDOWS)]
)
def test_board_is_wholly_in_the_sun_or_wholly_out_of_it(name: str, expected: bool) -> None:
    points, _ = meet_wall(name, grid(41, 1e-4))
    points[:, 1] -= 1e-4
    for sun in sun_directions(name):
        toward = np.broadcast_to(sun, points.shape)
        rays = mi.Ray3f(*(mi.Point3f(a.T.astype(np.float32)) for a in (points, toward)))
        lit = ~np.array(place(name).ray_test(rays)) & (sun[1] < 0)
        assert (lit == expected).all()


def test_every_prop_is_used_and_every_file_exists() -> None:
    named = {
        (AMBIENT / element.get("value", "")).resolve()
        for name in NAMES
        for element in elements(name)
        if element.get("name") == "filename"
    }
    assert all(path.is_file() for path in named)
    props = {path for folder in ("meshes", "textures") for path in (AMBIENT / folder).iterdir()}
    assert props <= named
