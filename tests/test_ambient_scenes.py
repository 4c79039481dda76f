"""The lighting conditions under ``scenes/ambient`` keep their contract."""

import os
import xml.etree.ElementTree as ET
from functools import lru_cache
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
